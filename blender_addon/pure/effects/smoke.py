"""Smoke: the flame releases soot that absorbs and scatters light."""

from __future__ import annotations

from dataclasses import dataclass

from ...core.checked_json import require

ABSORBS_LIGHT = True
CHANGES_BAKE = True


@dataclass(frozen=True)
class Settings:
    amount: float = 0.5
    """Smoke released per unit of burnt wood; other fuels by their soot."""
    density: float = 8.0
    """Extinction per metre of smoke of density 1."""
    albedo: float = 0.2
    """Scattered fraction of the extinction, 0 (black soot) to 1 (white steam)."""

    def __post_init__(self):
        require(0 <= self.amount <= 8, "effects.smoke.amount", "in [0, 8]", self.amount)
        require(0 <= self.density <= 1e4, "effects.smoke.density", "in [0, 10000] per metre", self.density)
        require(0 <= self.albedo <= 1, "effects.smoke.albedo", "in [0, 1]", self.albedo)
