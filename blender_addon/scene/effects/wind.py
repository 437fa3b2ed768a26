"""Wind: Blender's force field, its gusts as keys of the strength."""

from __future__ import annotations

import math

import bpy
import numpy as np

from ...pure.effects.wind import Settings
from ...pure.fire_scaling import wind_push
from ...pure.spec import SceneSpec
from .. import mantaflow
from ..fire_objects import FireObjects

FIELD_M_S = 0.15
"""Speed that a field of strength 1 gives the gas in a step, times the cells along the domain's longest side: Blender
takes it per step, whatever the step's length and the domain's size (`gof_benchmark.evidence.fire_sizes`), m/s."""
GUST_S = 0.2  # simulated seconds from one random strength to the next


def apply(fire: FireObjects, settings: Settings, spec: SceneSpec) -> None:
    wind = bpy.data.objects.new("Wind", None)
    fire.domain.users_collection[0].objects.link(wind)
    wind.location = [low + side / 2 for low, side in zip(spec.domain.min, spec.domain.size, strict=True)]
    wind.rotation_euler = (0.0, math.pi / 2, math.radians(settings.direction_deg))  # local Z is the wind's direction
    bpy.context.view_layer.objects.active = wind
    with bpy.context.temp_override(object=wind, active_object=wind, selected_objects=[wind]):
        bpy.ops.object.forcefield_toggle()
    wind.field.type = "WIND"
    strength = field_strength(settings, spec)
    wind.field.strength = strength
    if settings.gusts:
        # Not Blender's own noise of the field: the solver's threads share its random numbers, so no two bakes agree.
        gust_frames = max(1, round(GUST_S / spec.timeline.solver_step_s))
        frames = range(1, spec.timeline.last_frame + gust_frames + 1, gust_frames)
        for frame, gust in zip(frames, np.random.default_rng(spec.seed).uniform(-1, 1, len(frames)), strict=True):
            wind.field.strength = strength * (1 + settings.gusts * gust)
            wind.field.keyframe_insert("strength", frame=frame)
        mantaflow.wait_for_keys(wind)


def field_strength(settings: Settings, spec: SceneSpec) -> float:
    """Return mean strength of Blender's field."""
    if settings.unit == "field":
        return settings.strength
    push = wind_push(settings.strength, 2 * spec.fire.radius)
    return push * spec.timeline.solver_step_s * spec.domain.resolution / FIELD_M_S
