"""`gof depth`: depth maps of a dataset's frames, or of its plates."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import tyro

from gof.commands.everywhere import may_overwrite, next_to, write_figures
from gof.commands.read import read_options
from gof.core.errors import GofError
from gof.dataset import Dataset
from gof.host.terminal import progress_bar
from gof.ingest.depth import write_frame_depths, write_plate_depths

LITTLE = 0.05  # of the pixels; where stereo finds less the maps are mostly guessed


@dataclass
class DepthConfig:
    """Depth maps of a dataset's held-out frames, with which `gof evaluate --published` compares a result's depth.

    Examples:
      gof depth data/fire
      gof depth data/fire --plates

    OUT/depth/CAMERA/000000.npy is camera z in metres, OUT/disparity/CAMERA/000000.npy relative inverse depth. With
    --weights a monocular network estimates them, as in the paper; otherwise stereo between the cameras, completed along
    the pictures' edges. No method may train on them.

    With --plates the maps are those of the scene without fire, for `gof background`: DATASET/depth/CAMERA.npy and
    DATASET/points.ply, by semi-global stereo on the plates (the paper: by COLMAP's PatchMatch, which needs CUDA and is
    not here), completed along the plates' edges or by the network of --weights.
    """

    FIRST: ClassVar = ("out", "weights", "all_frames", "plates")

    dataset: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="DATASET")]]
    """Dataset folder."""
    out: Path | None = None
    """Folder for the maps; maps of this dataset that exist are kept. Default: beside the dataset, DATASET_depth."""
    weights: Path | None = None
    """Folder of a Depth-Anything-V2 checkpoint in Hugging Face form; never downloaded, and never run with published
    weights. Needs torch and transformers."""
    all_frames: bool = False
    """Maps of all frames, not of the held-out ones alone."""
    plates: bool = False
    """Maps of the plates instead, written into the dataset."""


def main(argv: list[str]) -> int:
    """`gof depth DATASET [--out DIR]`; see --help."""
    config = read_options(DepthConfig, "depth", argv)
    dataset = Dataset.open(config.dataset)
    if config.plates:
        return _plates(config, dataset)
    frames = list(range(len(dataset.times_s))) if config.all_frames else dataset.test_frames
    if not frames:
        raise GofError(f"{config.dataset}: no frame is held out; give --all-frames")
    out = config.out or next_to(config.dataset, "_depth")
    with progress_bar("depth") as progress:
        share = write_frame_depths(dataset, frames, out, config.weights, progress)
    if share is not None and share < LITTLE:
        print(f"note: stereo found {share:.1%} of the pixels only: the rest is guessed from them")
    print(f"{len(frames)} frames of {len(dataset.cameras)} cameras -> {out}; next:")
    print(f"gof evaluate RESULT --dataset {config.dataset} --published {out}")
    write_figures({"out": str(out), "frames": frames, "stereo_share": share})
    return 0


def _plates(config: DepthConfig, dataset: Dataset) -> int:
    """Write the depth of the plates. Raises GofError: options that say nothing about plates; the maps are there
    already."""
    if config.out is not None or config.all_frames:
        raise GofError("--plates: writes into the dataset, and of no frame; leave out --out and --all-frames")
    files = write_plate_depths(dataset, config.weights, may_overwrite())
    print(f"{', '.join(map(str, files))}; next: gof background {config.dataset}")
    write_figures({"files": [str(file) for file in files]})
    return 0
