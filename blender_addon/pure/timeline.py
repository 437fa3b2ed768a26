"""The clock of a clip: which solver step is which Blender frame, and which steps each picture sees.

Dataset frame k is at k / fps seconds; effects may ask for several solver steps from one frame to the next, and may open
a shutter before or after a frame's own step. Without such an effect a picture is one step with weight 1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from . import effects
from .timing import Clip, ExposureTiming, Picture, step_weights


@dataclass(frozen=True)
class Timeline:
    """All that follows from a clip and what its effects do to time; a spec holds its own (``spec.timeline``).

    Attributes:
        clip: frames and rates.
        effects: settings of the spec's effects.
        cameras: how many cameras the rig has.
        lines: lines of a rendered picture, which are rows of the sensor.
        seed: of the spec.
    """

    clip: Clip
    effects: tuple[Any, ...]
    cameras: int
    lines: int
    seed: int

    @cached_property
    def steps_per_frame(self) -> int:
        """Solver steps, which are Blender frames, from one dataset frame to the next: what clip and effects need."""
        return math.lcm(self.clip.steps_per_frame, *map(effects.steps_per_frame, self.effects))

    @property
    def steps_per_second(self) -> float:
        """Blender frames per second of the dataset clock."""
        return self.clip.fps * self.steps_per_frame

    @property
    def solver_step_s(self) -> float:
        """Simulated seconds per solver step."""
        return self.clip.time_scale / self.steps_per_second

    def blender_frame(self, frame: int) -> int:
        """Blender frame number of a dataset frame."""
        return 1 + (self.clip.warm_up_frames + frame) * self.steps_per_frame

    @property
    def first_frame(self) -> int:
        """Blender frame number of dataset frame 0."""
        return self.blender_frame(0)

    @property
    def earliest_seen(self) -> int:
        """Earliest Blender frame that a picture looks at; 1 is the first that is simulated."""
        return self.first_frame + min((first for first, _ in self._extents), default=0)

    @property
    def steps_needed(self) -> range:
        """Blender frames that pictures and truth look at."""
        return range(min(self.earliest_seen, self.first_frame), self.last_frame + 1)

    def simulated_s(self, blender_frame: int) -> float:
        """Return simulated seconds from dataset frame 0 to a Blender frame."""
        return (blender_frame - self.first_frame) * self.solver_step_s

    @cached_property
    def last_frame(self) -> int:
        """Last Blender frame that is simulated: that of the last dataset frame, or what its shutter still sees."""
        last_seen = max((last for _, last in self._extents), default=0)
        return self.first_frame + max(last_seen, (self.clip.frames - 1) * self.steps_per_frame)

    def picture(self, camera: int, frame: int) -> Picture:
        """Return a picture's description for the effects in a camera; frame -1 is the plate."""
        return Picture(camera, frame, self.clip.fps, self.lines, self.seed)

    def timing(self, camera: int, frame: int) -> ExposureTiming:
        """Return when the lines of a picture integrate: the sum of what its effects contribute."""
        picture = self.picture(camera, frame)
        return sum((effects.timing(settings, picture) for settings in self.effects), ExposureTiming())

    def weights(self, camera: int, frame: int) -> tuple[int, np.ndarray]:
        """Return the solver steps that a picture is made of.

        Returns:
            first: step of weights[0], counted from the frame's own step (which is 0; may be negative).
            weights: (S, lines) float64, each column sums to 1; first and last row are not all zero.
        """
        when = self.timing(camera, frame)
        start = (when.delay + when.line * np.arange(self.lines)) * self.steps_per_second
        return step_weights(start, when.open * self.steps_per_second)

    @cached_property
    def _extents(self) -> tuple[tuple[int, int], ...]:
        """First and last solver step that each picture sees, counted from dataset frame 0; none without a shutter."""
        if not any(map(effects.touches_time, self.effects)):
            return ()
        return tuple(self._extent(camera, frame) for camera in range(self.cameras) for frame in range(self.clip.frames))

    def _extent(self, camera: int, frame: int) -> tuple[int, int]:
        when = self.timing(camera, frame)
        start = round(when.delay * self.steps_per_second, 9)
        end = round((when.delay + when.line * (self.lines - 1) + when.open) * self.steps_per_second, 9)
        own = frame * self.steps_per_frame
        return own + math.floor(start), own + math.ceil(end)
