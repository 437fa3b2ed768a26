"""Surroundings of the fire, one module each with ``build(spec, collection)``. The fire burns above the origin, cameras
of the built-in scenes are at -Y."""

from __future__ import annotations

import importlib

import bpy

from ...pure.spec import SceneSpec


def build(spec: SceneSpec, collection: bpy.types.Collection) -> None:
    """Add the background that the spec names."""
    importlib.import_module(f".{spec.background}", __name__).build(spec, collection)
