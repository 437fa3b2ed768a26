"""The fire in a Blender scene: the object that shines, and what builds it hands over."""

from __future__ import annotations

from dataclasses import dataclass

import bpy

FLAME_NAME = "Fire Domain"
"""Name of the object that shines, whatever made it: our solver's domain, or a volume of grids."""


@dataclass
class FireObjects:
    """Handles that effects work on."""

    domain: bpy.types.Object
    emitter: bpy.types.Object
    material: bpy.types.Material

    @property
    def domain_settings(self) -> bpy.types.FluidDomainSettings:
        return self.domain.modifiers["Fluid"].domain_settings


def find_flame() -> bpy.types.Object:
    """Return the object of the open scene that shines. Raises LookupError if there is none."""
    flame = bpy.data.objects.get(FLAME_NAME)
    if flame is None:
        raise LookupError(f"the scene {bpy.data.filepath or '(unsaved)'} has no object named {FLAME_NAME!r}")
    return flame
