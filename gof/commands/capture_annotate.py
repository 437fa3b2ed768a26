"""`gof capture annotate`: gives a dataset soft masks of the LED board."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from gof.capture.annotate import annotate, training_frames
from gof.capture.board_points import read_board_points
from gof.capture.recognise import first_frames, recognise, require_strips
from gof.commands.everywhere import write_figures
from gof.commands.read import read_options
from gof.core.errors import GofError
from gof.dataset import Dataset
from gof.footage.videos import distinct_names


@dataclass(frozen=True)
class AnnotateConfig:
    """Add soft masks of the LED board to a dataset of `gof ingest`.

    Examples:
      gof capture annotate data/fire --footage cam_0.mp4 cam_1.mp4 cam_2.mp4 --cameras cameras.json

    Every camera in which the board is found gets "board_mask", an 8-bit picture (255 = board), so that scores and
    losses leave its flicker out.
    """

    dataset: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="DATASET")]]
    """Dataset folder."""
    footage: list[Path] | None = None
    """The cameras' videos as given to gof ingest, to look for the board at full size; else the dataset's own
    pictures."""
    cameras: Path | None = None
    """The file given to gof ingest --cameras, when the footage is not yet undistorted."""
    board_points: Path | None = None
    """Points of the board in those videos of --footage whose marker is partly hidden; as in gof capture sync."""
    board: str = "auto"
    """Board in the pictures: "auto" recognises a built-in one (gof_board, paper_rig); or its name, or the JSON file of
    your own."""


def main(argv: list[str]) -> int:
    """Annotate a dataset and say what was added."""
    config = read_options(AnnotateConfig, "capture annotate", argv)
    dataset, points = Dataset.open(config.dataset), {}
    if config.board_points is not None and not config.footage:
        raise GofError("--board-points: are pixels of the videos as stored; give these with --footage")
    frames = first_frames(config.footage) if config.footage else training_frames(dataset)
    board = recognise(config.board, frames)
    if board is None and not config.footage:
        raise GofError(
            f"{config.dataset}: no picture shows a known LED board; they may be too small: give the --footage"
        )
    template = require_strips(board, "a mask")
    if config.board_points is not None and config.footage:
        names = distinct_names(config.footage)
        marked = read_board_points(config.board_points, template, names)
        points = {names.index(name): found for name, found in marked.items()}
    notes = annotate(dataset, template, config.footage, config.cameras, points)
    for name, note in notes.items():
        print(f"{name}: {note}")
    write_figures(notes)
    return 0
