"""A flame before plates, and in a still scene of Gaussians: motion, pictures, novel views, seconds; and a picture.

    python -m gof_benchmark.evidence.scene_model DATASET RESULT ... [--picture FILE]

Takes about 20 s a result, once it is there.

DATASET has true velocity and a camera of role "eval"; the RESULTs are folders of `gof reconstruct` of it, with `--scene
plates`, `--scene gaussians`, `--method paper`. Pictures' scores are those of curve.json (held-out frames; the flame's
pixels). FILE shows the middle camera's held-out frame above the view that no method was given, truth first, then each
result; flames without a scene of their own are drawn over black there.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from gof.core.costs import StageLog
from gof.core.gaussians import TransientGaussians
from gof.dataset import Dataset
from gof.dataset.plates import background
from gof.evaluate import evaluate
from gof.footage.pictures import write_picture
from gof.reconstruct.curve import Curve
from gof.render import render
from gof_benchmark.training.field_score import open_small


@dataclass(frozen=True)
class SceneModel:
    """Results with plates and with a still scene side by side."""

    dataset: tyro.conf.Positional[Path]
    """With true velocity and a camera for novel views."""
    results: tyro.conf.Positional[tuple[Path, ...]]
    """Folders of `gof reconstruct`."""
    picture: Path | None = None
    """Where to write the comparison."""


def row(result: Path, dataset: Dataset) -> str:
    """Return a line of the table."""
    velocity = evaluate(result / "result.npz", dataset, images=False).dve
    scores = Curve.read(result).points[-1].scores
    pictures = [scores.psnr_flame, scores.ssim_flame, scores.psnr, scores.psnr_flame_novel]
    seconds = sum(stage.seconds for stage in StageLog(result / "costs.json").stages())
    cells = ["-" if value is None else f"{value:.2f}" for value in pictures]
    return f"| {result.name} | {velocity.l2:.3f} | {velocity.cos_sim:.3f} | {' | '.join(cells)} | {seconds:.0f} |"


def views(dataset: Dataset, result: Path | None) -> np.ndarray:
    """Return (2 H, W, 3): the middle camera and the first novel one at a held-out frame; without a result, the
    truth."""
    novel = dataset.evaluation_view()
    frame = dataset.test_frames[len(dataset.test_frames) // 2]
    middle = len(dataset.cameras) // 2
    if result is None:
        return np.vstack([dataset.image(middle, frame), novel.image(0, frame)])
    gaussians = TransientGaussians.load(result / "result.npz")
    plate = background(dataset, middle, result) if gaussians.dynamic.all() else None
    time_s = float(dataset.times_s[frame])
    pairs = ((dataset.cameras[middle], plate), (novel.cameras[0], None))
    return np.vstack([render(gaussians, camera, time_s, background=behind)["color"] for camera, behind in pairs])


def main(argv: list[str] | None = None) -> None:
    """Print the table, and write the picture."""
    config = tyro.cli(SceneModel, prog="python -m gof_benchmark.evidence.scene_model", args=argv)
    dataset = open_small(config.dataset)
    print("| result | L2 | CosSim | PSNR flame | SSIM flame | PSNR | PSNR flame, novel view | s |")
    print("|---|---|---|---|---|---|---|---|")
    for result in config.results:
        print(row(result, dataset), flush=True)
    if config.picture:
        shown = np.hstack([views(dataset, result) for result in (None, *config.results)])
        write_picture(config.picture, np.rint(255 * np.clip(shown[..., ::-1], 0, 1)).astype(np.uint8))


if __name__ == "__main__":
    main()
