"""When each line of a picture sees the fire: shutter, rolling readout and camera clock as weights of simulated steps.

Line l of a frame at time t integrates light over [t + delay + l * line, t + delay + l * line + open]. The fire is known
at solver steps and is taken as linear in time between them, so a line is a weighted sum of a few steps. Without an
effect that touches time this is one step with weight 1. Never imports bpy.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from .spec import SceneSpec


@dataclass(frozen=True)
class Timing:
    """Seconds on the dataset clock, relative to a frame's nominal time."""

    delay: float = 0.0
    """When line 0 starts to integrate."""
    open: float = 0.0
    """How long a line integrates; 0 for an instant."""
    line: float = 0.0
    """From the start of one line to that of the next."""

    def __add__(self, other: Timing) -> Timing:
        return Timing(self.delay + other.delay, self.open + other.open, self.line + other.line)


def timing(spec: SceneSpec, camera: int, frame: int) -> Timing:
    """Timing of one picture: the sum of what its effects contribute."""
    from ..scene import effects

    parts = [effects.timing(settings, spec, camera, frame) for settings in spec.effects]
    return sum(parts, Timing())


def lines(spec: SceneSpec) -> int:
    """Lines of a rendered picture, which are rows of the sensor."""
    return spec.cameras.sensor_px[1] * spec.render.percentage // 100


def step_weights(spec: SceneSpec, camera: int, frame: int) -> tuple[int, np.ndarray]:
    """Which solver steps a picture is made of.

    Returns:
        first: step of weights[0], counted from the frame's own step (which is 0; may be negative).
        weights: (S, lines) float64, each column sums to 1; first and last row are not all zero.
    """
    when, per_s = timing(spec, camera, frame), spec.steps_per_second
    start = (when.delay + when.line * np.arange(lines(spec))) * per_s
    return weights_of_intervals(start, when.open * per_s)


def weights_of_intervals(start: np.ndarray, length: float) -> tuple[int, np.ndarray]:
    """Weights of whole steps for intervals [start, start + length] (lines,), in steps.

    The integral of a function that is linear between steps; length 0 is its value at start. Intervals shorter than a
    millionth of a step count as instants.
    """
    start = np.round(np.asarray(start, np.float64), 9)  # 3 * 0.1 / 0.1 is step 3, not a blend of two
    end = np.round(start + length, 9)
    first, last = int(np.floor(start.min())), int(np.ceil(end.max()))
    step = np.arange(first, last + 1)[:, None]
    if length < 1e-6:
        weights = np.clip(1 - np.abs(start - step), 0, None)
    else:
        weights = (_hat_integral(end - step) - _hat_integral(start - step)) / (end - start)
    weights /= weights.sum(axis=0)
    used = np.nonzero(weights.max(axis=1) > 0)[0]
    return first + int(used[0]), weights[used[0] : used[-1] + 1]


def first_step(spec: SceneSpec) -> int:
    """Earliest step any picture looks at, counted from dataset frame 0."""
    return min((step for step, _ in _extents(spec)), default=0)


def last_step(spec: SceneSpec) -> int:
    """Latest step any picture looks at, counted from dataset frame 0."""
    return max((step for _, step in _extents(spec)), default=0)


def _extents(spec: SceneSpec) -> list[tuple[int, int]]:
    from ..scene import effects

    if not any(effects.touches_time(settings) for settings in spec.effects):
        return []
    per_s, last_line, extents = spec.steps_per_second, lines(spec) - 1, []
    for camera in range(len(spec.cameras.names)):
        for frame in range(spec.clip.frames):
            when = timing(spec, camera, frame)
            start = round(when.delay * per_s, 9)
            end = round((when.delay + when.line * last_line + when.open) * per_s, 9)
            nominal = frame * spec.steps_per_frame
            extents.append((nominal + math.floor(start), nominal + math.ceil(end)))
    return extents


def _hat_integral(x: np.ndarray) -> np.ndarray:
    """Integral of max(0, 1 - |x|) from -infinity to x."""
    x = np.clip(x, -1.0, 1.0)
    return 0.5 + x - np.sign(x) * 0.5 * x * x
