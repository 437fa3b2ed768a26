"""The LED board's serial protocol, version 1: frames with CRC, requests and replies. Pure data, no serial port.

A frame is COBS(payload + CRC-16/CCITT-FALSE, little endian) and one zero byte. COBS leaves no zero inside, so after
noise or a lost byte the receiver is in step again at the next zero.
Request payload: version, sequence, type, body. Reply payload: version, sequence, type | 0x80, status, body. A zero goes
before requests and replies: it ends what noise or a boot loader's text left (older firmware replies without one).
"""

from __future__ import annotations

import binascii
import struct
from dataclasses import dataclass
from enum import IntEnum

from gof.core.errors import GofError

VERSION = 1
PAYLOAD_MAX = 64
FRAME_MAX = PAYLOAD_MAX + 4


class Request(IntEnum):
    """Request types."""

    IDENTIFY = 1
    STATUS = 2
    SET_TICK = 3
    ARM = 4
    START = 5
    STOP = 6
    SHOW_TEST = 7
    SELF_TEST = 8


class ReplyStatus(IntEnum):
    """The outcome of a request."""

    OK = 0
    UNKNOWN = 1
    BAD_ARGUMENT = 2
    WRONG_STATE = 3
    WRONG_VERSION = 4


class BoardState(IntEnum):
    """The board's present activity."""

    STOPPED = 0
    ARMED = 1
    RUNNING = 2
    TEST = 3


class ProtocolError(GofError):
    """The other end answered something that is not this protocol, or refused a request."""


def crc16(data: bytes) -> int:
    """CRC-16/CCITT-FALSE: polynomial 0x1021, start 0xFFFF."""
    return binascii.crc_hqx(data, 0xFFFF)


def encode_frame(payload: bytes) -> bytes:
    """Return the frame of a payload of at most PAYLOAD_MAX bytes.

    Raises:
        ValueError: the payload is longer.
    """
    if len(payload) > PAYLOAD_MAX:
        raise ValueError(f"payload of {len(payload)} bytes; the protocol carries at most {PAYLOAD_MAX}")
    body = payload + struct.pack("<H", crc16(payload))
    return b"".join(bytes([len(part) + 1]) + part for part in body.split(b"\0")) + b"\0"


def decode_frame(frame: bytes) -> bytes | None:
    """Return the payload of a frame without its final zero; None when it is damaged or too short."""
    out, i = bytearray(), 0
    while i < len(frame):
        code = frame[i]
        if code == 0 or i + code > len(frame):
            return None
        out += frame[i + 1 : i + code]
        i += code
        if i < len(frame):
            out.append(0)
    if len(out) < 3 or struct.unpack("<H", out[-2:])[0] != crc16(bytes(out[:-2])):
        return None
    return bytes(out[:-2])


class FrameReader:
    """Collects received bytes; yields the payloads of good frames and counts the others, and bytes of no good frame."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._overflow = False
        self.bad_frames = 0
        self.bad_bytes = 0

    def push(self, data: bytes) -> list[bytes]:
        """Payloads completed by `data`, in order. Memory stays bounded whatever arrives."""
        payloads = []
        for byte in data:
            if byte:
                self.bad_bytes += 1
                self._overflow |= len(self._buffer) >= FRAME_MAX
                if not self._overflow:
                    self._buffer.append(byte)
                continue
            if self._buffer:
                payload = None if self._overflow else decode_frame(bytes(self._buffer))
                if payload is None:
                    self.bad_frames += 1
                else:
                    self.bad_bytes -= len(self._buffer)
                    payloads.append(payload)
            self._buffer.clear()
            self._overflow = False
        return payloads


def encode_request(request: Request, sequence: int, body: bytes = b"") -> bytes:
    """Frame of a request; it starts with a zero that ends whatever noise is waiting at the receiver."""
    return b"\0" + encode_frame(bytes([VERSION, sequence & 0xFF, request]) + body)


@dataclass(frozen=True)
class Reply:
    """A decoded reply."""

    version: int
    sequence: int
    request: int
    status: int
    body: bytes


def decode_reply(payload: bytes) -> Reply | None:
    """Return the reply in a payload; None when it is not a reply."""
    if len(payload) < 4 or not payload[2] & 0x80:
        return None
    return Reply(payload[0], payload[1], payload[2] & 0x7F, payload[3], payload[4:])


@dataclass(frozen=True)
class Identity:
    """A board's description of itself. `outputs` are the logical outputs it has pins for."""

    name: str
    strips: int
    gray_bits: int
    ticks_per_slot: int
    ticks_per_period: int
    outputs: tuple[int, ...]

    @classmethod
    def decode(cls, body: bytes) -> Identity:
        """Decode a body. Raises ProtocolError for a body this version does not know."""
        if len(body) < 9 or not body[8:].startswith(b"gof-board "):
            raise ProtocolError("the device answers, but not as a gof LED board; flash it (docs/capture_board.md)")
        name, (strips, gray_bits, slot, period) = body[8:].decode("ascii", "replace"), body[:4]
        if not name.isprintable() or not (1 <= strips <= 32 and 1 <= gray_bits <= 32 and 1 <= slot <= period):
            raise ProtocolError("the device's answer is not that of an LED board; flash it (docs/capture_board.md)")
        wired = struct.unpack_from("<I", body, 4)[0]
        return cls(name, strips, gray_bits, slot, period, tuple(i for i in range(32) if wired >> i & 1))


@dataclass(frozen=True)
class Status:
    """Counter and timing of a board. Jitter is each tick's distance from its ideal time since start."""

    state: BoardState
    phase: int
    count: int
    periods: int
    tick_us: int
    ticks: int
    earliest_ns: int
    latest_ns: int
    mean_abs_ns: int
    bad_frames: int

    @classmethod
    def decode(cls, body: bytes) -> Status:
        """Decode a body. Raises ProtocolError for a body this version does not know."""
        try:
            state, *rest = struct.unpack("<BBIIIIiiII", body)
            return cls(BoardState(state), *rest)
        except (struct.error, ValueError) as e:
            raise ProtocolError(f"the board's status cannot be read ({e}); its firmware does not match this gof") from e
