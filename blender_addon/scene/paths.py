"""Paths inside a .blend, which is given away: what stood there before is the author's disk."""

from __future__ import annotations

import bpy


def overwrite(owner: bpy.types.bpy_struct, name: str, path: str | bytes) -> None:
    """Set a path so that nothing is left of a longer one: Blender writes over its beginning and saves the rest, too."""
    room = owner.bl_rna.properties[name].length_max - 1
    blank = b"/" if isinstance(path, bytes) else "/"
    setattr(owner, name, blank * room)
    setattr(owner, name, path)


def forget_browsed() -> None:
    """Forget which folders the open file's browsers show: one would name the user's home."""
    for screen in bpy.data.screens:
        for space in (space for area in screen.areas for space in area.spaces if space.type == "FILE_BROWSER"):
            if space.params:
                overwrite(space.params, "directory", b"//")


def forget_folder(image: bpy.types.Image) -> None:
    """Leave a packed picture its name alone."""
    name = image.filepath.replace("\\", "/").rpartition("/")[2]
    overwrite(image, "filepath_raw", f"//{name}")
    for packed in image.packed_files:
        overwrite(packed, "filepath", f"//{name}")
