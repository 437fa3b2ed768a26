"""The fire in a Blender scene, as what builds it hands it to the effects."""

from __future__ import annotations

from dataclasses import dataclass

import bpy


@dataclass
class FireObjects:
    """Handles that effects work on."""

    domain: bpy.types.Object
    emitter: bpy.types.Object
    material: bpy.types.Material

    @property
    def domain_settings(self) -> bpy.types.FluidDomainSettings:
        return self.domain.modifiers["Fluid"].domain_settings
