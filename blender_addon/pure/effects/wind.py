"""Wind: a horizontal force that comes in gusts.

Blender's field pushes only gas that carries fuel or soot: a flame leans, the air around it does not move.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from ...core.checked_json import require

CHANGES_BAKE = True


@dataclass(frozen=True)
class Settings:
    strength: float = 0.5
    """Mean strength: the sideways speed that burning gas has at the flame's top, m/s; see unit."""
    direction_deg: float = 0.0
    """Direction the wind blows to, counter-clockwise from +X."""
    gusts: float = 0.5
    """Largest random change of the strength over time, relative to its mean; 0 for a steady wind."""

    unit: Literal["m/s", "field"] = "m/s"
    """m/s; or field: of Blender's field, whose push grows with every solver step and shrinks with every cell."""

    def __post_init__(self):
        require(self.gusts >= 0, "effects.wind.gusts", "0 or more", self.gusts)
