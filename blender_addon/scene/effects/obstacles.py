"""Obstacles: solid bodies that the gas flows around. They stand still, and are seen in the pictures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from ...pure.checked_json import require


@dataclass(frozen=True)
class Obstacle:
    shape: Literal["sphere", "box"] = "sphere"
    position: tuple[float, float, float] = (0.0, 0.0, 0.6)
    """Centre, world metres."""
    size: tuple[float, float, float] = (0.2, 0.2, 0.2)
    """Side lengths of its bounding box, metres. Give it at least three cells: thinner things leak."""
    colour: tuple[float, float, float] = (0.12, 0.12, 0.13)
    """Linear RGB."""

    def __post_init__(self):
        require(min(self.size) > 0, "effects.obstacles.items.size", "positive on every side", self.size)


@dataclass(frozen=True)
class Settings:
    items: tuple[Obstacle, ...] = (Obstacle(),)


def apply(fire, settings: Settings, spec) -> None:
    from .. import material, meshes

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
