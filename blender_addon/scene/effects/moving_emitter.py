"""Moving emitter: the burner swings along a horizontal line, like a carried torch."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ...pure.checked_json import require


@dataclass(frozen=True)
class Settings:
    reach: float = 0.15
    """Largest distance from its place, metres."""
    period_s: float = 1.0
    """Simulated seconds for a full swing."""
    direction_deg: float = 0.0
    """Direction of the first swing, counter-clockwise from +X."""

    def __post_init__(self):
        require(self.reach >= 0, "effects.moving_emitter.reach", "0 or more", self.reach)
        require(self.period_s > 0, "effects.moving_emitter.period_s", "positive", self.period_s)


def apply(fire, settings: Settings, spec) -> None:
    home = tuple(fire.emitter.location)
    angle = math.radians(settings.direction_deg)
    for frame in range(1, spec.last_frame + 1):
        swing = settings.reach * math.sin(2 * math.pi * (frame - 1) * spec.solver_step_s / settings.period_s)
        fire.emitter.location = (home[0] + swing * math.cos(angle), home[1] + swing * math.sin(angle), home[2])
        fire.emitter.keyframe_insert("location", frame=frame)
