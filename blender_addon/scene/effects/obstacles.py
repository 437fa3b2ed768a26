"""Obstacles: bodies in the fire's collection that the solver flows around."""

from __future__ import annotations

from ...pure.effects.obstacles import Settings
from ...pure.spec import SceneSpec
from .. import material, meshes
from ..fire_objects import FireObjects


def apply(fire: FireObjects, settings: Settings, spec: SceneSpec) -> None:
    collection = fire.domain.users_collection[0]
    for index, item in enumerate(settings.items):
        paint = material.plain(f"Obstacle {index}", item.colour, 0.5)
        if item.shape == "box":
            body = meshes.box(f"Obstacle {index}", item.size, collection, location=item.position, material=paint)
        else:
            half = [side / 2 for side in item.size]
            body = meshes.ellipsoid(f"Obstacle {index}", half, collection, location=item.position, material=paint)
        modifier = body.modifiers.new("Fluid", "FLUID")
        modifier.fluid_type = "EFFECTOR"
        modifier.effector_settings.effector_type = "COLLISION"
        modifier.effector_settings.surface_distance = 0.0
