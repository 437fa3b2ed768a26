"""Which sockets each command listens on: none, but for `gof view`, and that on loopback.

Every command runs as a user runs it, on a toy scene; ten times a second its processes are asked what they listen on.
"""

from __future__ import annotations

import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import psutil
import tyro

EVERY_S = 0.1
LOOKED_AT_S = 20.0  # `gof view` ends only when it is told to


@dataclass
class OpenSockets:
    """A toy scene through every command, and what its processes listened on meanwhile."""

    out: Path = Path("out/open-sockets")
    """Folder for what the commands make; an empty one."""


def commands(out: Path) -> dict[str, list[str]]:
    """Arguments by the command's name, in the order of the work."""
    data, work = str(out / "data"), str(out / "work")
    result, effort = f"{work}/result.npz", ["--iterations", "20", "--gaussians", "500", "--voxels", "16"]
    return {
        "generate": ["demo", "--preset", "toy", "--out", data, "--views", "nerfstudio", "dynerf"],
        "background": [data, "--out", str(out / "background"), "--steps", "5", "--gaussians", "1000"],
        "reconstruct": [data, "--out", work, *effort],
        "evaluate": [result, "--truth", data, "--out", work],
        "convert": [result, str(out / "converted.ply")],
        "share": [work, "--dataset", data],
        "leaderboard": [work, "--truth", data, "--out", str(out / "board")],
        "import": [result, "--dataset", data, "--blend", str(out / "scene.blend"), "--samples", "1"],
        "report": [work, "--dataset", data],
        "view": [result, "--dataset", data, "--port", "0"],
        "doctor": [],
    }


def listened(name: str, arguments: list[str], log: Path) -> tuple[set[str], int | None]:
    """Addresses without their ports, and the exit status; None of a command that had to be ended."""
    found: set[str] = set()
    with open(log, "ab") as file:
        child = psutil.Popen([sys.executable, "-m", "gof", name, *arguments], stdout=file, stderr=subprocess.STDOUT)
    end = time.monotonic() + LOOKED_AT_S if name == "view" else float("inf")
    while child.poll() is None and time.monotonic() < end:
        for process in (child, *child.children(recursive=True)):
            try:
                connections = process.net_connections(kind="inet")
            except psutil.Error:  # it has just ended
                continue
            found |= {c.laddr.ip for c in connections if c.status == psutil.CONN_LISTEN}
        time.sleep(EVERY_S)
    status = child.poll()
    if status is None:
        child.terminate()
        child.wait()
    return found, status


def main(argv: list[str] | None = None) -> int:
    """Print the table. Returns 1 if a command failed, or listened on more than it should."""
    config = tyro.cli(OpenSockets, prog="python -m gof_benchmark.evidence.open_sockets", args=argv)
    config.out.mkdir(parents=True, exist_ok=True)
    print("| command | listens on |\n|---|---|")
    wrong = []
    for name, arguments in commands(config.out).items():
        found, status = listened(name, arguments, config.out / "log")
        print(f"| `gof {name}` | {', '.join(sorted(found)) or 'nothing'} |", flush=True)
        if status not in (0, None) or found != ({"127.0.0.1"} if name == "view" else set()):
            wrong.append(f"{name}: status {status}, {sorted(found)}; see {config.out / 'log'}")
    print("\n".join(wrong))
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
