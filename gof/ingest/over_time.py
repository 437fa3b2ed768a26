"""Statistics of a fixed camera's pixels over a clip, frame by frame: no clip is ever held in memory as a whole.

`clip` is anything that can be iterated again and again and has a length: (H, W, 3) uint8 RGB pictures.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

LUMA = np.array([0.2126, 0.7152, 0.0722], np.float32)  # Rec. 709
MEDIAN_PASSES = 8  # how often `median` reads the clip: once per bit


def darkest(clip: Collection[np.ndarray]) -> np.ndarray:
    """Return (H, W, 3) uint8: every pixel as it was in its frame of least luminance (the first of equals)."""
    frames = iter(clip)
    low = next(frames).copy()
    luma = low.astype(np.float32) @ LUMA
    for frame in frames:
        now = frame.astype(np.float32) @ LUMA
        darker = now < luma
        low[darker], luma[darker] = frame[darker], now[darker]
    return low


def median(clip: Collection[np.ndarray]) -> np.ndarray:
    """Return (H, W, 3) uint8: each value's median over time; of an even number the lower of the middle two.

    Found bit by bit: the median has a bit if at most half of the values lie below the number that this bit completes.
    """
    below = (len(clip) - 1) // 2  # so many values may lie below the median
    frames_counted = np.min_scalar_type(len(clip))
    found = np.zeros((), np.uint8)  # of all values alike, before the first bit
    for bit in (128, 64, 32, 16, 8, 4, 2, 1):
        tried, frames = found + np.uint8(bit), iter(clip)
        count = (next(frames) < tried).astype(frames_counted)
        for frame in frames:
            count += frame < tried
        found = np.where(count <= below, tried, found)
    return found


def largest_change(clip: Collection[np.ndarray]) -> np.ndarray:
    """Return (H, W) uint8: by how much the channel that changes most differs between its brightest and its darkest
    frame."""
    frames = iter(clip)
    low = next(frames).copy()
    high = low.copy()
    for frame in frames:
        np.minimum(low, frame, out=low)
        np.maximum(high, frame, out=high)
    return (high - low).max(-1)
