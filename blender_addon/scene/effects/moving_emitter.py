"""Moving emitter: one key of the burner's place per solver step."""

from __future__ import annotations

import math

from ...pure.effects.moving_emitter import Settings
from ...pure.spec import SceneSpec
from ..fire_objects import FireObjects


def apply(fire: FireObjects, settings: Settings, spec: SceneSpec) -> None:
    home = tuple(fire.emitter.location)
    angle = math.radians(settings.direction_deg)
    step_s = spec.timeline.solver_step_s
    for frame in range(1, spec.timeline.last_frame + 1):
        swing = settings.reach * math.sin(2 * math.pi * (frame - 1) * step_s / settings.period_s)
        fire.emitter.location = (home[0] + swing * math.cos(angle), home[1] + swing * math.sin(angle), home[2])
        fire.emitter.keyframe_insert("location", frame=frame)
