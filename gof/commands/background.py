"""`gof background`: the fire-free scene of a dataset as static Gaussians."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import tyro

from gof.commands.everywhere import may_overwrite, next_to, write_figures
from gof.commands.read import Pixels, read_options
from gof.core.costs import StageLog
from gof.look.player.opened import open_result
from gof.reconstruct.background import BackgroundOptions, add_flame, make_background


@dataclass
class BackgroundConfig:
    """The scene without fire as static Gaussians: background.npz and background.ply, for views that no camera took.

    Examples:
      gof background data/fire
    """

    FIRST: ClassVar = ("out", "steps", "gaussians", "max_size", "flame")

    dataset: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="DATASET")]]
    """Dataset folder. Uses its depth/CAMERA.npy (from `gof depth --plates`), else stereo between its plates."""
    out: Path | None = None
    """Folder for the result; a finished one there is kept. Default: beside the dataset, DATASET_background."""
    steps: int = BackgroundOptions.steps
    """Optimisation steps, one plate each; the paper's are 10 000."""
    gaussians: int = BackgroundOptions.gaussians
    """Largest number of Gaussians."""
    max_size: Pixels = BackgroundOptions.longest_side
    """Pictures with a longer side are shrunk to it."""
    flame: Path | None = None
    """Result of `gof reconstruct` to add: scene.npz and scene.ply hold both."""


def main(argv: list[str]) -> int:
    """`gof background DATASET [--out DIR]`; see --help."""
    config = read_options(BackgroundConfig, "background", argv)
    flame = None if config.flame is None else open_result(config.flame).gaussians  # refused before the work
    options = BackgroundOptions(config.steps, config.gaussians, config.max_size)
    out = config.out or next_to(config.dataset, "_background")
    gaussians = make_background(config.dataset, out, options, may_overwrite())
    if flame is not None:
        add_flame(gaussians, flame, out)
    stages = StageLog(out / "costs.json").stages()
    result = out / "background.npz"
    summary = {"result": str(result), "gaussians": len(gaussians), "stages": [asdict(s) for s in stages]}
    write_figures(summary)
    for stage in stages:
        print(f"{stage.name:<12} {stage.seconds:8.1f} s {stage.peak_mb:8.0f} MB")
    print(f"{len(gaussians)} Gaussians -> {result}")
    return 0
