"""Rolling shutter: every row of the sensor is read a little later than the one before."""

from __future__ import annotations

from dataclasses import dataclass

from ...core.checked_json import require
from ..timing import ExposureTiming, Picture


@dataclass(frozen=True)
class Settings:
    readout_s: float = 0.008
    """From the first to the last row of the sensor, seconds. The first row is read at the frame's nominal time."""
    steps: int = 4
    """Solver steps per frame; the fire is taken as linear in time between them."""

    def __post_init__(self):
        require(self.readout_s > 0, "effects.rolling_shutter.readout_s", "positive", self.readout_s)
        require(1 <= self.steps <= 64, "effects.rolling_shutter.steps", "between 1 and 64", self.steps)


def steps_per_frame(settings: Settings) -> int:
    return settings.steps


def timing(settings: Settings, picture: Picture) -> ExposureTiming:
    return ExposureTiming(line=settings.readout_s / picture.lines)
