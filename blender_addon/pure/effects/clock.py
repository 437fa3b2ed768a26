"""Camera clocks that disagree: each camera starts a little off, runs a little fast, and its frames jitter.

The drawn times are recorded per camera in dataset.json (``time_s``), as a calibration would find them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...core.checked_json import require
from ..timing import ExposureTiming, Picture


@dataclass(frozen=True)
class Settings:
    offset_s: float = 0.002
    """Standard deviation of a camera's constant offset, seconds; drawn within three of them."""
    jitter_s: float = 0.0
    """Standard deviation of each frame's own error, seconds; drawn within three of them."""
    steps: int = 4
    """Solver steps per frame; the fire is taken as linear in time between them."""

    def __post_init__(self):
        require(self.offset_s >= 0, "effects.clock.offset_s", "0 or more", self.offset_s)
        require(self.jitter_s >= 0, "effects.clock.jitter_s", "0 or more", self.jitter_s)
        require(1 <= self.steps <= 64, "effects.clock.steps", "between 1 and 64", self.steps)


def steps_per_frame(settings: Settings) -> int:
    return settings.steps


def timing(settings: Settings, picture: Picture) -> ExposureTiming:
    offset = _draw(picture.seed, 2, picture.camera)
    jitter = _draw(picture.seed, 3, picture.camera, picture.frame)
    return ExposureTiming(delay=settings.offset_s * offset + settings.jitter_s * jitter)


def _draw(*key: int) -> float:
    return float(np.clip(np.random.default_rng(key).standard_normal(), -3, 3))
