"""The hazards of a long training: kernels that are compiled once, and memory that stays while the set grows.

    python -m gof_benchmark.evidence.render_lasting [--steps 5000] [--native-only]

Takes about 4 min.

The first table times a step in a process that finds no compiled kernel (empty folders), and in the next one, which
finds them; the second holds the process' memory and the kernels that are new to it along a training in which Gaussians
are added every hundred steps, a fiftieth of the first number each time.
"""

from __future__ import annotations

import os
import tempfile
import time
from dataclasses import dataclass
from unittest.mock import patch

import numpy as np
import tyro

from gof_benchmark.evidence import child
from gof_benchmark.evidence.render_scenes import flame
from gof_benchmark.evidence.render_speed import RandomTraining

KINDS = ("native", "drjit")
EVERY = 100  # steps between additions
SETTLED = 500  # steps
COMPILE_GOAL_S = 15


@dataclass(frozen=True)
class RenderLasting:
    """Time the first step of a machine, and watch memory over a long training."""

    steps: int = 5000
    """For the training."""
    gaussians: int = 20_000
    """At its start; after 5000 steps there are twice as many."""
    width: int = 320
    """px."""
    height: int = 180
    """px."""
    native_only: bool = False
    """Leave Dr.Jit's kernels out."""


def first_step() -> tuple[float, float]:
    """Return (wall, CPU) seconds from the import of the renderer to the end of a process' first step."""
    wall, cpu = time.perf_counter(), time.process_time()
    RandomTraining(5_000, 160, 90).step()
    return time.perf_counter() - wall, time.process_time() - cpu


def long_training(steps: int, n: int, width: int, height: int) -> list[tuple[int, int, float, int]]:
    """Return (step, Gaussians, memory in MB, kernels that the process met for the first time since the line before)."""
    import drjit as dr
    import psutil

    training, process, rows = RandomTraining(n, width, height), psutil.Process(), []
    more = flame(n // 50, seed=1)
    new = 0
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        for step in range(1, steps + 1):
            training.step()
            if step % EVERY == 0:
                met = [k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT]
                new += sum(k["cache_disk"] or not k["cache_hit"] for k in met)
                dr.kernel_history_clear()  # it is memory too
                training.add(more)
            if step in (EVERY, SETTLED) or step % 1000 == 0:
                rows.append((step, training.n, process.memory_info().rss / 1e6, new))
                new = 0
    return rows


def main(argv: list[str] | None = None) -> None:
    """Print both tables."""
    config = tyro.cli(RenderLasting, prog="python -m gof_benchmark.evidence.render_lasting", args=argv)
    print("first step of a process, seconds: by the clock, CPU")
    for kind in KINDS[: 1 if config.native_only else None]:
        with tempfile.TemporaryDirectory() as empty:
            with patch.dict(os.environ, HOME=empty, NUMBA_CACHE_DIR=empty, GOF_RENDER_KERNELS=kind):
                for name in ("nothing compiled", "compiled before"):
                    wall, cpu = child.call(first_step)
                    print(f"{kind:8s}{name:20s}{wall:8.1f}{cpu:8.1f}  goal {COMPILE_GOAL_S}", flush=True)
    size = config.steps, config.gaussians, config.width, config.height
    for kind in KINDS[: 1 if config.native_only else None]:
        with patch.dict(os.environ, GOF_RENDER_KERNELS=kind):
            rows = child.call(long_training, *size)
        print(f"\n{kind}, {config.width}x{config.height}\n{'step':>8s}{'Gaussians':>12s}{'MB':>8s}{'new kernels':>13s}")
        for step, n, megabytes, new in rows:
            print(f"{step:8d}{n:12d}{megabytes:8.1f}{new:13d}")
        late = np.array([row[2] for row in rows if row[0] >= 2 * SETTLED])
        if len(late) > 1:
            print(f"memory from step {2 * SETTLED} on: {late.min():.1f} to {late.max():.1f} MB")


if __name__ == "__main__":
    main()
