"""Vorticity confinement: gives small eddies back what the solver's numerical diffusion takes."""

from __future__ import annotations

from dataclasses import dataclass

from ...core.checked_json import require

CHANGES_BAKE = True
MOST = 100.0  # fires are at 1; more than this is a slip of the hand


@dataclass(frozen=True)
class Settings:
    gas: float = 1.0
    """Confinement in the whole gas, as Blender's value at 25 steps per second."""
    flame: float = 2.0
    """Additional confinement in the flame, as Blender's value at 25 steps per second."""

    def __post_init__(self):
        require(0 <= self.gas <= MOST, "effects.vorticity.gas", f"in [0, {MOST:g}]", self.gas)
        require(0 <= self.flame <= MOST, "effects.vorticity.flame", f"in [0, {MOST:g}]", self.flame)
