"""`gof background`: the fire-free scene of a dataset as static Gaussians."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import tyro

from gof.core.costs import StageLog
from gof.core.files import write_json
from gof.reconstruct.background import BackgroundOptions, add_flame, make_background


@dataclass
class BackgroundConfig:
    """The scene without fire as static Gaussians: background.npz and background.ply, for views that no camera took."""

    dataset: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="DATASET")]]
    """Dataset folder. Uses its depth/CAMERA.npy (from `gof ingest --depth`), else stereo between its plates."""
    out: Path | None = None
    """Folder for the result; a finished one there is kept. Default: beside the dataset, DATASET_background."""
    steps: int = BackgroundOptions.steps
    """Optimisation steps, one plate each; the paper's are 10 000."""
    gaussians: int = BackgroundOptions.gaussians
    """Largest number of Gaussians."""
    longest_side: int = BackgroundOptions.longest_side
    """Pictures with a longer side, in pixels, are shrunk to it."""
    depth_term: bool = BackgroundOptions.depth_term
    """Hold the Gaussians to the depth maps."""
    depth_weights: Path | None = None
    """Folder of a Depth-Anything-V2 checkpoint that completes stereo depth; without it edges of the plate do.
    Never downloaded, and never run with published weights."""
    flame: Path | None = None
    """Result of `gof reconstruct` to add: scene.npz and scene.ply hold both."""
    seed: int = BackgroundOptions.seed
    """Random seed of the order of pictures and of splitting."""
    json: Path | None = None
    """Also write the summary to this file."""


def main(argv: list[str]) -> int:
    """`gof background DATASET [--out DIR]`; see --help."""
    config = tyro.cli(BackgroundConfig, prog="gof background", args=argv)
    options = BackgroundOptions(
        config.steps, config.gaussians, config.longest_side, config.depth_term, config.depth_weights, config.seed
    )
    out = config.out or config.dataset.absolute().parent / f"{config.dataset.absolute().name}_background"
    gaussians = make_background(config.dataset, out, options)
    if config.flame is not None:
        add_flame(gaussians, config.flame, out)
    stages = StageLog(out / "costs.json").stages()
    result = out / "background.npz"
    if config.json:
        summary = {"result": str(result), "gaussians": len(gaussians), "stages": [asdict(s) for s in stages]}
        write_json(config.json, summary)
    for stage in stages:
        print(f"{stage.name:<12} {stage.seconds:8.1f} s {stage.peak_mb:8.0f} MB")
    print(f"{len(gaussians)} Gaussians -> {result}")
    return 0
