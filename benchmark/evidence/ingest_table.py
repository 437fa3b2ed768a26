"""Findings of `gof ingest` in real clips, one row a dataset: poses, their checks, the vertical, fire left in the
plates.

    python -m gof_benchmark.evidence.ingest_table DATASET...

Nothing is computed anew: the figures are those of poses.json and dataset.json, and the cameras' angles and distances.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import tyro

from gof.dataset import Dataset
from gof.dataset.poses import Poses, UpReport

HEAD = ("clip", "poses", "turns 01, 12", "baselines 12/01", "board px", "least matches", "up", "fire left, %")


@dataclass
class TableConfig:
    """Tabulate the findings of `gof ingest` in real clips, one row a dataset."""

    datasets: tyro.conf.Positional[list[Path]]
    """Folders made by `gof ingest`."""


def main(argv: list[str]) -> None:
    """Print the table."""
    config = tyro.cli(TableConfig, prog="python -m gof_benchmark.evidence.ingest_table", args=argv)
    for row in (HEAD, ("---",) * len(HEAD), *map(row_of, config.datasets)):
        print("| " + " | ".join(row) + " |")


def row_of(folder: Path) -> tuple[str, ...]:
    """Return one dataset's row."""
    dataset, poses = Dataset.open(folder), Poses.read(folder)
    report = poses.report
    cameras = [camera.world_to_camera for camera in dataset.cameras]
    turns = [_turn_deg(a, b) for a, b in pairwise(cameras)]
    steps = np.linalg.norm(np.diff([camera.position for camera in dataset.cameras], axis=0), axis=1)
    matches = min(report.consistent.values()) if report.consistent else float("nan")
    left = dataset.description.provenance.get("fire_left", {})
    return (
        folder.name,
        report.method,
        ", ".join(f"{turn:.2f}" for turn in turns),
        ", ".join(f"{b / steps[0]:.2f}" for b in steps[1:]),
        "-" if report.check is None or report.check.reprojection_px is None else f"{report.check.reprojection_px:.2f}",
        f"{matches:.0%}",
        _up(report.up),
        ", ".join(f"{100 * share:.2f}" for share in left.values()),
    )


def _turn_deg(a: np.ndarray, b: np.ndarray) -> float:
    """Return angle in degrees between two cameras (4, 4)."""
    return float(np.rad2deg(np.arccos(np.clip((np.trace(a[:3, :3] @ b[:3, :3].T) - 1) / 2, -1, 1))))


def _up(up: UpReport | None) -> str:
    if up is None:
        return "with the poses"
    spread = "" if up.spread_deg is None else f" ± {up.spread_deg:.1f}"
    return f"{up.source}: {up.lean_deg:.1f}{spread} deg from the cameras'"


if __name__ == "__main__":
    main(sys.argv[1:])
