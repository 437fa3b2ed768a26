"""Vorticity confinement: gives small eddies back what the solver's numerical diffusion takes."""

from __future__ import annotations

from dataclasses import dataclass

CHANGES_BAKE = True


@dataclass(frozen=True)
class Settings:
    gas: float = 1.0
    """Confinement in the whole gas, as Blender's value at 25 steps per second."""
    flame: float = 2.0
    """Additional confinement in the flame, likewise."""
