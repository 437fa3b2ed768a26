"""How good a flame is that one camera or two have filmed: simulated fires from a part of their cameras.

    python -m gof_benchmark.evidence.few_cameras DATASET... [--out out/few_cameras] [--json FILE]

Takes about 4 min a dataset of three cameras. Needs datasets with ground truth and views from all around.

One camera is the middle one, two are that one and its neighbour, and all are all. Sides are views from all around
that stand within 22.5 degrees of `SIDES` from the nearest given camera.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from gof.core.errors import GofError
from gof.core.files import write_json
from gof.dataset import Dataset
from gof.evaluate.scores import AroundScore, Scores, VelocityScore
from gof.evaluate.scoring import evaluate
from gof.reconstruct.pipeline import reconstruct
from gof.reconstruct.presets import effort_of, size_of
from gof.reconstruct.settings import ReconstructionSettings
from gof_benchmark.evidence.held_out_camera import hold_out

SIDES = 45, 90, 135  # degrees


@dataclass(frozen=True)
class FewCameras:
    """Reconstruct datasets from one camera, two, and all. Prints a table."""

    datasets: tyro.conf.Positional[tuple[Path, ...]]
    """Folders of `gof generate`."""
    out: Path = Path("out/few_cameras")
    """Folder for the reconstructions; finished ones are kept."""
    preset: str = "preview"
    """For every reconstruction."""
    steps: int | None = None
    """Instead of the preset's."""
    json: Path | None = None
    """Also write every figure to this file."""


def choose_cameras(count: int) -> dict[str, list[int]]:
    """Return which of `count` cameras are given, by name."""
    middle = count // 2
    some = {"one camera": [middle], "two cameras": [middle - 1, middle]} if count > 2 else {}
    return some | {"all cameras": list(range(count))}


def give_only(dataset: Dataset, cameras: list[int]) -> Dataset:
    """Return the dataset with the other training cameras for novel views."""
    for camera in reversed(range(len(dataset.cameras))):
        if camera not in cameras:
            dataset = hold_out(dataset, camera)
    return dataset


def score_part(dataset: Dataset, folder: Path, config: FewCameras) -> tuple[VelocityScore, Scores]:
    """Reconstruct to a folder; return its score of velocity, and all. Raises GofError: no true velocity."""
    effort = effort_of(config.preset, config.steps, clip=size_of(dataset))
    reconstruct(dataset, ReconstructionSettings.of(dataset, effort), folder)
    scores = evaluate(folder, dataset)
    if scores.dve is None:
        raise GofError(f"{folder}: its dataset has no true velocity; give one of `gof generate`")
    return scores.dve, scores


def at_sides(around: Sequence[AroundScore]) -> list[float]:
    """Return the mean PSNR of the flame at each of SIDES, dB; NaN where no view is. Not of the view from above."""
    seen = [(v.angle_deg, v.psnr_flame) for v in around if v.psnr_flame is not None and "top" not in v.camera]
    found = [[psnr for angle, psnr in seen if abs(angle - side) <= 22.5] for side in SIDES]
    return [float(np.mean(psnr)) if psnr else float("nan") for psnr in found]


def main(argv: list[str] | None = None) -> None:
    """Print the table."""
    config = tyro.cli(FewCameras, prog="python -m gof_benchmark.evidence.few_cameras", args=argv)
    sides = " | ".join(f"{side} degrees" for side in SIDES)
    print(f"| fire, given | L2 | constant: L2 | PSNR flame, own | {sides} |\n|---|---|---|---|---|---|---|")
    rows = {}
    for path in config.datasets:
        dataset = Dataset.open(path)
        for name, cameras in choose_cameras(len(dataset.cameras)).items():
            folder = config.out / path.name / name.replace(" ", "_")
            dve, scores = score_part(give_only(dataset, cameras), folder, config)
            motion, seen = (
                [dve.l2, scores.trivial_baselines["constant"].l2],
                [scores.psnr_flame, *at_sides(scores.around)],
            )
            rows[f"{path.name}, {name}"] = motion + seen
            cells = " | ".join([*(f"{l2:.3f}" for l2 in motion), *(f"{psnr:.1f}" for psnr in seen)])
            print(f"| {path.name}, {name} | {cells} |", flush=True)
    if config.json:
        write_json(config.json, rows)


if __name__ == "__main__":
    main()
