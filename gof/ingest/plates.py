"""Fire-free plates of a fixed camera: fire adds light, so its absence is the dark end of every pixel's history."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import numpy as np
from scipy.ndimage import binary_fill_holes

from gof.errors import DataFormatError
from gof.ingest.over_time import LUMA, median
from gof.lens import Lens
from gof.pictures import read_picture

WARM = 12  # display steps of 255 by which red outgrows blue where fire or its light passed
GROW_PX = 3  # margin around these places
MOST_RISE = 20  # levels of 255 by which the median may outshine the minimum: more is light that is on most of the time
FIRE_RED, FIRE_WARM = 150, 70  # colour of flame in a picture: red of 255, and how far above blue
SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp")  # of plates that somebody brings
MOST_FIRE_LEFT = 0.01  # share of the picture above which plates filmed without fire are needed


def fire_reached(clip: Collection[np.ndarray], low: np.ndarray) -> np.ndarray:
    """(H, W) bool: pixels that fire, or much of its light, reached: red rose above the plate `low` more than blue did.

    So do those that such pixels surround: in the heart of a flame that never moves away, `low` is flame itself.

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
    return binary_fill_holes(cv2.dilate(spots, disc) > 0)


def steady(clip: Collection[np.ndarray], low: np.ndarray, fire: np.ndarray) -> np.ndarray:
    """(H, W, 3) uint8: the minimum `low` where `fire` (H, W) passed, the temporal median elsewhere, blended between.

    A minimum over noise lies below the scene by two to three standard deviations; where there is no fire nothing is
    gained by it. Where red is at its limit in every frame, as in the heart of a flame, colour does not show that fire
    passed; a median far above the minimum does.
    """
    import cv2

    usual = median(clip)
    lit = (usual.astype(np.float32) - low) @ LUMA > MOST_RISE
    reached = (fire | lit).astype(np.float32)
    weight = np.maximum(cv2.GaussianBlur(reached, (0, 0), GROW_PX), reached)[..., None]
    return np.rint(weight * low + (1 - weight) * usual).astype(np.uint8)


def fire_left(plate: np.ndarray, reached: np.ndarray) -> float:
    """Share of the picture that has the colour of flame in a plate (H, W, 3) uint8, where fire `reached` (H, W)."""
    red, green, blue = np.moveaxis(plate.astype(np.int16), -1, 0)
    return float((reached & (red > FIRE_RED) & (red - blue > FIRE_WARM) & (red >= green)).mean())


def uncovered(low: np.ndarray, reached: np.ndarray, others: list[np.ndarray]) -> np.ndarray:
    """The minimum plate, with what other clips by the same camera show darker where fire `reached` (H, W) this one.

    Fire that stands in one place in one clip stands elsewhere in another. Light and exposure may have changed between
    them: each is brought to this one's level, channel by channel, by the median ratio outside the fire.

    Args:
        low, others: (H, W, 3) uint8 minimum plates.
    """
    best = low.copy()
    still = ~reached & (low.min(-1) > 8)
    for other in others:
        seen = still & (other.min(-1) > 8)
        if not seen.any():
            continue
        gain = np.median(low[seen].astype(np.float32) / other[seen], axis=0)
        level = np.clip(np.rint(other * gain), 0, 255).astype(np.uint8)
        darker = reached & (level @ LUMA < best @ LUMA)
        best[darker] = level[darker]
    return best


def read_plate(folder: Path, name: str, lens: Lens) -> np.ndarray:
    """(H, W, 3) uint8 RGB: a plate filmed without fire, folder/NAME.png or another of `SUFFIXES`, as stored.

    Raises:
        DataFormatError: there is none, or it has another size than the footage.
    """
    import cv2

    named = sorted(folder.glob(f"{name}.*")) if folder.is_dir() else []
    files = [path for path in named if path.suffix.lower() in SUFFIXES]  # the benchmark's scenes have an EXR beside it
    if not files:
        raise DataFormatError(f"{folder}: no picture {name}.png there")
    return cv2.cvtColor(read_picture(files[0], size=(lens.width, lens.height)), cv2.COLOR_BGR2RGB)
