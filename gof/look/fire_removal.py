"""A picture, the plate that was made of the clip, and what was taken out: what the removal of the fire is worth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from gof.core.colour import linear_to_srgb
from gof.dataset import Dataset
from gof.dataset.plates import background
from gof.footage.flame_mask import flame_mask
from gof.look.animation import original
from gof.look.tiles import Row, error_tile, picture_tile
from gof.reconstruct.observation import light_above

KINDS = {"steady": "plate (steady light)", "minimum": "plate (minimum)"}  # of `gof ingest --plates`, by provenance


def fire_removal(dataset: Dataset, frame: int, cameras: Sequence[int], result: Path | None = None) -> list[Row]:
    """A row for each camera: picture, plate, that of a result (in the fire's light) where it has one, fire, difference.

    The difference is between the picture and the last plate; its note is what is left of it where neither fire nor a
    sync board is: error of the plate, light of the fire on the room, noise.

    Args:
        cameras: their numbers.   result: a result's file, beside which its own plates may lie.
    """
    return [_row(dataset, frame, camera, result) for camera in cameras]


def _row(dataset: Dataset, frame: int, camera: int, result: Path | None) -> Row:
    image, plate = dataset.image(camera, frame), dataset.static(camera)
    name = dataset.cameras[camera].name
    row = [picture_tile(image, f"{original(dataset)}, {name}"), picture_tile(plate, _plate_name(dataset))]
    lit = None if result is None else background(dataset, camera, result)[..., :3]
    if lit is not None and not np.array_equal(lit, plate):
        row.append(picture_tile(lit, "plate of the result"))
        plate = lit
    flame = flame_mask(image, dataset.static(camera))
    alone = linear_to_srgb(light_above(image, plate))
    row.append(picture_tile(alone, "light above the plate"))
    board = dataset.board_weight(camera)
    counts = ~flame if board is None else ~flame & (board > 0.5)
    rest = np.abs(image - plate).mean(-1)[counts]
    note = f"mean {rest.mean():.4f} outside the flame" if rest.size else ""
    row.append(replace(error_tile(plate, image, "difference", note), outline=flame))
    return row


def _plate_name(dataset: Dataset) -> str:
    kind = dataset.description.provenance.get("plate")
    if kind is None:
        return "plate" if dataset.description.is_filmed else "plate (simulated without fire)"
    return KINDS.get(str(kind), f"plate ({kind})")
