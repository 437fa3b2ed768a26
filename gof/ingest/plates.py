"""Fire-free plates of a fixed camera: fire adds light, so its absence is the dark end of every pixel's history."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import numpy as np

from gof.errors import DataFormatError
from gof.ingest.over_time import median
from gof.lens import Lens
from gof.pictures import read_picture

WARM = 12  # display steps of 255 by which red outgrows blue where fire or its light passed
GROW_PX = 3  # margin around these places


def fire_reached(clip: Collection[np.ndarray], low: np.ndarray) -> np.ndarray:
    """(H, W) bool: pixels that fire, or much of its light, reached: red rose above the plate `low` more than blue did.

    Args:
        clip: (H, W, 3) uint8 RGB pictures.   low: (H, W, 3) uint8 minimum plate.
    """
    import cv2

    warmest = np.full(low.shape[:2], -255, np.int16)
    base = low[..., 0].astype(np.int16) - low[..., 2]
    for frame in clip:
        np.maximum(warmest, frame[..., 0].astype(np.int16) - frame[..., 2] - base, out=warmest)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * GROW_PX + 1,) * 2)
    spots = cv2.morphologyEx((warmest > WARM).astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    return cv2.dilate(spots, disc) > 0


def steady(clip: Collection[np.ndarray], low: np.ndarray) -> np.ndarray:
    """The minimum `low` where fire passed, the temporal median where it never did, blended between; (H, W, 3) uint8.

    A minimum over noise lies below the scene by two to three standard deviations; where there is no fire nothing is
    gained by it.
    """
    import cv2

    reached = fire_reached(clip, low).astype(np.float32)
    weight = np.maximum(cv2.GaussianBlur(reached, (0, 0), GROW_PX), reached)[..., None]
    return np.rint(weight * low + (1 - weight) * median(clip)).astype(np.uint8)


def read_plate(folder: Path, name: str, lens: Lens) -> np.ndarray:
    """(H, W, 3) uint8 RGB: a plate filmed without fire, folder/NAME.png or of another suffix, as stored.

    Raises:
        DataFormatError: there is none, or it has another size than the footage.
    """
    import cv2

    files = sorted(folder.glob(f"{name}.*")) if folder.is_dir() else []
    if not files:
        raise DataFormatError(f"{folder}: no picture {name}.png there")
    return cv2.cvtColor(read_picture(files[0], size=(lens.width, lens.height)), cv2.COLOR_BGR2RGB)
