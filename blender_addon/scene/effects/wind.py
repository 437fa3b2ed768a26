"""Wind: a steady horizontal force with turbulence-like noise."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Settings:
    strength: float = 0.3
    """Strength of Blender's wind field."""
    direction_deg: float = 0.0
    """Direction the wind blows to, counter-clockwise from +X."""
    noise: float = 0.5
    """Random variation of the strength, 0 for none."""


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
    wind.field.noise = settings.noise
    wind.field.seed = 1 + spec.seed % 128
