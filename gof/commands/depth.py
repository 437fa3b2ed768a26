"""`gof depth`: depth maps of a dataset's frames, for the scores of depth of `gof evaluate`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from gof.core.errors import GofError
from gof.core.files import write_json
from gof.dataset import Dataset
from gof.host.progress import progress_bar
from gof.ingest.frame_depth import write_frame_depths

LITTLE = 0.05  # of the pixels; where stereo finds less the maps are mostly guessed


@dataclass
class DepthConfig:
    """Depth maps of a dataset's held-out frames, which `gof evaluate` compares a result's depth with.

    OUT/depth/CAMERA/000000.npy, camera z in metres, is for `gof evaluate --depth OUT/depth`;
    OUT/disparity/CAMERA/000000.npy, relative inverse depth, for `--published --disparity OUT/disparity`. With --weights
    they are those of a monocular network, as the paper has them, else those of stereo between the cameras, completed
    along the pictures' edges. No method may learn from them.
    """

    dataset: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="DATASET")]]
    """Dataset folder."""
    out: Path
    """Folder for the maps; maps of the same dataset that are there are kept."""
    weights: Path | None = None
    """Folder of a Depth-Anything-V2 checkpoint in Hugging Face form; never downloaded. Needs torch and transformers."""
    all_frames: bool = False
    """Of all frames, not of the held-out ones alone."""
    json: Path | None = None
    """Also write the summary to this file."""


def main(argv: list[str]) -> int:
    """`gof depth DATASET --out DIR`; see --help."""
    config = tyro.cli(DepthConfig, prog="gof depth", args=argv)
    dataset = Dataset.open(config.dataset)
    frames = list(range(len(dataset.times_s))) if config.all_frames else dataset.test_frames
    if not frames:
        raise GofError(f"{config.dataset}: no frame is held out; give --all-frames")
    with progress_bar("depth") as progress:
        share = write_frame_depths(dataset, frames, config.out, config.weights, progress)
    if share is not None and share < LITTLE:
        print(f"note: stereo found {share:.1%} of the pixels only: the rest is guessed from them")
    print(f"{len(frames)} frames of {len(dataset.cameras)} cameras -> {config.out}; next:")
    print(f"gof evaluate RESULT --truth {config.dataset} --depth {config.out / 'depth'}")
    if config.json:
        write_json(config.json, {"out": str(config.out), "frames": frames, "stereo_share": share})
    return 0
