"""A science classroom: panelled wall with a written blackboard, bookcases, charts, desks, and a bench for the fire.

The bench top is the floor of the simulated domain.
"""

from __future__ import annotations

import itertools

import bpy
import numpy as np

from ...pure.fires import Burner
from ...pure.spec import SceneSpec
from .. import material, meshes
from . import light, sky

WALL_Y = 2.3
COVERS = (
    (0.20, 0.03, 0.03),
    (0.03, 0.08, 0.16),
    (0.05, 0.12, 0.06),
    (0.28, 0.20, 0.07),
    (0.16, 0.14, 0.12),
    (0.09, 0.03, 0.10),
)
CHARTS = (
    ((0.42, 0.38, 0.28), (0.05, 0.14, 0.22), (0.30, 0.10, 0.04), (0.10, 0.17, 0.08), (0.36, 0.28, 0.10)),
    ((0.38, 0.36, 0.30), (0.22, 0.05, 0.04), (0.04, 0.05, 0.08), (0.30, 0.26, 0.18), (0.08, 0.12, 0.16)),
)

FLASKS = (  # m from the fire
    (-0.5, 0.24),
    (-0.38, 0.05),
    (-0.62, -0.1),
    (-0.33, 0.28),
    (-0.8, 0.2),
    (0.36, 0.2),
    (0.5, 0.05),
    (0.42, -0.14),
    (0.62, 0.26),
    (0.82, 0.0),
)


def build(spec: SceneSpec, collection: bpy.types.Collection) -> None:
    rng = np.random.default_rng([spec.seed, 2])
    plaster = material.tiles(
        "Plaster", ((0.23, 0.21, 0.16), (0.20, 0.185, 0.145)), (0.19, 0.175, 0.135), (0.8, 0.6), 0.004, stains=0.35
    )
    parquet = material.tiles(
        "Parquet",
        ((0.21, 0.115, 0.05), (0.11, 0.058, 0.026)),
        (0.02, 0.012, 0.008),
        (0.42, 0.085),
        0.004,
        stains=0.5,
        roughness=0.45,
    )
    oak = material.tiles(
        "Oak", ((0.19, 0.105, 0.045), (0.125, 0.066, 0.028)), (0.03, 0.016, 0.008), (1.1, 0.11), 0.004, stains=0.5
    )
    panel = material.tiles(
        "Panel",
        ((0.10, 0.075, 0.045), (0.075, 0.055, 0.035)),
        (0.018, 0.012, 0.008),
        (0.32, 0.95),
        0.02,
        shift=0.0,
        stains=0.4,
    )
    steel = material.plain("Steel", (0.09, 0.095, 0.10), 0.4, 0.8)
    meshes.box("Floor", (9, 9, 0.1), collection, location=(0, 0, -0.05), material=parquet)
    meshes.box("Wall", (9, 0.2, 4), collection, location=(0, WALL_Y + 0.1, 2.0), material=plaster)
    meshes.box("Panelling", (9, 0.04, 0.95), collection, location=(0, WALL_Y - 0.02, 0.475), material=panel)
    meshes.box("Rail", (9, 0.07, 0.05), collection, location=(0, WALL_Y - 0.03, 0.97), material=oak)
    _blackboard(rng, collection, oak)
    for x in (-1.42, 1.45):
        _bookcase(rng, collection, x, oak)
    for x, z, width, height, which in ((-0.42, 2.62, 0.62, 0.44, 0), (0.38, 2.6, 0.5, 0.5, 1)):
        chart = material.landscape(f"Chart {x}", CHARTS[which], rng.uniform(7, 12))
        meshes.box(
            "Chart",
            (width, 0.012, height),
            collection,
            rng.uniform(0, 9, 2),
            location=(x, WALL_Y - 0.01, z),
            material=chart,
        )
    for x, y in ((-0.85, 1.3), (0.9, 1.25), (-2.0, 0.7), (2.1, 0.65)):
        _desk(rng, collection, x, y, oak, steel)
    if spec.fire.burner:
        _bench(spec.fire.burner, spec.box.min[2], rng, collection, oak, steel)
    light(collection, (-2.6, -1.2, 3.0), 115.0, 1.4, (0.86, 0.92, 1.0))
    light(collection, (1.6, -1.8, 3.4), 52.0, 1.0, (1.0, 0.88, 0.7))
    sky((0.032, 0.035, 0.042), 1.0)


def _blackboard(rng, collection, oak) -> None:
    """Add a framed slate with lines of chalk handwriting and two drawn diagrams."""
    width, height, z, y = 1.5, 1.05, 1.72, WALL_Y - 0.02
    slate = material.tiles(
        "Slate", ((0.022, 0.034, 0.03), (0.018, 0.03, 0.027)), (0.02, 0.03, 0.027), (0.75, 1.2), 0.001, stains=0.6
    )
    chalk = material.plain("Chalk", (0.40, 0.40, 0.37), 0.9)
    meshes.box("Blackboard", (width, 0.03, height), collection, location=(0, y, z), material=slate)
    for dz in (-0.5, 0.5):
        meshes.box(
            "Frame",
            (width + 0.1, 0.06, 0.06),
            collection,
            location=(0, y - 0.01, z + dz * (height + 0.04)),
            material=oak,
        )
    for dx in (-0.5, 0.5):
        meshes.box(
            "Frame",
            (0.06, 0.06, height),
            collection,
            location=(dx * (width + 0.04), y - 0.01, z),
            material=oak,
            grain=2,
        )
    strokes = []
    for line in np.linspace(0.4, -0.42, 11):
        pen = -0.68 + rng.uniform(0, 0.15)
        end = rng.uniform(0.0, 0.3) if abs(line) < 0.3 else 0.66
        while pen < end:
            wide = rng.uniform(0.014, 0.03)
            points = rng.uniform((pen, line - 0.022), (pen + wide, line + 0.024), (rng.integers(3, 6), 2))
            strokes += list(itertools.pairwise(points))
            pen += wide + (0.045 if rng.random() < 0.2 else 0.008)
    for x, dz, radius in ((0.5, 0.14, 0.13), (0.48, -0.18, 0.11)):
        ring = [
            (x + radius * np.cos(a), dz + radius * np.sin(a)) for a in np.linspace(0, 2 * np.pi, 7 if dz < 0 else 25)
        ]
        strokes += [(np.array(a), np.array(b)) for a, b in itertools.pairwise(ring)]
        strokes += [(np.array((x, dz)), np.array(ring[index])) for index in (0, 2, 4)]
    _chalk_strokes(strokes, collection, chalk, (0, y - 0.0165, z))


def _chalk_strokes(strokes, collection, chalk, location) -> None:
    """Thin flat strips in the XZ plane, facing -Y."""
    vertices = []
    for start, end in strokes:
        along = (end - start) / max(float(np.linalg.norm(end - start)), 1e-6)
        side = 0.0028 * np.array([-along[1], along[0]])
        vertices += [(p[0], 0.0, p[1]) for p in (start - side, end - side, end + side, start + side)]
    faces = np.arange(len(vertices)).reshape(-1, 4).tolist()
    meshes.add("Chalk", vertices, faces, collection, location=location, material=chalk)


def _bookcase(rng, collection, x: float, oak) -> None:
    """Five boards of books with printed spines, some leaning."""
    width, depth, y = 1.15, 0.3, WALL_Y - 0.19
    spines = [
        material.print_work(f"Spine {x} {index}", cover, (0.36, 0.31, 0.2), tuple(0.4 * c for c in cover), (0.4, 0.13))
        for index, cover in enumerate(COVERS)
    ]
    meshes.box("Back", (width, 0.02, 2.3), collection, location=(x, y + depth / 2, 1.15), material=oak)
    for side in (-1, 1):
        meshes.box(
            "Side", (0.04, depth, 2.3), collection, location=(x + side * width / 2, y, 1.15), material=oak, grain=2
        )
    for level in np.arange(0.08, 2.4, 0.44):
        meshes.box(
            "Board", (width, depth, 0.03), collection, rng.uniform(0, 9, 2), location=(x, y, level), material=oak
        )
        position = -width / 2 + 0.04
        while level < 2.2 and position < width / 2 - 0.09:
            thick, tall = rng.uniform(0.022, 0.06), rng.uniform(0.22, 0.36)
            if rng.random() < 0.06:
                position += rng.uniform(0.06, 0.16)
                continue
            meshes.box(
                "Book",
                (thick, rng.uniform(0.16, 0.23), tall),
                collection,
                rng.uniform(0, 9, 2),
                location=(x + position + thick / 2, y - rng.uniform(0.0, 0.04), level + 0.015 + tall / 2),
                material=spines[rng.integers(len(spines))],
                turn_deg=rng.uniform(-3, 3),
            )
            position += thick + rng.uniform(0.0, 0.006)


def _desk(rng, collection, x: float, y: float, oak, steel) -> None:
    """Add a school desk with a chair, an exercise book and a jar."""
    turn = rng.uniform(-14, 14)
    meshes.box(
        "Desk", (0.85, 0.5, 0.03), collection, rng.uniform(0, 9, 2), location=(x, y, 0.68), material=oak, turn_deg=turn
    )
    meshes.box(
        "Seat",
        (0.38, 0.38, 0.025),
        collection,
        rng.uniform(0, 9, 2),
        location=(x + 0.1, y - 0.5, 0.42),
        material=oak,
        turn_deg=turn,
    )
    meshes.box(
        "Chair Back",
        (0.38, 0.025, 0.24),
        collection,
        rng.uniform(0, 9, 2),
        location=(x + 0.1, y - 0.68, 0.72),
        material=oak,
        turn_deg=turn,
    )
    for dx, dy, tall in (
        (-0.38, -0.2, 0.68),
        (0.38, -0.2, 0.68),
        (-0.38, 0.2, 0.68),
        (0.38, 0.2, 0.68),
        (-0.06, -0.66, 0.84),
        (0.26, -0.66, 0.84),
        (-0.06, -0.34, 0.42),
        (0.26, -0.34, 0.42),
    ):
        meshes.lathe(
            "Leg",
            [(0.014, 0.0), (0.014, tall)],
            collection,
            8,
            location=(x + dx, y + dy, 0),
            material=steel,
            smooth=True,
        )
    for dx, cover in ((-0.18, COVERS[rng.integers(6)]), (0.16, COVERS[rng.integers(6)])):
        paper = material.print_work("Exercise Book", cover, (0.38, 0.36, 0.31), (0.03, 0.03, 0.05), (0.2, 0.1))
        meshes.box(
            "Exercise Book",
            (0.17, 0.23, 0.018),
            collection,
            rng.uniform(0, 9, 2),
            location=(x + dx, y, 0.705),
            material=paper,
            turn_deg=rng.uniform(0, 90),
        )
    glass = material.plain("Jar", COVERS[rng.integers(6)], 0.15)
    jar = [(0.0, 0.0), (0.05, 0.0), (0.055, 0.1), (0.03, 0.13), (0.03, 0.15), (0.0, 0.15)]
    meshes.lathe("Jar", jar, collection, 24, location=(x, y + 0.14, 0.695), material=glass, smooth=True)


def _bench(fire: Burner, top: float, rng, collection, oak, steel) -> None:
    """Add the demonstration bench under the domain, with the burner and apparatus out of the flame's reach."""
    x, y, _ = fire.position
    tiles = material.tiles(
        "Bench Tiles",
        ((0.30, 0.30, 0.28), (0.13, 0.16, 0.17)),
        (0.05, 0.05, 0.05),
        (0.1, 0.1),
        0.005,
        shift=0.0,
        stains=0.3,
    )
    if top > 0.2:
        _add_cabinet((x, y, top), rng, collection, oak, steel, tiles)
    _add_burner(fire, top, collection, steel)
    _add_flasks((x, y, top), rng, collection)


def _add_cabinet(location, rng, collection, oak, steel, tiles) -> None:
    """Add the bench's top, at this location, and three drawers under it."""
    x, y, top = location
    meshes.box("Bench Top", (1.9, 0.8, 0.05), collection, location=(x, y, top - 0.026), material=tiles)
    meshes.box(
        "Bench Front", (1.8, 0.7, top - 0.12), collection, location=(x, y, (top - 0.05) / 2 + 0.02), material=oak
    )
    for offset in (-0.6, 0.0, 0.6):
        meshes.box(
            "Drawer",
            (0.5, 0.02, 0.16),
            collection,
            rng.uniform(0, 9, 2),
            location=(x + offset, y - 0.36, top - 0.18),
            material=oak,
        )
        meshes.lathe(
            "Knob",
            [(0.0, 0.0), (0.02, 0.0), (0.02, 0.02), (0.0, 0.025)],
            collection,
            12,
            location=(x + offset, y - 0.385, top - 0.18),
            material=steel,
        )


def _add_burner(fire: Burner, top: float, collection, steel) -> None:
    x, y, z = fire.position
    radius = fire.radius
    nozzle = z + fire.half_height
    burner = [
        (0.0, top),
        (0.09, top),
        (0.09, top + 0.015),
        (0.025, top + 0.03),
        (0.6 * radius, nozzle - 0.03),
        (1.1 * radius, nozzle),
    ]
    meshes.lathe(
        "Burner", [(r, h - top) for r, h in burner], collection, 32, location=(x, y, top), material=steel, smooth=True
    )


def _add_flasks(location, rng, collection) -> None:
    """Add bottles of reagents around this location."""
    x, y, top = location
    for index, (dx, dy) in enumerate(FLASKS):
        paint = material.print_work(
            f"Reagent {index}", COVERS[index % 6], (0.42, 0.40, 0.34), (0.02, 0.02, 0.03), (0.2, 0.07)
        )
        wide, tall = rng.uniform(0.03, 0.055), rng.uniform(0.1, 0.24)
        flask = [
            (0.0, 0.0),
            (wide, 0.0),
            (wide, 0.6 * tall),
            (0.35 * wide, 0.8 * tall),
            (0.4 * wide, tall),
            (0.0, tall),
        ]
        meshes.lathe(
            "Flask",
            flask,
            collection,
            24,
            location=(x + dx, y + dy, top),
            material=paint,
            smooth=True,
            turn_deg=rng.uniform(0, 360),
        )
