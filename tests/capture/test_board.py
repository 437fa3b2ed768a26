"""The controller against the firmware's own core (emulator on a pseudo-terminal), and against hostile ports."""

import json
import os
import select
import struct
import threading
import time
from dataclasses import replace

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gof.capture import controller
from gof.capture.controller import Board, BoardError
from gof.capture.protocol import (
    BoardState,
    FrameReader,
    Identity,
    ProtocolError,
    Request,
    Status,
    encode_frame,
    encode_request,
)
from gof.commands import capture_board
from gof.commands.cli import main as gof

pytestmark = pytest.mark.long


def test_a_session_with_the_emulator(start_emulator):
    _, port = start_emulator()
    with Board(port) as board:
        assert board.identity.name == "gof-board 0.1.0 host" and board.identity.outputs == tuple(range(21))
        assert board.status().state is BoardState.STOPPED
        board.set_tick(1000)
        board.arm(32767)
        assert board.status().count == 32767 and board.status().state is BoardState.ARMED
        board.start()
        time.sleep(0.1)
        status = board.status()
        assert status.state is BoardState.RUNNING and status.tick_us == 1000 and 60 <= status.ticks <= 400
        # One count per ten ticks, through the wrap 32767 -> 0.
        assert status.count == (32767 + status.ticks // 10) % 32768 and status.phase == status.ticks % 10
        assert status.earliest_ns <= status.latest_ns and status.mean_abs_ns >= 0
        with pytest.raises(ProtocolError, match=r"refused SET_TICK.*stop"):
            board.set_tick(400)
        board.stop()
        assert board.status().state is BoardState.STOPPED
        board.show_test("all_on")
        assert board.status().state is BoardState.TEST
        assert board.self_test() == []
        with pytest.raises(BoardError, match="outside 50"):
            board.set_tick(10)
        with pytest.raises(BoardError, match="15 Gray bits"):
            board.arm(1 << 15)


def test_bridged_strips_are_named(start_emulator):
    _, port = start_emulator("--bridge", 1, 2)
    with Board(port) as board:
        assert board.self_test() == ["strip 1", "strip 2"]
    assert gof(["capture", "board", "self-test", "--port", port]) == 1  # a script must see it


def test_a_boards_own_figures_are_judged():
    good = Status(BoardState.RUNNING, 0, 1, 1, 400, 100, -2000, 9000, 900, 0)
    assert capture_board.judge(good) == []
    late = capture_board.judge(replace(good, latest_ns=4_830_000, bad_frames=40))
    assert "up to 4830 us off" in late[0] and "40 damaged requests" in late[1]


def test_command_line_session(start_emulator, tmp_path, capsys):
    _, port = start_emulator()
    for action in (
        ["find"],
        ["set", "--tick-us", "500", "--count", "7"],
        ["start"],
        ["monitor", "--seconds", "0.3"],
        ["stop"],
    ):
        assert gof(["capture", "board", *action, "--port", port, "--json", str(tmp_path / "out.json")]) == 0
    text = capsys.readouterr().out
    assert "gof-board" in text and "armed    count     7.0  period 5 ms" in text and "jitter" in text and "Gray" in text
    assert json.loads((tmp_path / "out.json").read_text())["status"]["state"] == "STOPPED"


def test_options_of_another_action_are_refused(capsys):
    """Before any board is looked for: with --tick-us 410, start would have run the board at its old speed."""
    for action, *options in (["start", "--tick-us", "410"], ["find", "--count", "0"], ["set", "--seconds", "1"]):
        assert gof(["capture", "board", action, *options]) == 1
        assert f"{options[0]}: changes nothing in {action}; leave out {options[0]}" in capsys.readouterr().err


def test_line_noise_between_requests_is_survived(start_emulator):
    _, port = start_emulator()
    with Board(port) as board:
        for noise in (b"\xff" * 500, b"\0\1\2\0\0", os.urandom(300)):
            board._line.write(noise)
            assert board.status().state is BoardState.STOPPED
        assert board.status().bad_frames > 0


def test_a_board_pulled_out_in_the_middle(start_emulator):
    process, port = start_emulator()
    with Board(port, timeout_s=0.3) as board:
        process.kill()
        process.wait()
        with pytest.raises(BoardError, match=r"went away in the middle|no LED board answers"):
            for _ in range(3):
                board.status()


def test_no_board_no_port_no_permission(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(controller, "candidate_ports", lambda: [])
    monkeypatch.setattr(capture_board, "candidate_ports", lambda: [])
    assert gof(["capture", "board", "find"]) == 1
    assert "no LED board found (no USB serial port is present)" in capsys.readouterr().err
    assert gof(["capture", "board", "start"]) == 1
    assert "no LED board found" in capsys.readouterr().err
    with pytest.raises(BoardError, match="no such port"):
        Board(str(tmp_path / "ttyACM7"))
    with pytest.raises(BoardError, match="cannot be opened"):
        (tmp_path / "file").write_text("")
        Board(str(tmp_path / "file"))

    import serial

    def denied(*_, **__):
        raise serial.SerialException(13, "could not open port /dev/ttyACM0: Permission denied")

    monkeypatch.setattr(serial, "serial_for_url", denied)
    with pytest.raises(BoardError, match="dialout"):
        Board("/dev/ttyACM0")


class Peer:
    """The other end of a pseudo-terminal: answers each request with whatever it is told to."""

    def __init__(self, answer):
        import tty

        self.master, client = os.openpty()
        tty.setraw(client)
        self.port, self._client, self.answer = os.ttyname(client), client, answer
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self):
        try:
            while request := os.read(self.master, 256):
                os.write(self.master, self.answer(request))
        except OSError:
            pass

    def close(self):
        os.close(self.master)
        os.close(self._client)


@pytest.fixture
def peer():
    opened = []

    def open_peer(answer):
        opened.append(Peer(answer))
        return opened[-1].port

    yield open_peer
    for p in opened:
        p.close()


def test_wrong_firmware_is_named(peer):
    with pytest.raises(ProtocolError, match="protocol 9, this gof speaks 1"):
        Board(peer(lambda _: encode_frame(bytes([9, 1, 0x81, 4]))))
    with pytest.raises(BoardError, match="no LED board answers IDENTIFY"):
        Board(peer(lambda _: b"ets Jul 29 2019 rst:0x1 (POWERON_RESET)\r\n"), timeout_s=0.1, ready_s=0)
    with pytest.raises(ProtocolError, match="not as a gof LED board"):
        Board(peer(lambda _: encode_frame(bytes([1, 1, 0x81, 0]) + b"something else")))


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.binary(max_size=120), min_size=1, max_size=8))
def test_random_answers_never_hang_or_crash_the_controller(peer, answers):
    turn = iter(range(10**6))
    start = time.monotonic()
    with pytest.raises((BoardError, ProtocolError)):
        Board(peer(lambda _: answers[next(turn) % len(answers)] + b"\0"), timeout_s=0.04, attempts=2, ready_s=0)
    assert time.monotonic() - start < 2


@given(st.binary(max_size=64))
def test_any_identity_is_decoded_or_refused(body):
    try:
        assert Identity.decode(body).name.startswith("gof-board")
    except ProtocolError:
        pass


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(drop=st.lists(st.booleans(), min_size=1, max_size=6), cut=st.integers(1, 30))
def test_dropped_and_split_replies(peer, drop, cut):
    """Replies are lost or arrive in two pieces; the board is reached if one of three attempts gets through."""
    turn = iter(range(10**6))
    identity = bytes([5, 15, 2, 10]) + (2**21 - 1).to_bytes(4, "little") + b"gof-board test"

    def answer(request):
        if drop[next(turn) % len(drop)]:
            return b""
        sequence = request[3] if request[0] == 0 else 1
        frame = encode_frame(bytes([1, sequence, 0x81, 0]) + identity)
        return b"\0" + frame[:cut] + frame[cut:]

    reached = not all(drop[i % len(drop)] for i in range(3))
    try:
        Board(peer(answer), timeout_s=0.08, ready_s=0).close()
        assert reached
    except BoardError:
        assert not reached


# ---------------------------------------------------------------- boards that reset when their port is opened

BOOT_LOG = (
    b"ets Jul 29 2019 12:21:46\r\n\r\nrst:0x1 (POWERON_RESET),boot:0x13 (SPI_FAST_FLASH_BOOT)\r\n"
    b"load:0x3fff0030,len:7104\r\nentry 0x400805f0\r\n" + bytes(range(1, 256))
)


class BootingBoard:
    """A board that resets at each open: it writes its boot log, and hears nothing until it is ready."""

    def __init__(self, ready_s, zero_first):
        import pty
        import tty

        self.master, client = pty.openpty()
        tty.setraw(client)
        self.port, self.ready_s, self.zero_first = os.ttyname(client), ready_s, zero_first
        os.close(client)
        self.state, self._closing = BoardState.STOPPED, False
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self):
        opened, reader = None, FrameReader()
        while not self._closing:
            try:
                ready, _, _ = select.select([self.master], [], [], 0.01)
                data = os.read(self.master, 4096) if ready else b""
            except OSError:  # nobody has the port open
                opened = None
                time.sleep(0.005)
                continue
            if opened is None:
                opened, self.state = time.monotonic(), BoardState.STOPPED
                os.write(self.master, BOOT_LOG)
            if time.monotonic() - opened < self.ready_s:
                continue
            for payload in reader.push(data):
                body = b""
                if payload[2] == Request.IDENTIFY:
                    body = bytes([5, 15, 2, 10]) + struct.pack("<I", (1 << 21) - 1) + b"gof-board emulated"
                elif payload[2] == Request.START:
                    self.state = BoardState.RUNNING
                elif payload[2] == Request.STATUS:
                    body = struct.pack("<BBIIIIiiII", self.state, 0, 7, 7, 400, 0, 0, 0, 0, 0)
                reply = encode_frame(bytes([1, payload[1], payload[2] | 0x80, 0]) + body)
                os.write(self.master, b"\0" * self.zero_first + reply)

    def close(self):
        self._closing = True
        self._thread.join()
        os.close(self.master)


@pytest.mark.parametrize("zero_first", [True, False], ids=["this firmware", "older firmware"])
@pytest.mark.parametrize("ready_s", [0.3, 0.8, 1.3, 2.5])
def test_a_board_that_resets_at_each_open(ready_s, zero_first, monkeypatch, capsys):
    board = BootingBoard(ready_s, zero_first)
    try:
        monkeypatch.setattr(controller, "candidate_ports", lambda: [board.port])
        assert gof(["capture", "board", "find"]) == 0
        said = capsys.readouterr().out
        assert "gof-board emulated" in said and "resets this board" in said
        assert gof(["capture", "board", "start"]) == 0
        assert "running" in capsys.readouterr().out
    finally:
        board.close()


def test_a_board_that_keeps_running_is_not_said_to_reset(start_emulator, capsys):
    _, port = start_emulator()
    for action in (["start"], ["monitor", "--seconds", "0.2"]):
        assert gof(["capture", "board", *action, "--port", port]) == 0
    said = capsys.readouterr().out
    assert "resets" not in said and said.count("running") >= 2


def test_control_lines_are_off_before_the_port_opens(monkeypatch):
    import serial

    seen = []

    class Line(serial.Serial):
        def open(self):
            seen.append((self.dtr, self.rts))
            raise serial.SerialException(2, "could not find it")

    def line_for(url, *arguments, do_not_open=False, **options):
        line = Line(None, *arguments, **options)
        line.port = url
        return line

    monkeypatch.setattr(serial, "serial_for_url", line_for)
    with pytest.raises(BoardError, match="no such port"):
        Board("/dev/ttyUSB7")
    assert seen == [(False, False)]


def test_the_firmware_ends_other_text_before_it_replies(start_emulator):
    import serial

    _, port = start_emulator()
    with serial.Serial(port, 115200, timeout=1) as line:
        line.write(encode_request(Request.STATUS, 5))
        reply = line.read(1)
        deadline = time.monotonic() + 2
        while not reply.endswith(b"\0", 1) and time.monotonic() < deadline:
            reply += line.read(1)
    assert reply[0] == 0
    payloads = FrameReader().push(b"entry 0x400805f0\r\n" + reply)
    assert len(payloads) == 1 and payloads[0][1] == 5
