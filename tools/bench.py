"""CPU seconds of eight functions at two commits, on this machine at the same time: is the working tree slower?

python tools/bench.py [COMMIT]        the working tree against COMMIT (default: HEAD)
python tools/bench.py --child         time this checkout's functions once, as JSON (how the two are measured)

Each round starts a process for either, in turns, so that a busy moment meets both; a figure is the median over rounds
of each process's cheapest call, in CPU seconds of all its threads and children, which other work on the machine changes
less than the clock's. A ratio above 1 says that the working tree is slower.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
ROUNDS = 5
CALLS, LONG_ENOUGH_S = 20, 1.0  # at most so many calls of a function, and no more once they took so long
Call = Callable[[], object]


def _gaussians(count: int):
    """Return a flame-like column of Gaussians, 1.2 m high, that live for a tenth of a second each."""
    import numpy as np

    from gof.core.gaussians import TransientGaussians

    r = np.random.default_rng(0)
    position = r.normal(size=(count, 3)) * (0.1, 0.1, 0.3) + (0, 0, 0.6)
    return TransientGaussians(
        position,
        r.normal(size=(count, 3)),
        r.uniform(0, 0.3, count),
        np.full(count, 0.05),
        np.exp(r.normal(np.log(0.01), 0.4, (count, 3))),
        r.normal(size=(count, 4)),
        r.uniform(0.05, 0.3, count),
        r.random((count, 3)),
        np.ones(count, bool),
    )


def _field():
    """Return a swirl of 64^3 cells of 2.5 cm."""
    import numpy as np

    from gof.core.fields import VelocityField

    axis = (np.arange(64) - 32) * 0.025
    x, y, _ = np.meshgrid(axis, axis, axis, indexing="ij")
    return VelocityField.from_array(np.stack([-y, x, np.ones_like(x)], -1), (-0.8, -0.8, 0.0), 0.025, 0.0)


def draw(folder: Path) -> Call:
    """Draw 20 000 Gaussians at 360 x 640."""
    import numpy as np

    from gof.core.cameras import Camera
    from gof.render import render

    view = np.array([[1, 0, 0, 0], [0, 0, -1, 0.6], [0, 1, 0, 2.0], [0, 0, 0, 1.0]])
    camera, gaussians = Camera("c", 360, 640, [[600, 0, 180], [0, 600, 320], [0, 0, 1]], view), _gaussians(20_000)
    return lambda: render(gaussians, camera, 0.15)


def save_and_load(folder: Path) -> Call:
    """Write and read a result of 100 000 Gaussians as npz."""
    from gof.core.gaussians import TransientGaussians

    gaussians = _gaussians(100_000)
    return lambda: TransientGaussians.load(gaussians.save(folder / "r.npz"))


def save_and_load_ply(folder: Path) -> Call:
    """Write and read a result of 100 000 Gaussians as PLY."""
    from gof.core.gaussians import TransientGaussians

    gaussians = _gaussians(100_000)
    return lambda: TransientGaussians.load(gaussians.save(folder / "r.ply"))


def sample_field(folder: Path) -> Call:
    """Look up 300 000 places in a grid of 64^3 cells."""
    import numpy as np

    field, points = _field(), np.random.default_rng(0).uniform(-0.7, 0.7, (300_000, 3))
    return lambda: field.sample(points)


def score_motion(folder: Path) -> Call:
    """Score the motion of 5000 Gaussians against a grid (DVE of one frame)."""
    from gof.evaluate import dve

    field, gaussians = _field(), _gaussians(5000)
    return lambda: dve(gaussians, field, 0.15)


def score_picture(folder: Path) -> Call:
    """Compare two pictures by SSIM, of 720 x 1280."""
    import numpy as np

    from gof.evaluate.image import ssim

    a, b = np.random.default_rng(0).random((2, 1280, 720, 3))
    return lambda: ssim(a, b)


def median_plate(folder: Path) -> Call:
    """Take the median over a clip of 24 pictures of 360 x 640."""
    import numpy as np

    from gof.ingest.over_time import median

    clip = list(np.random.default_rng(0).integers(0, 255, (24, 640, 360, 3), np.uint8))
    return lambda: median(clip)


def start(folder: Path) -> Call:
    """Start `gof --help` in a process of its own."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(p for p in sys.path[1:2] if p)}
    command = [sys.executable, "-m", "gof", "--help"]
    return lambda: subprocess.run(command, env=environment, check=True, stdout=subprocess.DEVNULL)


FUNCTIONS = (draw, save_and_load, save_and_load_ply, sample_field, score_motion, score_picture, median_plate, start)


def cpu_seconds() -> float:
    """Return the CPU seconds of this process so far, of all its threads and of children that ended."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def measured() -> dict[str, float | None]:
    """Return the CPU seconds of each function's cheapest call; None where this checkout has no such function."""
    found: dict[str, float | None] = {}
    with tempfile.TemporaryDirectory() as folder:
        for function in FUNCTIONS:
            try:
                call = function(Path(folder))
                call()  # compiles and fills caches
            except (ImportError, AttributeError, TypeError):
                found[function.__name__] = None
                continue
            costs: list[float] = []
            while len(costs) < CALLS and sum(costs) < LONG_ENOUGH_S:
                before = cpu_seconds()
                call()
                costs.append(cpu_seconds() - before)
            found[function.__name__] = min(costs)
    return found


def child(checkout: Path) -> dict[str, float | None]:
    """Return the result of `measured` in a process whose `gof` is a checkout's."""
    environment = os.environ | {"PYTHONPATH": str(checkout)}
    command = [sys.executable, str(Path(__file__).resolve()), "--child"]
    done = subprocess.run(command, cwd=checkout, env=environment, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{checkout}: {done.stderr[-2000:]}")
    return json.loads(done.stdout.splitlines()[-1])


def table(ours: list[dict], theirs: list[dict], commit: str) -> str:
    """Return the medians over rounds, and their ratios, as text."""
    lines = [f"{'':<18} {'working tree':>14} {commit[:12]:>14} {'ratio':>7}"]
    for name in ours[0]:
        pair = [[one[name] for one in rounds if one[name] is not None] for rounds in (ours, theirs)]
        seconds = [statistics.median(values) if values else None for values in pair]
        shown = [f"{1000 * value:.2f} ms" if value else "absent" for value in seconds]
        ratio = f"{seconds[0] / seconds[1]:.2f}" if all(seconds) else ""
        lines.append(f"{name:<18} {shown[0]:>14} {shown[1]:>14} {ratio:>7}")
    return "\n".join(lines)


def compare(commit: str, rounds: int) -> str:
    """Return the table of the working tree against a commit, which is checked out for the time."""
    with tempfile.TemporaryDirectory() as folder:
        other = Path(folder) / "other"
        git = ["git", "-C", str(ROOT), "worktree"]
        subprocess.run([*git, "add", "--quiet", "--detach", str(other), commit], check=True)
        try:
            ours, theirs = [], []
            for number in range(rounds):
                order = ((ROOT, ours), (other, theirs))
                for checkout, found in order if number % 2 == 0 else reversed(order):
                    found.append(child(checkout))
                print(f"round {number + 1} of {rounds}", file=sys.stderr)
        finally:
            subprocess.run([*git, "remove", "--force", str(other)], check=True)
    if absent := [name for name, seconds in ours[0].items() if seconds is None]:
        raise SystemExit(f"the working tree lacks what tools/bench.py calls: {', '.join(absent)}")
    return table(ours, theirs, commit)


def main() -> int:
    """Compare two commits, or measure one."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("commit", nargs="?", default="HEAD")
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    print(json.dumps(measured()) if options.child else compare(options.commit, options.rounds))
    return 0


if __name__ == "__main__":
    sys.exit(main())
