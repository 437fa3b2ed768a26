"""Surroundings of the fire, one module each with ``build(spec, collection)``. The fire burns above the origin, cameras
of the built-in scenes are at -Y."""

from __future__ import annotations

import importlib
import math

import bpy

from ...pure.spec import SceneSpec
from .. import compat


def light(collection, location, watts: float, size: float, colour, aim=(0.0, 0.6, 0.6)) -> None:
    """Add a square area light that shines at a place."""
    data = bpy.data.lights.new("Light", "AREA")
    data.energy, data.size, data.color = watts, size, colour
    lamp = bpy.data.objects.new("Light", data)
    lamp.location = location
    x, y, z = (there - here for there, here in zip(location, aim, strict=True))
    lamp.rotation_euler = (math.atan2(math.hypot(x, y), z), 0.0, math.atan2(y, x) + math.pi / 2)
    collection.objects.link(lamp)


def sky(colour, strength: float) -> None:
    world = bpy.data.worlds.new("World")
    shade = compat.add_nodes(world).nodes["Background"]
    shade.inputs["Color"].default_value = (*colour, 1.0)
    shade.inputs["Strength"].default_value = strength
    bpy.context.scene.world = world


def build(spec: SceneSpec, collection: bpy.types.Collection) -> None:
    """Add the background that the spec names."""
    importlib.import_module(f".{spec.background}", __name__).build(spec, collection)
