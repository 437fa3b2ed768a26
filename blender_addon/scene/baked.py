"""Fires of the open file whose simulation is not where the file says: Blender calls them baked and shows nothing."""

from __future__ import annotations

from pathlib import Path

import bpy
from bpy.app.handlers import persistent

KEPT = "//.cache/bake"  # where a dataset keeps it
REMEDY = (
    "put the folder back, or make the dataset again in a new folder: gof generate with its spec.json. Pictures and "
    "velocity do not need it"
)


def missing(scene: bpy.types.Scene) -> list[str]:
    """Return a line for each fire of a scene that cannot be seen, with what to do."""
    return [
        f"{object_.name}: its flame is not to be seen, for {path} is not there; {REMEDY}"
        for object_ in scene.objects
        for path in _needs(object_)
        if not path.exists()
    ]


def watch() -> None:
    """Say it in the console, too, whenever a file is opened."""
    if _on_load not in bpy.app.handlers.load_post:
        bpy.app.handlers.load_post.append(_on_load)


def unwatch() -> None:
    if _on_load in bpy.app.handlers.load_post:
        bpy.app.handlers.load_post.remove(_on_load)


def _needs(object_: bpy.types.Object) -> list[Path]:
    """Return the files that an object's flame is read from, where a dataset was made of it."""
    if object_.type == "VOLUME":
        files = [object_.data.filepath]
    else:
        fluids = [item for item in object_.modifiers if item.type == "FLUID" and item.fluid_type == "DOMAIN"]
        files = [item.domain_settings.cache_directory for item in fluids if item.domain_settings.has_cache_baked_data]
    return [Path(bpy.path.abspath(file, library=object_.library)) for file in files if file.startswith(KEPT)]


@persistent
def _on_load(*_) -> None:
    for scene in bpy.data.scenes:
        for line in missing(scene):
            print(f"Gaussians on Fire: {line}")
