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
    _stand_around(spec)
    objects = flame_source(spec).build(_collection("Fire"))
    render.configure(spec)
    return objects


def replace_surroundings(spec: SceneSpec) -> None:
    """Put this spec's surroundings and cameras in the place of those of the open scene, whose fire stays."""
    for name in ("Background", "Cameras"):
        for item in list(bpy.data.collections[name].all_objects):
            bpy.data.objects.remove(item)
        bpy.data.collections.remove(bpy.data.collections[name])
    bpy.data.orphans_purge(do_recursive=True)
    bpy.context.scene.name = spec.name
    _stand_around(spec)
    render.configure(spec)


def _stand_around(spec: SceneSpec) -> None:
    backgrounds.build(spec, _collection("Background"))
    rig.build(spec, _collection("Cameras"))


def _collection(name: str) -> bpy.types.Collection:
    collection = bpy.data.collections.new(name)
    bpy.context.scene.collection.children.link(collection)
    return collection
