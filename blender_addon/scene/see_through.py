"""Scenes that show a cloud let a ray pass all of its Gaussians, also where the cloud was appended, linked or copied.

How many surfaces a ray may pass is a setting of the scene in Cycles, and a new scene's is 8: there a flame turns black.
"""

from __future__ import annotations

import bpy
from bpy.app.handlers import persistent

SURFACES = 1024  # two per Gaussian; where a ray must stop the picture turns black
WHOLE = 256  # surfaces of a flame that every ray passes: Cycles ends some earlier by chance, and a flame is mottled


def pass_flame(scene: bpy.types.Scene) -> None:
    """Let every ray pass WHOLE surfaces: a few samples show a flame without noise, and each takes half again as
    long."""
    cycles = getattr(scene, "cycles", None)
    if cycles is not None:
        cycles.min_transparent_bounces = max(WHOLE, cycles.min_transparent_bounces)


def allow(scene: bpy.types.Scene) -> None:
    """Let a ray pass SURFACES surfaces at least."""
    if _stops(scene):
        scene.cycles.transparent_max_bounces = SURFACES


def watch() -> None:
    """Allow it from now on wherever a cloud is, with or without a window."""
    for handlers, function in WATCHED:
        if function not in handlers:
            handlers.append(function)


def unwatch() -> None:
    for handlers, function in WATCHED:
        if function in handlers:
            handlers.remove(function)


def scenes_with_clouds() -> set[bpy.types.Scene]:
    """Scenes that use a cloud in any way: as an object, as an instance of a collection, through Geometry Nodes."""
    todo = [tree for tree in bpy.data.node_groups if "gof_layout" in tree]
    seen, users = set(todo), bpy.data.user_map() if todo else {}
    while todo:
        user = todo.pop()
        if not isinstance(user, bpy.types.Scene):
            above = users.get(user, set()) - seen
            seen |= above
            todo += above
    return {scene for scene in seen if isinstance(scene, bpy.types.Scene)}


def _stops(scene: bpy.types.Scene) -> bool:
    """Return whether a ray stops early in a scene of this file; what is linked cannot be changed here."""
    cycles = getattr(scene, "cycles", None)
    return cycles is not None and scene.library is None and cycles.transparent_max_bounces < SURFACES


@persistent
def _on_load(*_) -> None:
    for scene in scenes_with_clouds():
        allow(scene)


@persistent
def _on_change(scene: bpy.types.Scene, *_) -> None:
    if _stops(scene) and scene in scenes_with_clouds():
        allow(scene)


WATCHED = (
    (bpy.app.handlers.load_post, _on_load),
    (bpy.app.handlers.depsgraph_update_post, _on_change),
    (bpy.app.handlers.render_init, _on_change),  # a script may render what nothing has evaluated yet
)
