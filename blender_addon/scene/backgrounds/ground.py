"""Open ground at dusk with a wall and a burner, all in the size of the fire's box: for a candle as for a pool."""

from __future__ import annotations

import bpy

from ...pure.fires import Fire
from ...pure.spec import SceneSpec
from .. import material, meshes
from . import light, sky

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
    _burner(spec, collection)
    light(
        collection,
        (-1.2 * size, -1.3 * size, 2.0 * size),
        40.0 * size * size,
        0.8 * size,
        (1.0, 0.93, 0.85),
        (0, 0, 0.2 * size),
    )
    sky((0.018, 0.024, 0.040), 1.0)


def _burner(spec: SceneSpec, collection: bpy.types.Collection) -> None:
    """Add the thing that the fire burns on: logs, a ball, or a dish on a foot."""
    burner, shape = spec.fire.burner, spec.fire.shape if isinstance(spec.fire, Fire) else "disc"
    if burner is None:
        return
    x, y, z = burner.position
    if shape == "logs":
        bark = material.tiles("Bark", ((0.055, 0.035, 0.022), (0.02, 0.014, 0.01)), (0.008, 0.006, 0.005), (0.3, 0.04))
        meshes.crossed_logs("Logs", 0.97 * burner.radius, collection, spec.fire.logs, location=(x, y, z), material=bark)
        return
    steel = material.plain("Steel", (0.10, 0.11, 0.12), 0.45, 0.8)
    if shape == "sphere":
        meshes.ellipsoid("Ball", [0.95 * burner.radius] * 3, collection, location=(x, y, z), material=steel)
        return
    radius, rim = 1.12 * burner.radius, z + 0.8 * burner.half_height
    profile = [(0.5 * radius, 0.0), (0.45 * radius, 0.4 * rim), (radius, rim), (0.94 * radius, rim)]
    profile += [(0.8 * radius, rim - 1.5 * burner.half_height), (0.0, rim - 1.8 * burner.half_height)]
    meshes.lathe("Dish", profile, collection, 48, location=(x, y, 0.0), material=steel, smooth=True)
