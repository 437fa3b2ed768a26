"""A scene from its spec."""

from __future__ import annotations

import bpy

from ..pure.spec import SceneSpec
from . import backgrounds, fire, mantaflow, render, rig
from .fire_objects import FireObjects


def scene(spec: SceneSpec) -> FireObjects:
    """Replace the open scene by the spec's; nothing is simulated or rendered yet."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    mantaflow.enable()
    current = bpy.context.scene
    current.name = spec.name
    current.frame_start, current.frame_end = spec.timeline.first_frame, spec.timeline.last_frame
    whole = round(spec.timeline.steps_per_second)
    current.render.fps, current.render.fps_base = whole, whole / spec.timeline.steps_per_second
    backgrounds.build(spec, _collection("Background"))
    rig.build(spec, _collection("Cameras"))
    objects = fire.build(spec, _collection("Fire"))
    fire.keep_for_dataset(objects.domain_settings)
    render.configure(spec)
    return objects


def _collection(name: str) -> bpy.types.Collection:
    collection = bpy.data.collections.new(name)
    bpy.context.scene.collection.children.link(collection)
    return collection
