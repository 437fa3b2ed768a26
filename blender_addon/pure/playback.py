"""Frames of a scene that show a clip, and a rate at which a short clip can be watched."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .io.cloud import GaussianCloud

RATES = (24, 25, 30, 50, 60, 100, 120, 200, 240, 400, 500, 1000)
WATCHABLE = 30  # frames; a clip of fewer is a flicker
LAST_FRAME = 1_048_574  # Blender counts no further
EDGE = 1.0  # percent of the Gaussians before the clip, and behind it: runaways


@dataclass(frozen=True)
class Span:
    """Frames of a scene, the first and the last of a clip."""

    first: int
    last: int

    def __len__(self) -> int:
        return self.last - self.first + 1


def seconds(cloud: GaussianCloud) -> tuple[float, float] | None:
    """Return first and last second of what was filmed, on the recording's clock; None for a still.

    A file does not say it: it is when the Gaussians are brightest, or of a sequence of files when they are shown.
    """
    if cloud.begin is not None:
        return float(cloud.begin.min()), float(cloud.end.max())
    fading = cloud.dynamic & np.isfinite(cloud.t_sigma)
    if not fading.any():
        return None
    first, last = np.percentile(cloud.t_mu[fading].astype(np.float64), [EDGE, 100 - EDGE])
    return (float(first), float(last)) if last > first else None


def span(clip_s: tuple[float, float], start_frame: float, fps: float, time_scale: float = 1.0) -> Span | None:
    """Return the scene's frames of a clip; None where time stands still, or Blender does not count so far."""
    if time_scale == 0:
        return None
    ends = [start_frame + second * fps / time_scale for second in clip_s]
    if not all(math.isfinite(end) and abs(end) < LAST_FRAME for end in ends):
        return None
    return Span(round(min(ends)), round(max(ends)))


def rate(clip_s: tuple[float, float], fps: float, time_scale: float = 1.0) -> float:
    """Return frames per second at which a clip can be watched: the scene's own, or the lowest usual one of enough
    frames."""
    length_s = (clip_s[1] - clip_s[0]) / abs(time_scale or 1.0)
    if length_s * fps >= WATCHABLE:
        return fps
    return next((usual for usual in RATES if usual > fps and length_s * usual >= WATCHABLE), max(fps, RATES[-1]))
