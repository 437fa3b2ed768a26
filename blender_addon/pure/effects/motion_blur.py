"""Motion blur: the shutter stays open and the picture is the mean light of that time, centred on the frame's time."""

from __future__ import annotations

from dataclasses import dataclass

from ...core.checked_json import require
from ..timing import ExposureTiming, Picture


@dataclass(frozen=True)
class Settings:
    shutter: float = 0.5
    """Open time as a fraction of the frame time."""
    steps: int = 4
    """Solver steps per frame; the fire is taken as linear in time between them."""

    def __post_init__(self):
        require(0 < self.shutter <= 1, "effects.motion_blur.shutter", "in (0, 1]", self.shutter)
        require(1 <= self.steps <= 64, "effects.motion_blur.steps", "between 1 and 64", self.steps)


def steps_per_frame(settings: Settings) -> int:
    return settings.steps


def timing(settings: Settings, picture: Picture) -> ExposureTiming:
    open_s = settings.shutter / picture.fps
    return ExposureTiming(delay=-open_s / 2, open=open_s)
