"""Smoke: the flame releases soot that absorbs and scatters light."""

from __future__ import annotations

from dataclasses import dataclass

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
