"""A cluttered workshop: brick wall, stone floor, shelves of boxes and tins, crates, posters, a hearth."""

from __future__ import annotations

import math

import bpy
import numpy as np

from ...pure.fires import Burner, Fire
from ...pure.spec import SceneSpec
from .. import material, meshes
from . import add_burner, light, sky


def build(spec: SceneSpec, collection: bpy.types.Collection) -> None:
    rng = np.random.default_rng([spec.seed, 1])
    brick = material.tiles(
        "Brick", ((0.20, 0.085, 0.055), (0.085, 0.042, 0.035)), (0.17, 0.155, 0.14), (0.215, 0.075), 0.01
    )
    stone = material.tiles(
        "Stone", ((0.17, 0.16, 0.15), (0.085, 0.085, 0.09)), (0.03, 0.03, 0.03), (0.34, 0.34), 0.01, stains=0.6
    )
    wood = material.tiles(
        "Wood", ((0.26, 0.15, 0.07), (0.13, 0.07, 0.032)), (0.015, 0.01, 0.008), (0.9, 0.09), 0.008, stains=0.5
    )
    steel = material.plain("Steel", (0.10, 0.11, 0.12), 0.45, 0.8)
    paints = [
        material.print_work(f"Print {index}", *colours, (0.23, height))
        for index, (colours, height) in enumerate(zip(PRINTS, (0.11, 0.14, 0.09, 0.12, 0.16, 0.1), strict=True))
    ]
    meshes.box("Floor", (9, 9, 0.1), collection, location=(0, 0, -0.05), material=stone)
    meshes.box("Back Wall", (9, 0.2, 4), collection, location=(0, 1.9, 2), material=brick)
    _shelf(rng, collection, (-0.95, 1.6), wood, paints)
    _shelf(rng, collection, (1.0, 1.6), wood, paints)
    _posters(rng, collection, 1.79)
    _crates(rng, collection, wood, paints)
    if isinstance(spec.fire, Fire) and spec.fire.shape == "sphere":
        _fire_bowl(spec.fire.burner, collection, steel)
    else:
        add_burner(spec, collection)
    if spec.fire.burner:
        _hearth(spec.fire.burner, rng, collection, stone)
    for x, radius in ((-0.12, 0.035), (0.1, 0.025)):
        meshes.lathe(
            "Pipe", [(radius, 0.0), (radius, 4.0)], collection, 12, location=(x, 1.74, 0), material=steel, smooth=True
        )
    light(collection, (-1.9, -1.6, 3.3), 55.0, 1.2, (1.0, 0.93, 0.82))
    light(collection, (2.6, -0.6, 2.6), 13.0, 1.0, (0.72, 0.84, 1.0))
    sky((0.032, 0.036, 0.045), 1.0)


PRINTS = (
    ((0.02, 0.13, 0.16), (0.42, 0.38, 0.28), (0.02, 0.05, 0.06)),
    ((0.36, 0.20, 0.025), (0.36, 0.33, 0.27), (0.05, 0.03, 0.01)),
    ((0.22, 0.025, 0.02), (0.46, 0.42, 0.34), (0.12, 0.012, 0.012)),
    ((0.06, 0.10, 0.04), (0.34, 0.32, 0.2), (0.02, 0.03, 0.01)),
    ((0.24, 0.24, 0.23), (0.40, 0.40, 0.38), (0.03, 0.035, 0.06)),
    ((0.03, 0.045, 0.13), (0.42, 0.40, 0.34), (0.015, 0.02, 0.05)),
)
"""Paint, paper and ink of printed boxes and tins."""

POSTER_COLOURS = (
    ((0.02, 0.09, 0.13), (0.04, 0.19, 0.22), (0.42, 0.35, 0.22), (0.36, 0.10, 0.03), (0.03, 0.03, 0.035)),
    ((0.38, 0.24, 0.05), (0.26, 0.06, 0.03), (0.08, 0.03, 0.03), (0.42, 0.38, 0.3), (0.05, 0.10, 0.11)),
    ((0.05, 0.09, 0.04), (0.14, 0.18, 0.07), (0.38, 0.36, 0.25), (0.02, 0.03, 0.02), (0.24, 0.14, 0.04)),
)


def _shelf(rng, collection, place, wood, paints) -> None:
    """Add four boards with boxes and tins of random sizes."""
    x, y = place
    width, depth = 1.35, 0.32
    for side in (-1, 1):
        meshes.box(
            "Upright", (0.05, depth, 2.3), collection, location=(x + side * width / 2, y, 1.15), material=wood, grain=2
        )
    for level in (0.35, 0.85, 1.35, 1.85, 2.3):
        meshes.box(
            "Board",
            (width, depth, 0.035),
            collection,
            location=(x, y, level),
            material=wood,
            offset=rng.uniform(0, 9, 2),
        )
        position = -width / 2 + 0.06
        while level < 2.2 and position < width / 2 - 0.2:
            size = rng.uniform((0.1, 0.12, 0.12), (0.24, 0.26, 0.36))
            paint = paints[rng.integers(len(paints))]
            centre = (x + position + size[0] / 2, y - rng.uniform(0, 0.04), level + 0.0175)
            if rng.random() < 0.35:
                radius, tall = 0.35 * size[0] + 0.02, size[2]
                meshes.lathe(
                    "Tin",
                    [(0, 0), (radius, 0), (radius, tall), (radius * 0.93, tall), (0, tall * 0.97)],
                    collection,
                    24,
                    location=centre,
                    material=paint,
                    turn_deg=rng.uniform(0, 360),
                )
            else:
                meshes.box(
                    "Box",
                    size,
                    collection,
                    rng.uniform(0, 9, 2),
                    location=(centre[0], centre[1], centre[2] + size[2] / 2),
                    material=paint,
                    turn_deg=rng.uniform(-8, 8),
                )
            position += size[0] + rng.uniform(0.01, 0.06)


def _posters(rng, collection, y) -> None:
    """Add prints on the wall between and above the shelves."""
    for index, (x, z, width, height) in enumerate(
        [
            (0.03, 1.25, 0.44, 0.6),
            (0.03, 0.55, 0.4, 0.42),
            (0.02, 1.95, 0.46, 0.36),
            (-2.1, 1.4, 0.6, 0.8),
            (2.15, 1.5, 0.6, 0.8),
            (-1.0, 2.75, 0.9, 0.4),
            (1.0, 2.75, 0.9, 0.4),
        ]
    ):
        paper = material.blotches(f"Poster {index}", POSTER_COLOURS[index % len(POSTER_COLOURS)], rng.uniform(22, 40))
        meshes.box(
            "Poster", (width, 0.012, height), collection, rng.uniform(0, 9, 2), location=(x, y, z), material=paper
        )


def _crates(rng, collection, wood, paints) -> None:
    """Crates, drums and loose boxes on the floor, at several depths."""
    for x, y, side in [
        (-0.95, 0.75, 0.5),
        (-0.92, 0.78, 0.36),
        (0.95, 0.85, 0.52),
        (-1.6, 0.2, 0.45),
        (1.65, 0.3, 0.48),
        (0.42, 1.3, 0.4),
    ]:
        base = 0.5 if side == 0.36 else 0.0
        meshes.box(
            "Crate",
            (side, side, side),
            collection,
            rng.uniform(0, 9, 2),
            location=(x, y, base + side / 2),
            material=wood,
            turn_deg=rng.uniform(-25, 25),
        )
    for x, y, tall, paint in [
        (0.98, 0.9, 0.32, 1),
        (-0.45, 1.25, 0.62, 0),
        (1.35, -0.2, 0.28, 2),
        (-1.25, -0.35, 0.26, 1),
    ]:
        base = 0.52 if x == 0.98 else 0.0
        radius = 0.28 * tall + 0.06
        ribs = [
            (0.0, 0.0),
            (radius, 0.0),
            (radius, tall * 0.32),
            (radius * 1.05, tall * 0.34),
            (radius, tall * 0.36),
            (radius, tall * 0.64),
            (radius * 1.05, tall * 0.66),
            (radius, tall * 0.68),
            (radius, tall),
            (radius * 0.94, tall),
            (0.0, tall * 0.96),
        ]
        meshes.lathe(
            "Drum", ribs, collection, 32, location=(x, y, base), material=paints[paint], turn_deg=rng.uniform(0, 360)
        )
    for _ in range(16):
        angle, distance = rng.uniform(-0.15 * math.pi, 1.15 * math.pi), rng.uniform(0.62, 1.1)
        size = rng.uniform(0.05, 0.15, 3)
        meshes.box(
            "Offcut",
            size,
            collection,
            rng.uniform(0, 9, 2),
            material=paints[rng.integers(len(paints))],
            location=(distance * math.cos(angle), distance * math.sin(angle), size[2] / 2),
            turn_deg=rng.uniform(0, 90),
        )


def _hearth(burner: Burner, rng, collection, stone) -> None:
    """Add a ring of stones around the burner."""
    x, y, _ = burner.position
    count = 11
    for index in range(count):
        angle = 2 * math.pi * (index + rng.uniform(-0.15, 0.15)) / count
        size = rng.uniform((0.1, 0.13, 0.06), (0.14, 0.18, 0.1))
        meshes.box(
            "Hearth Stone",
            size,
            collection,
            rng.uniform(0, 9, 2),
            material=stone,
            turn_deg=math.degrees(angle),
            location=(x + 0.36 * math.cos(angle), y + 0.36 * math.sin(angle), size[2] / 2),
        )


def _fire_bowl(burner: Burner, collection, steel) -> None:
    """Add a steel bowl around the lower half of the emitter, unless that lies in the floor.

    It is wide and closed: what burns in it is seen over its rim only, not below it.
    """
    x, y, top = burner.position
    radius, floor = 1.35 * burner.radius, max(0.9 * burner.bottom, 0.04 * top)
    profile = [
        (0.76 * radius, 0.0),
        (0.88 * radius, 0.3 * top),
        (0.96 * radius, 0.65 * top),
        (radius, top),
        (0.93 * radius, top),
        (0.9 * radius, 0.65 * top + 0.35 * floor),
        (0.75 * radius, floor),
        (0.0, floor),
    ]
    if top > 0:
        meshes.lathe("Fire Bowl", profile, collection, 40, location=(x, y, 0), material=steel, smooth=True)
