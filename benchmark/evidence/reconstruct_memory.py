"""The memory of `gof reconstruct`, predicted and measured.

    python -m gof_benchmark.evidence.reconstruct_memory DATASET

Takes about a minute a row.

Each row is a run of 120 steps in a process of its own, whose largest resident size the system tells.
"""

from __future__ import annotations

import os
import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

import tyro

from gof.dataset import Dataset
from gof.host.processes import python_command
from gof.reconstruct.forecast import ClipShape
from gof.reconstruct.memory import needed_bytes
from gof.reconstruct.methods import METHODS
from gof.reconstruct.shrink import shrink

STEPS = 120


@dataclass
class Config:
    """Predicted and measured peak memory of reconstructions of a dataset."""

    dataset: tyro.conf.Positional[Path]
    runs: tuple[tuple[int, int, int], ...] = ((320, 60_000, 72), (320, 5_000, 72), (320, 250_000, 72))
    """Longest side, Gaussians and voxels of each run."""


def measured_bytes(dataset: Path, side: int, gaussians: int, voxels: int) -> int:
    """Return peak resident size of one run. Raises RuntimeError: it failed."""
    with tempfile.TemporaryDirectory() as out:
        command = python_command("-m", "gof", "reconstruct", str(dataset), "--out", out, "--steps", str(STEPS))
        command += ["--max-size", str(side), "--gaussians", str(gaussians), "--voxels", str(voxels)]
        child = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        _, status, used = os.wait4(child.pid, 0)
    if status:
        raise RuntimeError(f"{' '.join(command)} ended with {status}")
    return used.ru_maxrss * 1024


def main(argv: list[str] | None = None) -> None:
    """Print the table."""
    config = tyro.cli(Config, prog="python -m gof_benchmark.evidence.reconstruct_memory", args=argv)
    print("| longest side | Gaussians | voxels | predicted, MB | measured, MB | off |\n|---|---|---|---|---|---|")
    for side, gaussians, voxels in config.runs:
        clip = ClipShape.of(shrink(Dataset.open(config.dataset), side), METHODS["gof"])
        predicted = needed_bytes(clip.training_px, clip.frames, gaussians, voxels)
        measured = measured_bytes(config.dataset, side, gaussians, voxels)
        off = predicted / measured - 1
        print(f"| {side} | {gaussians} | {voxels} | {predicted / 1e6:.0f} | {measured / 1e6:.0f} | {off:+.0%} |")


if __name__ == "__main__":
    main()
