"""Surroundings of the fire, one module each with ``build(spec, collection)``. The fire burns above the origin, cameras
of the built-in scenes are at -Y."""

from __future__ import annotations

import importlib
import math

import bpy

from ...pure.fires import Fire
from ...pure.spec import SceneSpec
from .. import compat, material, meshes


def light(collection, location, watts: float, size: float, colour, aim=(0.0, 0.6, 0.6)) -> None:
    """Add a square area light that shines at a place."""
    data = bpy.data.lights.new("Light", "AREA")
    data.energy, data.size, data.color = watts, size, colour
    lamp = bpy.data.objects.new("Light", data)
    lamp.location = location
    x, y, z = (at - to for at, to in zip(location, aim, strict=True))
    lamp.rotation_euler = (math.atan2(math.hypot(x, y), z), 0.0, math.atan2(y, x) + math.pi / 2)
    collection.objects.link(lamp)


def sky(colour, strength: float) -> None:
    world = bpy.data.worlds.new("World")
    shade = compat.add_nodes(world).nodes["Background"]
    shade.inputs["Color"].default_value = (*colour, 1.0)
    shade.inputs["Strength"].default_value = strength
    bpy.context.scene.world = world


def add_burner(spec: SceneSpec, collection: bpy.types.Collection) -> None:
    """Add the thing that the fire burns on: logs, a ball, or a dish on a foot. It hides next to nothing of the fire."""
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


def build(spec: SceneSpec, collection: bpy.types.Collection) -> None:
    """Add the background that the spec names."""
    importlib.import_module(f".{spec.background}", __name__).build(spec, collection)
