"""Wind: a horizontal force that comes in gusts."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...pure.checked_json import require

GUST_S = 0.2  # simulated seconds from one random strength to the next


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


def apply(fire, settings: Settings, spec) -> None:
    import bpy

    wind = bpy.data.objects.new("Wind", None)
    fire.domain.users_collection[0].objects.link(wind)
    wind.location = [low + side / 2 for low, side in zip(spec.domain.min, spec.domain.size, strict=True)]
    wind.rotation_euler = (0.0, math.pi / 2, math.radians(settings.direction_deg))  # local Z is the wind's direction
    bpy.context.view_layer.objects.active = wind
    with bpy.context.temp_override(object=wind, active_object=wind, selected_objects=[wind]):
        bpy.ops.object.forcefield_toggle()
    wind.field.type = "WIND"
    wind.field.strength = settings.strength
    if settings.gusts:
        # Not Blender's own noise of the field: the solver's threads share its random numbers, so no two bakes would agree.
        gust_frames = max(1, round(GUST_S / spec.solver_step_s))
        frames = range(1, spec.last_frame + gust_frames + 1, gust_frames)
        for frame, gust in zip(frames, np.random.default_rng(spec.seed).uniform(-1, 1, len(frames)), strict=True):
            wind.field.strength = settings.strength * (1 + settings.gusts * gust)
            wind.field.keyframe_insert("strength", frame=frame)
