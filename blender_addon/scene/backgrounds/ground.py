"""Open ground at dusk with a wall and a burner, all in the size of the fire's box: for a candle as for a pool."""

from __future__ import annotations

import bpy

from ...pure.spec import SceneSpec
from .. import material, meshes
from . import add_burner, light, sky

EXTENT = 40.0  # of the ground, in sizes of the fire's box


def build(spec: SceneSpec, collection: bpy.types.Collection) -> None:
    size = max(spec.box.size)
    slabs = material.tiles(
        "Slabs", ((0.17, 0.16, 0.15), (0.09, 0.09, 0.092)), (0.025, 0.025, 0.025), (size / 5, size / 5), size / 150
    )
    side = EXTENT * size
    meshes.box("Ground", (side, side, size / 10), collection, location=(0, 0, -size / 20), material=slabs)
    wall = material.tiles(
        "Wall", ((0.20, 0.13, 0.10), (0.10, 0.075, 0.065)), (0.12, 0.11, 0.10), (size / 5, size / 12), size / 120
    )
    meshes.box(
        "Wall", (3 * size, size / 20, 1.1 * size), collection, location=(0, 1.4 * size, 0.55 * size), material=wall
    )
    add_burner(spec, collection)
    light(
        collection,
        (-1.2 * size, -1.3 * size, 2.0 * size),
        40.0 * size * size,
        0.8 * size,
        (1.0, 0.93, 0.85),
        (0, 0, 0.2 * size),
    )
    sky((0.018, 0.024, 0.040), 1.0)
