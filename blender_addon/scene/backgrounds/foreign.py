"""What may come in from a .blend that anybody may have made: how it looks, and nothing else of this disk.

A .blend names files: whatever Blender packs would be published with the dataset, whoever's it is.
"""

from __future__ import annotations

from pathlib import Path

import bpy

from ...core.checked_json import SpecError
from .. import paths

PICTURES = {".png", ".jpg", ".jpeg", ".exr", ".hdr", ".tif", ".tiff", ".tga", ".bmp", ".webp", ".jp2", ".dds", ".psd"}


def cut_links(source: Path) -> None:
    """Forget `source`, which a scene was appended from. Raise SpecError if parts of it are of other .blend files."""
    for library in bpy.data.libraries:
        if Path(bpy.path.abspath(library.filepath)).resolve() != source.resolve():
            raise SpecError(
                f"blend_file.path: {source} links {library.filepath}, another .blend; in Blender make everything local "
                "(Object > Relations > Make Local > All) and save it"
            )
    bpy.data.batch_remove(list(bpy.data.libraries))  # all is local now, and a library is a path


def stand_still() -> None:
    """Take away what moves or acts: animation, drivers, scripts, sounds. Values stay as they are."""
    for block in bpy.data.user_map():
        for holder in (block, getattr(block, "node_tree", None), getattr(block, "shape_keys", None)):
            if getattr(holder, "animation_data", None):
                holder.animation_data_clear()
    for kind in (bpy.data.texts, bpy.data.sounds, bpy.data.movieclips):
        bpy.data.batch_remove(list(kind))


def forget_origin() -> None:
    """Take away what remembers the path of the .blend that it was appended from: only copies do not."""
    for block in list(bpy.data.user_map()):
        if block.library_weak_reference and not isinstance(block, bpy.types.Key):  # shape keys go with their mesh
            name, twin = block.name, block.copy()
            block.user_remap(twin)
            bpy.data.batch_remove([block])
            if not isinstance(twin, bpy.types.VectorFont):  # a font's is its own
                twin.name = name


def take_pictures(source: Path) -> None:
    """Pack the pictures of the scene that was appended from `source`, and forget where they were.

    Raises:
        SpecError: one lies outside the folder of `source`, or is none; or the scene uses a file that is no picture.
    """
    for image in bpy.data.images:
        if image.source not in ("GENERATED", "VIEWER"):
            if not image.packed_files:
                _pack(image, source)
            paths.forget_folder(image)
    for name in bpy.utils.blend_paths(absolute=False, packed=False, local=True):
        if not name.startswith("//") and Path(name).exists():
            raise SpecError(
                f"blend_file.path: {source} uses {name}, which is no picture; in Blender apply it (text to mesh, cache "
                "to mesh) or remove it"
            )


def _pack(image: bpy.types.Image, source: Path) -> None:
    """One that is not there stays away, as in Blender."""
    path, folder = Path(bpy.path.abspath(image.filepath)).resolve(), source.resolve().parent
    if image.source == "FILE" and not path.exists():
        return
    if not path.is_relative_to(folder):
        raise SpecError(
            f"blend_file.path: picture {image.name!r} of {source} is {path}, which is not in {folder}; move it there, "
            "or pack it in Blender (File > External Data > Pack Resources)"
        )
    if image.source not in ("FILE", "TILED"):
        raise SpecError(f"blend_file.path: picture {image.name!r} of {source} is a film; use a still picture")
    if path.suffix.lower() not in PICTURES or (path.exists() and not path.is_file()) or not image.size[0]:
        raise SpecError(f"blend_file.path: picture {image.name!r} of {source} is {path}, which is no picture")
    image.pack()
