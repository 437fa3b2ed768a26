"""A scene from its spec."""

from __future__ import annotations

from typing import Any

import bpy

from ..pure.spec import SceneSpec
from . import backgrounds, mantaflow, render, rig
from .flame_source import flame_source


def scene(spec: SceneSpec) -> Any:
    """Replace the open scene by the spec's; nothing is simulated or rendered yet. Returns what its flame's source adds.

    Raises SpecError where files that the spec names are wrong.
    """
    bpy.ops.wm.read_factory_settings(use_empty=True)
    mantaflow.enable()
    current = bpy.context.scene
    current.name = spec.name
    current.frame_start, current.frame_end = spec.timeline.first_frame, spec.timeline.last_frame
    whole = round(spec.timeline.steps_per_second)
    current.render.fps, current.render.fps_base = whole, whole / spec.timeline.steps_per_second
    backgrounds.build(spec, _collection("Background"))
    rig.build(spec, _collection("Cameras"))
    objects = flame_source(spec).build(_collection("Fire"))
    render.configure(spec)
    return objects


def _collection(name: str) -> bpy.types.Collection:
    collection = bpy.data.collections.new(name)
    bpy.context.scene.collection.children.link(collection)
    return collection
