"""A plain photographer's studio: checked floor, grey backdrop, one soft light; as large as fire and cameras need."""

from __future__ import annotations

import bpy

from ...pure.plausibility import studio_scale
from ...pure.spec import SceneSpec
from .. import material, meshes
from . import light, sky


def build(spec: SceneSpec, collection: bpy.types.Collection) -> None:
    size = studio_scale(spec)
    floor = material.tiles(
        "Floor", ((0.28, 0.28, 0.28), (0.12, 0.12, 0.13)), (0.05, 0.05, 0.05), (0.3 * size, 0.3 * size), shift=0.0
    )
    meshes.box("Floor", (8 * size, 8 * size, 0.1), collection, location=(0, 0, -0.05), material=floor)
    backdrop = material.plain("Backdrop", (0.16, 0.17, 0.18))
    meshes.box(
        "Backdrop", (8 * size, 0.1 * size, 5 * size), collection, location=(0, 2 * size, 2.5 * size), material=backdrop
    )
    # The same light falls on a room of any size: power goes with its area.
    light(collection, (-1.8 * size, -2 * size, 3.2 * size), 70.0 * size**2, 1.5 * size, (1.0, 0.96, 0.9))
    sky((0.032, 0.036, 0.045), 1.0)
