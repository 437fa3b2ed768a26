"""`gof capture board ...`: find, set, start, stop, test and monitor an LED board."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from typing import Annotated, Literal

import tyro

from gof.capture.controller import RESET_SAID, Board, BoardError, ask_ports, candidate_ports, only_board
from gof.capture.protocol import BoardState, Status
from gof.commands.everywhere import write_figures
from gof.commands.read import Seconds, read_options
from gof.host.options import require_not_given, require_number

MOST_JITTER_US = 20.0  # of a tick: the order of what cameras' times are read to
MOST_DAMAGED = 10
ONLY_FOR = {"tick_us": "set", "count": "set", "light": "test", "seconds": "monitor"}  # options by their only action


@dataclass(frozen=True)
class BoardConfig:
    """Talk to the LED board over USB.

    Examples:
      gof capture board find
      gof capture board start

    find: list boards.  set: write --tick-us and --count.  start, stop: the clock (stop goes dark).  monitor: watch
    counter and jitter until Ctrl-C.  test: light --light.  self-test: name stuck and bridged outputs.
    """

    action: tyro.conf.Positional[Literal["find", "set", "start", "stop", "monitor", "test", "self-test"]]
    """Action on the board."""
    port: str | None = None
    """Serial port. Default: that of the only board plugged in."""
    tick_us: Annotated[int | None, tyro.conf.arg(metavar="US")] = None
    """set: length of a tick (a period is 10 ticks; 400 suits 400 fps)."""
    count: int | None = None
    """set: where the counter starts."""
    light: Annotated[str, tyro.conf.arg(metavar="all|none|N")] = "all"
    """test: which outputs to light; one alone by its number: strips 0-4, Gray bits 5-19, disambiguation LED 20."""
    seconds: Seconds | None = None
    """monitor: stop after this long instead of at Ctrl-C."""


def main(argv: list[str]) -> int:
    """Run one board action. Raises BoardError or ProtocolError with what to do."""
    config = read_options(BoardConfig, "capture board", argv)
    require_number("--seconds", config.seconds, least=0)
    idle = [name for name, action in ONLY_FOR.items() if action != config.action]
    require_not_given(config, idle, f"changes nothing in {config.action}")
    outcome = _find() if config.action == "find" and config.port is None else _act(config)
    write_figures(outcome)
    return 1 if outcome.get("bad_outputs") else 0


def _find() -> dict:
    boards = ask_ports()
    for board in boards:
        identity = board.identity
        print(f"{board.port}  {identity.name}  {len(identity.outputs)} outputs, {identity.gray_bits} Gray bits")
        if board.was_reset:
            print(f"{board.port}: {RESET_SAID}")
    if not boards:
        ports = candidate_ports()
        looked = f"asked {', '.join(ports)}: no board answered" if ports else "no USB serial port is present"
        raise BoardError(
            f"no LED board found ({looked}). Use a USB cable that carries data, flash the firmware "
            "(docs/capture_board.md), or name the port with --port"
        )
    return {"boards": [{"port": b.port, **asdict(b.identity), "was_reset": b.was_reset} for b in boards]}


def _act(config: BoardConfig) -> dict:
    port = config.port or only_board()
    with Board(port) as board:
        outcome: dict = {"port": port, **asdict(board.identity), "was_reset": board.was_reset}
        if board.was_reset:
            print(f"{port}: {RESET_SAID}")
        match config.action:
            case "find":
                print(f"{port}  {board.identity.name}  {len(board.identity.outputs)} outputs")
            case "set":
                if config.tick_us is None and config.count is None:
                    raise BoardError("set: give --tick-us, --count or both")
                if config.tick_us is not None:
                    board.set_tick(config.tick_us)
                if config.count is not None:
                    board.arm(config.count)
            case "start":
                board.start()
            case "stop":
                board.stop()
            case "test":
                board.show_test(*pattern(config.light))
            case "self-test":
                outcome["bad_outputs"] = bad = board.self_test()
                print("all outputs follow" if not bad else "these outputs do not follow: " + ", ".join(bad))
            case "monitor":
                _monitor(board, config.seconds)
        status = board.status()
        outcome["status"] = asdict(status) | {"state": status.state.name}
        if config.action not in ("find", "monitor", "self-test"):
            print(describe(status))
        for text in judge(status):
            print(f"warning: {text}")
    return outcome


def pattern(light: str) -> tuple[Literal["all_off", "all_on", "one"], int]:
    """Return the pattern and the output of --light. Raises BoardError: it is neither a word nor a number."""
    if light in ("all", "none"):
        return ("all_on" if light == "all" else "all_off"), 0
    if not light.isdecimal():
        raise BoardError(f"--light {light}: give all, none, or the number of an output")
    return "one", int(light)


def judge(status: Status) -> list[str]:
    """Return warnings about a board's own figures."""
    found = []
    worst = max(abs(status.earliest_ns), abs(status.latest_ns)) / 1000
    if status.ticks and worst > MOST_JITTER_US:
        found.append(f"a tick was up to {worst:.0f} us off: times read from the board are as wrong as that")
    if status.bad_frames > MOST_DAMAGED:
        found.append(f"{status.bad_frames} damaged requests reached the board: is the cable long or loose?")
    return found


def describe(status: Status) -> str:
    """Return one line: state, counter, clock, jitter."""
    period_ms = status.tick_us / 100
    line = f"{status.state.name.lower():<8} count {status.count:5d}.{status.phase}  period {period_ms:g} ms"
    if status.ticks:
        line += (
            f"  ticks {status.ticks}  jitter {status.earliest_ns / 1000:+.2f}..{status.latest_ns / 1000:+.2f} us,"
            f" mean {status.mean_abs_ns / 1000:.2f} us"
        )
    return line + (f"  damaged frames {status.bad_frames}" if status.bad_frames else "")


def _monitor(board: Board, seconds: float | None) -> None:
    from rich.console import Console
    from rich.live import Live

    end = time.monotonic() + seconds if seconds is not None else float("inf")
    console = Console()
    with Live(console=console, refresh_per_second=8) as live:
        while time.monotonic() < end:
            status = board.status()
            gray = status.count ^ status.count >> 1
            leds = "".join("#" if gray >> i & 1 else "." for i in range(board.identity.gray_bits))
            strips = "".join(
                "#"
                if status.state == BoardState.RUNNING and status.phase // board.identity.ticks_per_slot == i
                else "."
                for i in range(board.identity.strips)
            )
            live.update(f"{board.port}  strips {strips}  Gray {leds}\n{describe(status)}")
            time.sleep(0.125)
    if not console.is_terminal:
        print()  # rich leaves the last line open
