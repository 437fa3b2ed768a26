"""A scene from its spec."""

from __future__ import annotations

import bpy

from .. import mantaflow
from ..spec import SceneSpec
from . import background, fire, render, rig


def scene(spec: SceneSpec) -> fire.FireObjects:
    """Replace the open scene by the spec's; nothing is simulated or rendered yet."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    mantaflow.enable()
    current = bpy.context.scene
    current.name = spec.name
    current.frame_start, current.frame_end = spec.clip.first_frame, spec.clip.last_frame
    current.render.fps = round(spec.clip.fps)
    current.render.fps_base = round(spec.clip.fps) / spec.clip.fps
    background.build(spec, _collection("Background"))
    rig.build(spec, _collection("Cameras"))
    objects = fire.build(spec, _collection("Fire"))
    render.configure(spec)
    return objects


def _collection(name: str) -> bpy.types.Collection:
    collection = bpy.data.collections.new(name)
    bpy.context.scene.collection.children.link(collection)
    return collection
