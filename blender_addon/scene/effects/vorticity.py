"""Vorticity confinement: gives small eddies back what the solver's numerical diffusion takes."""

from __future__ import annotations

from dataclasses import dataclass

REFERENCE_STEP_S = 1.0 / 25.0  # step for which Mantaflow's strengths are quoted


@dataclass(frozen=True)
class Settings:
    gas: float = 1.0
    """Confinement in the whole gas, as Blender's value at 25 steps per second."""
    flame: float = 2.0
    """Additional confinement in the flame, likewise."""


def apply(fire, settings: Settings, spec) -> None:
    """Set the confinement. The solver adds it once per step, so it is scaled with the step length."""
    scale = spec.solver_step_s / REFERENCE_STEP_S
    fire.domain_settings.vorticity = settings.gas * scale
    fire.domain_settings.flame_vorticity = settings.flame * scale
