"""Fire-free plates of a fixed camera: fire adds light, so its absence is the dark end of every pixel's history."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gof.errors import DataFormatError
from gof.lens import Lens
from gof.pictures import read_picture

LUMA = np.array([0.2126, 0.7152, 0.0722], np.float32)  # Rec. 709
WARM = 12  # display steps of 255 by which red outgrows blue where fire or its light passed
GROW_PX = 3  # margin around these places


def rank(stack: np.ndarray, fraction: float) -> np.ndarray:
    """Each pixel's frame at a luminance percentile, `fraction` in [0, 1] (0 = the minimum). (H, W, 3) uint8."""
    k = round(fraction * (len(stack) - 1))
    plate = np.empty(stack.shape[1:], np.uint8)
    for y in range(stack.shape[1]):
        luma = stack[:, y].astype(np.float32) @ LUMA
        chosen = np.argpartition(luma, k, axis=0)[k]
        plate[y] = np.take_along_axis(stack[:, y], chosen[None, :, None], 0)[0]
    return plate


def fire_reached(stack: np.ndarray, low: np.ndarray) -> np.ndarray:
    """(H, W) bool: pixels that fire, or much of its light, reached: red rose above the plate `low` more than blue did.

    Args:
        stack: (T, H, W, 3) uint8 RGB.   low: (H, W, 3) uint8 minimum plate.
    """
    import cv2

    warmest = np.full(low.shape[:2], -255, np.int16)
    base = low[..., 0].astype(np.int16) - low[..., 2]
    for frame in stack:
        np.maximum(warmest, frame[..., 0].astype(np.int16) - frame[..., 2] - base, out=warmest)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * GROW_PX + 1,) * 2)
    spots = cv2.morphologyEx((warmest > WARM).astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    return cv2.dilate(spots, disc) > 0


def steady(stack: np.ndarray, low: np.ndarray) -> np.ndarray:
    """The minimum `low` where fire passed, the temporal median where it never did, blended between; (H, W, 3) uint8.

    A minimum over noise lies below the scene by two to three standard deviations; where there is no fire nothing is
    gained by it.
    """
    import cv2

    reached = fire_reached(stack, low).astype(np.float32)
    weight = np.maximum(cv2.GaussianBlur(reached, (0, 0), GROW_PX), reached)[..., None]
    median = np.empty_like(low)
    for y in range(stack.shape[1]):
        median[y] = np.median(stack[:, y], axis=0)
    return np.rint(weight * low + (1 - weight) * median).astype(np.uint8)


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
