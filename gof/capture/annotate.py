"""Gives a dataset what the capture knows: soft masks of the LED board."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from itertools import islice
from pathlib import Path
from types import MappingProxyType
from typing import get_args

import numpy as np

from gof.capture.board_mask import board_mask, in_words, objection_to, outlines_of
from gof.capture.board_points import BoardPoints
from gof.capture.locate import BoardNotFound, Summary, locate
from gof.capture.template import BoardTemplate
from gof.core.errors import DataFormatError, GofError
from gof.core.files import path_in
from gof.dataset import CameraEntry, Dataset
from gof.footage.lens import ROLL_DEG, Lens, Turn, prepare, read_cameras
from gof.footage.pictures import write_picture
from gof.footage.videos import stored_frames

LOOK_AT = 160  # frames in which the board is looked for
TURNS: dict[int, Turn] = {ROLL_DEG[turn]: turn for turn in get_args(Turn)}


def annotate(
    dataset: Dataset,
    template: BoardTemplate,
    footage: list[Path] | None = None,
    cameras: Path | None = None,
    points: Mapping[int, BoardPoints] = MappingProxyType({}),
) -> dict[str, str]:
    """Write the masks, then dataset.json with their names.

    Args:
        footage: one video per training camera, as given to `gof ingest`; None = look in the dataset's own pictures
            for training.
        cameras: cameras.json of that footage; None = it is undistorted.
        points: where a user marked the board, by the video's place in `footage`; the others are looked through for the
            marker.
    Returns:
        what was added, or why not, in words, by camera.
    Raises:
        GofError: another number of videos than cameras, or in another order than when the dataset was made.
        DataFormatError: see `read_cameras`; footage of another size than the lens; a roll that is no turn.
    """
    import cv2

    count = len(dataset.cameras)
    if footage and len(footage) != count:
        raise GofError(f"--footage: give one video per camera of the dataset ({count}), in their order")
    made_of = list(dataset.description.provenance.get("footage", ()))
    names = [video.name for video in footage or ()]
    if names != made_of and sorted(names) == sorted(made_of):
        raise GofError(
            f"--footage: the dataset was made of {', '.join(made_of)}, in this order; give them in that order"
        )
    videos = footage or [Path(camera.name) for camera in dataset.cameras]
    lenses = [camera.lens for camera in read_cameras(cameras, videos)] if cameras else [None] * count
    entries = {entry.name: entry for entry in dataset.description.cameras}
    notes: dict[str, str] = {}
    made_from = dict(dataset.description.made_from)
    for c, camera in enumerate(dataset.cameras):
        entry = entries[camera.name]
        turn = _turn(entry, dataset.path)
        try:
            if footage:
                mask = mask_from_footage(footage[c], lenses[c], turn, template, points.get(c))
            else:
                mask = find_mask(_pictures(dataset, c), template)
        except BoardNotFound as e:
            notes[camera.name] = f"no board mask: {e}" + ("" if footage else " Small pictures? Give the --footage")
            continue
        name = f"cameras/{camera.name}/board_mask.png"
        path = path_in(dataset.path, name)
        if objection := objection_to(mask):
            notes[camera.name] = objection
            continue
        mask = cv2.resize(mask, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
        write_picture(path, mask)
        entries[camera.name] = replace(entry, board_mask=name)
        if not footage:
            made_from[name] = tuple(dataset.train_frames[:LOOK_AT])
        notes[camera.name] = in_words(mask)
    replace(dataset.description, cameras=tuple(entries.values()), made_from=made_from).write(dataset.path)
    return notes


def training_frames(dataset: Dataset) -> dict[str, Iterable[np.ndarray]]:
    """Return each camera's pictures in which the board is looked for, (H, W, 3) uint8, by its name."""
    return {camera.name: _pictures(dataset, c) for c, camera in enumerate(dataset.cameras)}


def _pictures(dataset: Dataset, camera: int) -> Iterable[np.ndarray]:
    return (np.rint(255 * dataset.image(camera, k)).astype(np.uint8) for k in dataset.train_frames[:LOOK_AT])


def find_mask(pictures: Iterable[np.ndarray], template: BoardTemplate, points: BoardPoints | None = None) -> np.ndarray:
    """Return (H, W) uint8, 255 on the board, from RGB pictures of a fixed camera; `points`: see `locate`.

    Raises:
        BoardNotFound: the board cannot be found in them.   DataFormatError: the points do not fit a board.
    """
    summary = Summary()
    for picture in islice(pictures, LOOK_AT):
        summary.add(picture)
    board = locate(summary, template, points=points)
    height, width = summary.low.shape
    return board_mask(outlines_of(board, template), board.marker_px, (width, height))


def mask_from_footage(
    footage: Path, lens: Lens | None, turn: Turn, template: BoardTemplate, points: BoardPoints | None = None
) -> np.ndarray:
    """Return the mask as `find_mask` finds it in stored pictures, undistorted and turned like the pictures.

    Raises:
        BoardNotFound, DataFormatError: not found; the footage is not readable, or of another size than its lens.
    """
    mask = find_mask(stored_frames(footage), template, points)
    height, width = mask.shape
    lens = lens or Lens(width, height, np.eye(3))
    if (width, height) != (lens.width, lens.height):
        raise DataFormatError(f"{footage}: is {width}x{height}, its lens {lens.width}x{lens.height}")
    return prepare(mask, lens, turn)


def _turn(entry: CameraEntry, dataset: Path) -> Turn:
    if round(entry.roll_deg) not in TURNS:
        raise DataFormatError(f"{dataset}/dataset.json: camera '{entry.name}': roll_deg must be one of {list(TURNS)}")
    return TURNS[round(entry.roll_deg)]
