"""Which sockets each command listens on: none, but for `gof view`, and that on loopback.

    python -m gof_benchmark.evidence.open_sockets

Takes about 4 min.

Every command runs as a user runs it, on a toy scene; ten times a second the sockets of its processes are listed.
Left out: what needs a camera rig (the rest of `gof capture`) and what calls the commands above (the other studies and
parts of `gof benchmark`).
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import psutil
import tyro

from gof.core.files import write_json
from gof.dataset import Dataset
from gof.host.processes import python_command

EVERY_S = 0.1
LOOKED_AT_S = 20.0  # `gof view` ends only on a signal


@dataclass
class OpenSockets:
    """A toy scene through every command, and what its processes listened on meanwhile."""

    out: Path = Path("out/open-sockets")
    """Folder for what the commands make; an empty one."""


def commands(out: Path) -> Iterator[tuple[str, list[str]]]:
    """Yield a command's name and its arguments, in the order of the work; what needs files of ours finds them
    written."""
    data, work, packed = str(out / "data"), str(out / "work"), str(out / "packed")
    result, effort = f"{work}/result.npz", ["--steps", "20", "--gaussians", "500", "--voxels", "16"]
    yield "generate", ["demo", "--preset", "toy", "--out", data, "--views", "nerfstudio", "dynerf"]
    filmed = Dataset.open(data)
    cameras = [
        {"width": c.width, "height": c.height, "K": c.K, "world_to_camera": c.world_to_camera} for c in filmed.cameras
    ]
    write_json(out / "cameras.json", {"cameras": json.loads(json.dumps(cameras, default=np.ndarray.tolist))})
    pictures = [f"{data}/cameras/{camera.name}/rgb" for camera in filmed.cameras]
    fps = str(1 / (filmed.times_s[1] - filmed.times_s[0]))
    known = ["--cameras", str(out / "cameras.json"), "--plates", f"{data}/static", "--board", "none", "--times", fps]
    yield "ingest", [*pictures, "--out", str(out / "filmed"), *known]
    yield "background", [data, "--out", str(out / "background"), "--steps", "5", "--gaussians", "1000"]
    yield "reconstruct", [data, "--out", work, *effort]
    yield "depth", [data, "--out", str(out / "depth"), "--all-frames"]
    yield "evaluate", [result, "--dataset", data, "--out", work]
    yield "convert", [result, str(out / "converted.ply")]
    yield "share", [work, "--dataset", data]
    yield "video", [work, "--dataset", data, "--style", "seconds=1", "--fps", "5"]
    yield "leaderboard", [work, "--dataset", data, "--out", str(out / "board")]
    yield "import", [result, "--dataset", data, "--out", str(out / "scene.blend")]
    yield "report", [work, "--dataset", data]
    yield "view", [result, "--dataset", data, "--port", "0"]
    yield "pack", [data, "--licence", "CC0-1.0", "--authors", "A. Author", "--out", packed]
    yield "unpack", [f"{packed}/data.tar", "--out", str(out / "unpacked")]
    yield "study score", [result, "--dataset", data]
    yield "benchmark list", []
    yield "capture target", ["--out", str(out / "charuco.svg")]
    yield "capture draw", ["--out", str(out / "board.svg")]
    (out / "script.py").write_text("import torch\nprint(torch.zeros(3, device='cuda').sum())\n", encoding="utf-8")
    yield "baseline", ["--method", "3dgs", str(out / "script.py")]
    yield "demo", ["--preset", "toy", "--out", str(out / "demo"), *effort[:4]]
    yield "doctor", []


def listened(name: str, arguments: list[str], log: Path) -> tuple[set[str], int | None]:
    """Addresses without their ports, and the exit status; None of a command that had to be ended."""
    found: set[str] = set()
    with open(log, "ab") as file:
        child = psutil.Popen(
            python_command("-m", "gof", *name.split(), *arguments), stdout=file, stderr=subprocess.STDOUT
        )
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
    for name, arguments in commands(config.out):
        found, status = listened(name, arguments, config.out / "log")
        print(f"| `gof {name}` | {', '.join(sorted(found)) or 'nothing'} |", flush=True)
        if status not in (0, None) or found != ({"127.0.0.1"} if name == "view" else set()):
            wrong.append(f"{name}: status {status}, {sorted(found)}; see {config.out / 'log'}")
    print("\n".join(wrong))
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
