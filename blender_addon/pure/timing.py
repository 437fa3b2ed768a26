"""When a line of a picture integrates light, and of which solver steps its light is made.

Line l of a picture whose nominal time is t integrates light over [t + delay + l * line, t + delay + l * line + open].
The fire is known at solver steps and is taken as linear in time between them, so a line is a weighted sum of a few.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..core.checked_json import require

INSTANT = 1e-6  # steps; shorter exposures are taken for their first moment


@dataclass(frozen=True)
class ExposureTiming:
    """Seconds on the dataset clock, relative to a frame's nominal time."""

    delay: float = 0.0
    """When line 0 starts to integrate."""
    open: float = 0.0
    """Exposure time of a line; 0 for an instant."""
    line: float = 0.0
    """From the start of one line to that of the next."""

    def __add__(self, other: ExposureTiming) -> ExposureTiming:
        return ExposureTiming(self.delay + other.delay, self.open + other.open, self.line + other.line)


@dataclass(frozen=True)
class Picture:
    """One picture of a dataset, as far as what happens in its camera depends on it."""

    camera: int
    """Number of the camera in the rig."""
    frame: int
    """Number of the dataset frame; -1 is the plate."""
    fps: float
    """Frames per second of the dataset clock."""
    lines: int
    """Lines of the picture, which are rows of the sensor."""
    seed: int
    """Seed of the spec: what is random in a camera depends on it, the camera and the frame alone."""


def step_weights(start: np.ndarray, length: float) -> tuple[int, np.ndarray]:
    """Return the solver steps that make the light of exposures [start, start + length]: the integral of a function that
    is linear between steps; for length 0 its value at start.

    Args:
        start: (L,) when each line's exposure begins, in steps.
        length: of every exposure, in steps.
    Returns:
        first: number of the step that weights[0] is of.
        weights: (S, L) float64, each column sums to 1; first and last row are not all zero.
    """
    start = np.round(np.asarray(start, np.float64), 9)  # 3 * 0.1 / 0.1 is step 3, not a blend of two
    end = np.round(start + length, 9)
    first, last = int(np.floor(start.min())), int(np.ceil(end.max()))
    step = np.arange(first, last + 1)[:, None]
    if length < INSTANT:
        weights = np.clip(1 - np.abs(start - step), 0, None)
    else:
        weights = (_hat_integral(end - step) - _hat_integral(start - step)) / (end - start)
    weights /= weights.sum(axis=0)
    used = np.nonzero(weights.max(axis=1) > 0)[0]
    return first + int(used[0]), weights[used[0] : used[-1] + 1]


def _hat_integral(x: np.ndarray) -> np.ndarray:
    """Integral of max(0, 1 - |x|) from -infinity to x."""
    x = np.clip(x, -1.0, 1.0)
    return 0.5 + x - np.sign(x) * 0.5 * x * x


Vector = tuple[float, float, float]
"""World metres along x, y, z; of all that stands in a scene."""


@dataclass(frozen=True)
class Clip:
    """When the frames are taken: dataset frame k is at k / fps seconds."""

    frames: int = 36
    """Number of rendered instants."""
    fps: float = 100.0
    """Frames per second of the dataset clock."""
    warm_up_frames: int = 90
    """Frames simulated before the first rendered one, so that the flame is developed."""
    time_scale: float = 1.0
    """Simulated time over time on the dataset clock, below 1 for slow motion; velocities follow the clock."""
    steps_per_frame: int = 1
    """Solver steps from one frame to the next. An effect that needs instants between the frames raises it."""

    def __post_init__(self):
        require(self.frames >= 1, "clip.frames", "at least 1", self.frames)
        require(1.0 <= self.fps <= 32767.0, "clip.fps", "between 1 and 32767", self.fps)
        require(1 <= self.steps_per_frame <= 64, "clip.steps_per_frame", "between 1 and 64", self.steps_per_frame)
        require(self.warm_up_frames >= 0, "clip.warm_up_frames", "0 or more", self.warm_up_frames)
        require(0.0 < self.time_scale <= 100.0, "clip.time_scale", "in (0, 100]", self.time_scale)
