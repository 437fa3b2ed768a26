"""When and where of a scene spec: its clip, how many instants and how they follow each other; a place in its world."""

from __future__ import annotations

from dataclasses import dataclass

from ..core.checked_json import require

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
