"""Moving emitter: the burner swings along a horizontal line, like a carried torch."""

from __future__ import annotations

from dataclasses import dataclass

from ...core.checked_json import require

CHANGES_BAKE = True


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
