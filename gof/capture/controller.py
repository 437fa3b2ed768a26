"""Talks to an LED board over a serial port: one request, one reply, bounded waits, errors that say what to do."""

from __future__ import annotations

import errno
import os
import struct
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from gof.capture.protocol import (
    VERSION,
    FrameReader,
    Identity,
    ProtocolError,
    Reply,
    ReplyStatus,
    Request,
    Status,
    decode_reply,
    encode_request,
)
from gof.core.errors import GofError
from gof.host import extras

BAUD = 115200
READY_S = 3.5  # after its port was opened: many boards reset then, and are busy with their boot loader for up to 3 s
BOOT_TEXT = 16  # bytes that are no reply, received before the first answer: a boot loader's text
RESET_SAID = (
    "opening the port resets this board: a command that looks at it stops it, and its counter starts anew. Start it "
    "last, and do not look at it while you film; a capacitor of 10 uF from EN to GND stops the reset"
)
# Boards with USB of their own, then the USB-serial chips of common ESP32 boards: Espressif, CP210x, CH34x, FTDI.
KNOWN_USB_VENDORS = (0x303A, 0x10C4, 0x1A86, 0x0403)
OUTPUT_NAMES = (*(f"strip {i}" for i in range(5)), *(f"Gray bit {i}" for i in range(15)), "disambiguation LED")


class BoardError(GofError):
    """The board cannot be reached or does not answer."""


class Board:
    """An open LED board. Use as a context manager; every method raises BoardError or ProtocolError.

    Args:
        port: serial port ("/dev/ttyACM0", "COM3") or a pyserial URL.
        timeout_s: longest wait for one reply.
        attempts: how often a request is sent before giving up; every request may be repeated harmlessly but START,
            whose repetition is recognised.
        ready_s: longest wait for the first reply, from the opening of the port on.

    Attributes:
        was_reset: whether opening the port reset the board: its boot loader wrote before it answered.
    """

    def __init__(self, port: str, timeout_s: float = 0.5, attempts: int = 3, ready_s: float = READY_S):
        serial = _pyserial()
        self.port, self.timeout_s, self.attempts = port, timeout_s, attempts
        self._reader, self._sequence = FrameReader(), 0
        self._ready_by = time.monotonic() + ready_s
        try:
            self._line = serial.serial_for_url(port, BAUD, timeout=0.02, write_timeout=timeout_s, do_not_open=True)
            # On many boards these two lines pull the reset and the boot pin.
            self._line.dtr = self._line.rts = False
            self._line.open()
            _keep_lines_on_close(self._line)
        except (serial.SerialException, OSError, ValueError) as e:
            raise BoardError(_explain_open(port, e)) from e
        try:
            self.identity = self.identify()
            self.was_reset = self._reader.bad_bytes >= BOOT_TEXT
        except BaseException:
            self._line.close()
            raise

    def __enter__(self) -> Board:
        return self

    def __exit__(self, *_: Any) -> None:
        self.close()

    def close(self) -> None:
        """Close the port; the board keeps doing what it does."""
        self._line.close()

    def identify(self) -> Identity:
        """Ask the board what it is."""
        return Identity.decode(self._ask(Request.IDENTIFY).body)

    def status(self) -> Status:
        """Counter, state and jitter now."""
        return Status.decode(self._ask(Request.STATUS).body)

    def set_tick(self, tick_us: int) -> None:
        """Length of a tick in microseconds, 50..100000; refused while running."""
        if not 50 <= tick_us <= 100_000:
            raise BoardError(f"a tick of {tick_us} us is outside 50..100000 us")
        self._ask(Request.SET_TICK, struct.pack("<I", tick_us))

    def arm(self, count: int = 0) -> None:
        """Preset the counter and show its first pattern; `start` then runs from there."""
        if not 0 <= count < 1 << self.identity.gray_bits:
            raise BoardError(f"count {count} does not fit in {self.identity.gray_bits} Gray bits")
        self._ask(Request.ARM, struct.pack("<I", count))

    def start(self) -> None:
        """Start the clock. A START whose reply was lost counts as done when the board runs."""
        try:
            self._ask(Request.START)
        except ProtocolError:
            if self._repeated and self.status().state.name == "RUNNING":
                return
            raise

    def stop(self) -> None:
        """Stop and go dark."""
        self._ask(Request.STOP)

    def show_test(self, pattern: str, output: int = 0) -> None:
        """Show the light "all_off", "all_on", or "one" logical output (0..20) until the next command."""
        self._ask(Request.SHOW_TEST, bytes([("all_off", "all_on", "one").index(pattern), output]))

    def self_test(self) -> list[str]:
        """Return names of outputs that read back wrong: stuck, or bridged to another. Stops the board."""
        bad = struct.unpack("<I", self._ask(Request.SELF_TEST).body.ljust(4, b"\0")[:4])[0]
        return [name for i, name in enumerate(OUTPUT_NAMES) if bad >> i & 1]

    def _ask(self, request: Request, body: bytes = b"") -> Reply:
        self._sequence = (self._sequence + 1) & 0xFF
        self._repeated = False
        attempt = 0
        while attempt < self.attempts or time.monotonic() < self._ready_by:
            self._repeated = attempt > 0
            attempt += 1
            self._write(encode_request(request, self._sequence, body))
            for reply in self._replies(time.monotonic() + self.timeout_s):
                if reply.version != VERSION or reply.status == ReplyStatus.WRONG_VERSION:
                    raise ProtocolError(
                        f"{self.port}: the board speaks protocol {reply.version}, this gof speaks {VERSION}; "
                        "flash the firmware of this version (docs/capture_board.md)"
                    )
                if reply.sequence != self._sequence or reply.request != request:
                    continue  # the late answer to an earlier attempt
                self._ready_by = 0.0
                if reply.status == ReplyStatus.OK:
                    return reply
                raise ProtocolError(f"{self.port}: the board refused {request.name}: {_explain_refusal(reply.status)}")
        raise BoardError(
            f"{self.port}: no LED board answers {request.name} ({self._reader.bad_frames} damaged frames received). "
            "Is this the right port, and is the gof firmware flashed (docs/capture_board.md)?"
        )

    def _write(self, frame: bytes) -> None:
        serial = _pyserial()
        try:
            self._line.write(frame)
        except serial.SerialTimeoutException:
            pass  # not read: the missing reply says so
        except (serial.SerialException, OSError) as e:
            raise self._unplugged(e) from e

    def _replies(self, deadline: float) -> Iterator[Reply]:
        serial = _pyserial()
        while time.monotonic() < deadline:
            try:
                data = self._line.read(max(1, min(self._line.in_waiting, 4096)))
            except (serial.SerialException, OSError, TypeError) as e:  # TypeError: pyserial on a port closed under it
                raise self._unplugged(e) from e
            for payload in self._reader.push(data):
                reply = decode_reply(payload)
                if reply:
                    yield reply

    def _unplugged(self, cause: Exception) -> BoardError:
        return BoardError(
            f"{self.port}: the board went away in the middle ({cause}); check the USB cable and its power"
        )


def ask_ports() -> list[Board]:
    """Ask every USB serial port of a known vendor, all at once; those that answered as a board, closed again."""
    ports = candidate_ports()
    if not ports:
        return []
    with ThreadPoolExecutor(len(ports)) as pool:
        return [board for board in pool.map(_ask_port, ports) if board is not None]


def _ask_port(port: str) -> Board | None:
    try:
        with Board(port) as board:
            return board
    except GofError:
        return None


def find_boards() -> list[tuple[str, Identity]]:
    """Return (port, identity) of every board that is plugged in."""
    return [(board.port, board.identity) for board in ask_ports()]


def only_board() -> str:
    """Return the port of the only board that is plugged in.

    Raises:
        BoardError: none, or several (names them).
    """
    ports = candidate_ports()
    if len(ports) == 1:
        return ports[0]
    boards = find_boards()
    if not boards:
        raise BoardError("no LED board found; plug it in, or name its port with --port")
    if len(boards) > 1:
        names = ", ".join(port for port, _ in boards)
        raise BoardError(f"{len(boards)} boards are plugged in ({names}); choose with --port")
    return boards[0][0]


def candidate_ports() -> list[str]:
    """USB serial ports that could be a board."""
    _pyserial()
    from serial.tools import list_ports

    return sorted(p.device for p in list_ports.comports() if p.vid in KNOWN_USB_VENDORS)


def _keep_lines_on_close(line: Any) -> None:
    """Keep a port's control lines when it closes: POSIX systems drop them, which resets some boards."""
    if os.name != "posix" or not isinstance(getattr(line, "fd", None), int):
        return
    import termios

    try:
        settings = termios.tcgetattr(line.fd)
        settings[2] &= ~termios.HUPCL
        termios.tcsetattr(line.fd, termios.TCSANOW, settings)
    except termios.error:
        pass  # not a terminal: it has no such lines


def _pyserial():
    return extras.load("serial", "capture", "the board's serial port")


def _explain_open(port: str, error: Exception) -> str:
    code = getattr(error, "errno", None)
    if code == errno.EACCES or "Permission" in str(error) or "Access is denied" in str(error):
        return (
            f"{port}: no permission to open it. On Linux: sudo usermod -aG dialout $USER, then log in again; "
            "on Windows another program (a serial monitor) holds the port"
        )
    if code == errno.EBUSY or "exclusively lock" in str(error):
        return f"{port}: another program holds it (a serial monitor?); close that one"
    if code == errno.ENOENT or "could not find" in str(error).lower() or "FileNotFound" in str(error):
        ports = ", ".join(candidate_ports()) or "none"
        return f"{port}: no such port. Plug the board in with a data cable; USB serial ports here: {ports}"
    return f"{port}: cannot be opened as a serial port ({error})"


def _explain_refusal(status: int) -> str:
    known: dict[int, str] = {
        ReplyStatus.UNKNOWN: "it does not know this command; flash this version's firmware (docs/capture_board.md)",
        ReplyStatus.BAD_ARGUMENT: "a value is outside its range",
        ReplyStatus.WRONG_STATE: "not possible in its present state; 'gof capture board stop' first",
    }
    return known.get(status, f"status {status}")
