"""How fast bright structures climb in a clip, from the slope of their traces in a picture of height against time.

What a person does with a ruler on such a picture, who needs no optical flow and no truth.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d, map_coordinates

FADE = 0.06  # of the height: structures larger than this are the flame's own shape
SPEEDS = 240  # that are tried between no motion and the fastest
FARTHEST = 0.25  # of the height: no structure is followed farther


def traces(light: np.ndarray) -> np.ndarray:
    """(T, H): what of a clip's light per row and frame moves: without its mean over time, and without broad shapes.

    Args:
        light: (T, H) light of every row, from the top of the picture, >= 0.
    """
    steady = light - light.mean(0)
    fine = steady - gaussian_filter1d(steady, FADE * light.shape[1], axis=1, mode="nearest")
    spread = fine.std(0)  # faint rows count as bright ones do, but for those with next to no light
    return fine / np.maximum(spread, 0.05 * spread.max(initial=1e-12))


def climb(light: np.ndarray, frame_s: float, frames_apart: tuple[int, ...] = (2, 3, 4, 5, 6)) -> float:
    """Speed of the traces, px/s, positive towards the top: that at which rows agree best with later ones above them.

    Args:
        light: (T, H).   frame_s: between frames.
        frames_apart: pairs of frames that are compared; over many the structures have changed, over one the slope is
            drawn from a pixel or two.
    Returns:
        nan where the clip is too short or nothing changes.
    """
    height = light.shape[1]
    moving = traces(light)
    if len(light) <= 2 * max(frames_apart) or not moving.any():
        return float("nan")
    speeds = np.linspace(0, FARTHEST * height / max(frames_apart), SPEEDS)  # px per frame
    agreement = np.zeros(SPEEDS)
    for apart in frames_apart:
        first, later = moving[:-apart], moving[apart:]
        for k, speed in enumerate(speeds):
            rows = np.arange(np.ceil(speed * apart), height)
            frame = np.repeat(np.arange(len(later))[:, None], len(rows), 1)
            above = map_coordinates(later, [frame, np.broadcast_to(rows - speed * apart, frame.shape)], order=1)
            here = first[:, rows.astype(int)]
            agreement[k] += (here * above).mean() / np.sqrt((here**2).mean() * (above**2).mean() + 1e-30)
    best = int(np.argmax(agreement))
    return float((speeds[best] + _offset(agreement, best) * speeds[1]) / frame_s)


def _offset(values: np.ndarray, best: int) -> float:
    """Where the parabola through the best value and its neighbours is highest, in steps."""
    if not 0 < best < len(values) - 1:
        return 0.0
    left, middle, right = values[best - 1 : best + 2]
    bend = left - 2 * middle + right
    return 0.5 * (left - right) / bend if bend < 0 else 0.0
