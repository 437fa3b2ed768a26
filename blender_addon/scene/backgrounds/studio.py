"""A plain photographer's studio: checked floor, grey backdrop, one soft light."""

from __future__ import annotations

import bpy

from ...pure.spec import SceneSpec
from .. import material, meshes
from .lighting import light, sky


def build(spec: SceneSpec, collection: bpy.types.Collection) -> None:
    floor = material.tiles("Floor", ((0.28, 0.28, 0.28), (0.12, 0.12, 0.13)), (0.05, 0.05, 0.05), (0.3, 0.3), shift=0.0)
    meshes.box("Floor", (8, 8, 0.1), collection, location=(0, 0, -0.05), material=floor)
    backdrop = material.plain("Backdrop", (0.16, 0.17, 0.18))
    meshes.box("Backdrop", (8, 0.1, 5), collection, location=(0, 2.0, 2.5), material=backdrop)
    light(collection, (-1.8, -2.0, 3.2), 70.0, 1.5, (1.0, 0.96, 0.9))
    sky((0.032, 0.036, 0.045), 1.0)
