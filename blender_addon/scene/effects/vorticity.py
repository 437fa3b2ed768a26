"""Vorticity confinement: the strengths per solver step."""

from __future__ import annotations

from ...pure.effects.vorticity import Settings
from ...pure.spec import SceneSpec
from ..fire_objects import FireObjects

REFERENCE_STEP_S = 1.0 / 25.0  # step for which Mantaflow's strengths are quoted


def apply(fire: FireObjects, settings: Settings, spec: SceneSpec) -> None:
    """Set the confinement. The solver adds it once per step, so it is scaled with the step length."""
    scale = spec.solver.confinement * spec.timeline.solver_step_s / REFERENCE_STEP_S
    fire.domain_settings.vorticity = settings.gas * scale
    fire.domain_settings.flame_vorticity = settings.flame * scale
