"""A cloister at dusk: an arcade of columns and banded arches, a walk behind it, and a paved yard with the fire."""

from __future__ import annotations

import math

import bpy
import numpy as np

from ...pure.fires import Fire, GridFire
from ...pure.spec import SceneSpec
from .. import material, meshes
from . import light, sky

ARCADE_Y, WALL_Y = 1.55, 3.1
BAY, SPRING, RADIUS = 1.25, 1.35, 0.47  # width of a bay, height where its arch begins, inner radius of the arch
TOP = 2.55


def build(spec: SceneSpec, collection: bpy.types.Collection) -> None:
    rng = np.random.default_rng([spec.seed, 3])
    ashlar = material.tiles(
        "Ashlar", ((0.235, 0.20, 0.15), (0.155, 0.13, 0.10)), (0.09, 0.075, 0.06), (0.42, 0.2), 0.008, stains=0.55
    )
    rubble = material.tiles(
        "Rubble", ((0.17, 0.145, 0.115), (0.085, 0.075, 0.065)), (0.06, 0.052, 0.045), (0.23, 0.12), 0.014, stains=0.7
    )
    paving = material.tiles(
        "Paving", ((0.15, 0.14, 0.125), (0.075, 0.072, 0.07)), (0.025, 0.028, 0.02), (0.3, 0.22), 0.012, stains=0.7
    )
    dark, pale = (
        material.tiles(name, colours, (0.05, 0.04, 0.04), (0.5, 0.5), 0.004, stains=0.5)
        for name, colours in (
            ("Dark Stone", ((0.13, 0.06, 0.045), (0.09, 0.045, 0.035))),
            ("Pale Stone", ((0.30, 0.26, 0.20), (0.23, 0.20, 0.155))),
        )
    )
    meshes.box("Yard", (10, 6.2, 0.1), collection, location=(0, -1.55, -0.05), material=paving)
    meshes.box("Walk", (10, 2.0, 0.1), collection, location=(0, 2.5, 0.1), material=ashlar)
    meshes.box("Step", (10, 0.3, 0.12), collection, location=(0, 1.4, 0.05), material=pale)
    meshes.box("Back Wall", (10, 0.2, 4), collection, location=(0, WALL_Y + 0.1, 2), material=rubble)
    columns = np.arange(-3.5, 4.0) * BAY
    for x in columns:
        _column(collection, x, dark, pale)
    for x in (columns[:-1] + columns[1:]) / 2:
        _arch(collection, x, dark, pale, ashlar)
    meshes.box("Cornice", (10, 0.46, 0.1), collection, location=(0, ARCADE_Y, TOP + 0.05), material=pale)
    meshes.box("Upper Wall", (10, 0.3, 1.2), collection, location=(0, ARCADE_Y, TOP + 0.7), material=rubble)
    _frescoes(rng, collection)
    _things(rng, collection, dark, pale)
    _ivy(rng, collection)
    if spec.fire.burner:
        _hearth(spec.fire, rng, collection, rubble)
    light(collection, (-3.0, -2.2, 4.2), 230.0, 1.6, (0.70, 0.80, 1.0))
    light(collection, (2.9, -1.8, 2.8), 70.0, 1.0, (1.0, 0.86, 0.68))
    for x in (-BAY, BAY):
        light(collection, (x, 2.2, 2.3), 13.0, 0.3, (1.0, 0.75, 0.45))
    sky((0.05, 0.06, 0.085), 1.0)


def _column(collection, x: float, dark, pale) -> None:
    base = [(0.17, 0.15), (0.17, 0.22), (0.14, 0.26), (0.15, 0.3), (0.11, 0.34)]
    shaft = [(0.105, 0.34), (0.115, 0.7), (0.095, SPRING - 0.28)]
    capital = [
        (0.1, SPRING - 0.28),
        (0.12, SPRING - 0.25),
        (0.11, SPRING - 0.22),
        (0.17, SPRING - 0.08),
        (0.0, SPRING - 0.08),
    ]
    for name, profile, stone in (("Base", base, pale), ("Shaft", shaft, dark), ("Capital", capital, pale)):
        meshes.lathe(name, profile, collection, 28, location=(x, ARCADE_Y, 0), material=stone, smooth=True)
    meshes.box("Abacus", (0.4, 0.4, 0.08), collection, (x, 0), location=(x, ARCADE_Y, SPRING - 0.04), material=pale)


def _arch(collection, x: float, dark, pale, ashlar) -> None:
    """Wedge stones of two colours in turn, and the masonry above them up to the cornice."""
    count, outer, half = 15, RADIUS + 0.14, 0.17
    for index in range(count):
        corners = []
        for angle in (math.pi * index / count, math.pi * (index + 1) / count):
            for radius in (RADIUS, outer):
                corners += [(radius * math.cos(angle), y, radius * math.sin(angle)) for y in (-half, half)]
        faces = [(0, 2, 6, 4), (1, 5, 7, 3), (0, 4, 5, 1), (2, 3, 7, 6)]
        uvs = [
            (c[0] + 0.7 * index + x, c[2] + (c[1] if f in (2, 3) else 0))
            for f, face in enumerate(faces)
            for c in (corners[i] for i in face)
        ]
        meshes.add("Wedge", corners, faces, collection, uvs, (x, ARCADE_Y, SPRING), material=(dark, pale)[index % 2])
    angles = np.linspace(0, math.pi, 25)
    low = [(outer * math.cos(a), outer * math.sin(a)) for a in angles]
    low = [(BAY / 2, 0.0), *low, (-BAY / 2, 0.0)]
    for y, order in ((-0.15, 1), (0.15, -1)):
        vertices = [(px, y, pz) for px, pz in low] + [(px, y, TOP - SPRING) for px, _ in low]
        faces = [(i, i + 1, i + 1 + len(low), i + len(low))[::-order] for i in range(len(low) - 1)]
        uvs = [(vertices[i][0] + x, vertices[i][2]) for face in faces for i in face]
        meshes.add("Spandrel", vertices, faces, collection, uvs, (x, ARCADE_Y, SPRING), material=ashlar)


def _frescoes(rng, collection) -> None:
    """Faded paintings on the back wall, one per bay."""
    palette = ((0.20, 0.15, 0.09), (0.14, 0.055, 0.035), (0.05, 0.075, 0.11), (0.26, 0.20, 0.11), (0.07, 0.085, 0.05))
    for index, x in enumerate(np.arange(-3, 4) * BAY):
        paint = material.landscape(f"Fresco {index}", palette, rng.uniform(5, 9), 0.9)
        meshes.box(
            "Fresco",
            (0.75, 0.012, 1.1),
            collection,
            rng.uniform(0, 9, 2),
            location=(x, WALL_Y - 0.006, 1.25),
            material=paint,
        )


def _things(rng, collection, dark, pale) -> None:
    """Pots with plants, a barrel, benches and loose stones in the yard."""
    leaf = material.blotches("Leaf", ((0.03, 0.075, 0.02), (0.06, 0.12, 0.03), (0.02, 0.05, 0.018)), 30)
    clay = material.tiles(
        "Clay", ((0.24, 0.10, 0.055), (0.19, 0.08, 0.045)), (0.1, 0.05, 0.03), (0.4, 0.06), 0.008, stains=0.5
    )
    wood = material.tiles(
        "Staves", ((0.16, 0.09, 0.045), (0.10, 0.055, 0.03)), (0.02, 0.012, 0.01), (0.08, 1.5), 0.008, stains=0.6
    )
    for x, y, size in (
        (-0.95, 0.85, 1.0),
        (0.92, 0.95, 1.15),
        (-1.75, 0.35, 1.2),
        (1.8, 0.25, 0.9),
        (0.45, 1.15, 0.75),
        (-0.42, 1.2, 0.7),
    ):
        pot = [(0.0, 0.0), (0.12, 0.0), (0.17, 0.24), (0.19, 0.24), (0.19, 0.28), (0.15, 0.28), (0.0, 0.25)]
        meshes.lathe(
            "Pot",
            [(r * size, h * size) for r, h in pot],
            collection,
            28,
            location=(x, y, 0),
            material=clay,
            smooth=True,
        )
        _foliage(rng, collection, (x, y, 0.27 * size), 0.24 * size, 70, leaf)
    barrel = [(0.0, 0.0), (0.2, 0.0), (0.25, 0.2), (0.26, 0.35), (0.25, 0.5), (0.2, 0.7), (0.18, 0.7), (0.0, 0.66)]
    for x, y in ((-1.35, 1.0), (1.4, 0.8)):
        meshes.lathe("Barrel", barrel, collection, 32, location=(x, y, 0), material=wood, smooth=True)
    for x, y, turn in ((-2.2, -0.3, 70), (2.25, -0.4, -65)):
        meshes.box("Bench", (1.0, 0.34, 0.07), collection, location=(x, y, 0.42), material=pale, turn_deg=turn)
        meshes.box("Bench Foot", (0.7, 0.26, 0.4), collection, location=(x, y, 0.2), material=dark, turn_deg=turn)
    for _ in range(26):
        angle, distance = rng.uniform(-0.2 * math.pi, 1.2 * math.pi), rng.uniform(0.6, 1.3)
        size = rng.uniform(0.04, 0.13, 3)
        meshes.box(
            "Stone",
            size,
            collection,
            rng.uniform(0, 9, 2),
            material=(dark, pale)[rng.integers(2)],
            location=(distance * math.cos(angle), distance * math.sin(angle), size[2] / 2),
            turn_deg=rng.uniform(0, 90),
        )


def _foliage(rng, collection, place, radius: float, count: int, leaf) -> None:
    """Add a ball of leaves in one mesh."""
    direction = rng.standard_normal((count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    direction[:, 2] = np.abs(direction[:, 2])
    _leaves(
        rng,
        "Foliage",
        collection,
        np.array(place) + direction * radius * rng.uniform(0.5, 1.0, (count, 1)),
        0.34 * radius,
        leaf,
    )


def _ivy(rng, collection) -> None:
    """Ivy that climbs some columns and hangs over the cornice."""
    leaf = material.blotches("Ivy", ((0.025, 0.06, 0.018), (0.05, 0.095, 0.025), (0.018, 0.04, 0.014)), 40)
    for x, y, low, high, spread, count in (
        (-1.5 * BAY, ARCADE_Y - 0.14, 0.2, 2.6, 0.16, 420),
        (1.5 * BAY, ARCADE_Y - 0.14, 1.0, 2.7, 0.2, 330),
        (0.2, ARCADE_Y - 0.2, 2.2, 2.9, 0.55, 360),
        (-2.6, ARCADE_Y - 0.2, 2.1, 3.0, 0.5, 300),
    ):
        points = np.stack(
            [rng.normal(x, spread, count), rng.normal(y, 0.03, count), rng.uniform(low, high, count)], axis=1
        )
        _leaves(rng, "Ivy", collection, points, 0.05, leaf)


def _leaves(rng, name: str, collection, points: np.ndarray, size: float, leaf) -> None:
    """Square leaves at points (N, 3), turned at random."""
    a = rng.standard_normal((len(points), 3))
    a *= size / np.linalg.norm(a, axis=1, keepdims=True)
    b = np.cross(a, rng.standard_normal((len(points), 3)))
    b *= size / np.linalg.norm(b, axis=1, keepdims=True)
    vertices = np.stack([points - a, points + 0.6 * b, points + a, points - 0.6 * b], axis=1).reshape(-1, 3)
    faces = np.arange(len(vertices)).reshape(-1, 4)
    uvs = np.tile([(0, 0), (size, 0), (size, size), (0, size)], (len(points), 1)) + np.repeat(
        rng.uniform(0, 5, (len(points), 2)), 4, axis=0
    )
    meshes.add(name, vertices.tolist(), faces.tolist(), collection, uvs, material=leaf)


def _hearth(fire: Fire | GridFire, rng, collection, rubble) -> None:
    """Charred logs, as many as the fire has, in a ring of stones."""
    burner, logs = fire.burner, fire.logs if isinstance(fire, Fire) else Fire.logs
    x, y, z = burner.position
    bark = material.tiles(
        "Char", ((0.035, 0.024, 0.018), (0.015, 0.012, 0.01)), (0.06, 0.022, 0.01), (0.1, 0.03), 0.006, stains=0.7
    )
    pile = meshes.crossed_logs("Logs", burner.radius, collection, logs, location=(x, y, z - 0.02), material=bark)
    pile.scale = (1.05, 1.05, 0.95)
    ring = 1.35 * burner.radius + 0.08
    count = round(2 * math.pi * ring / 0.15)
    for index in range(count):
        angle = 2 * math.pi * (index + rng.uniform(-0.15, 0.15)) / count
        size = rng.uniform((0.1, 0.12, 0.07), (0.14, 0.16, 0.12))
        meshes.box(
            "Hearth Stone",
            size,
            collection,
            rng.uniform(0, 9, 2),
            material=rubble,
            turn_deg=math.degrees(angle),
            location=(x + ring * math.cos(angle), y + ring * math.sin(angle), size[2] / 2),
        )
