"""Wind: a horizontal force that comes in gusts."""

from __future__ import annotations

from dataclasses import dataclass

from ..checked_json import require

CHANGES_BAKE = True


@dataclass(frozen=True)
class Settings:
    strength: float = 0.3
    """Mean strength of Blender's wind field."""
    direction_deg: float = 0.0
    """Direction the wind blows to, counter-clockwise from +X."""
    gusts: float = 0.5
    """Largest random change of the strength over time, relative to its mean; 0 for a steady wind."""

    def __post_init__(self):
        require(self.gusts >= 0, "effects.wind.gusts", "0 or more", self.gusts)
