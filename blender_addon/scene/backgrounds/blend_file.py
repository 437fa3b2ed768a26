"""A user's .blend as the surroundings of the fire.

Everything in the file's scene that is visible in renders is brought in and moved so that the chosen empty becomes the
origin of our world, with the empty's turn about Z undone and the file's unit scale applied: one of its units may be a
centimetre. Objects stand still, as at the file's current frame. Its cameras, fluid domains and flows stay out,
and so does a fire that the add-on has put there. An effector of its fluids is an obstacle of our gas, seen or hidden.
Only its pictures are read from the disk (`foreign`).
"""

from __future__ import annotations

from pathlib import Path

import bpy
from mathutils import Matrix

from ...core.checked_json import SpecError
from ...core.files import atomic_path
from ...pure.spec import SceneSpec
from .. import paths, place


def build(spec: SceneSpec, collection: bpy.types.Collection) -> None:
    """Append the scene of ``spec.blend_file``.

    Raises SpecError if the file cannot be read, has no scene or no such empty, or see `foreign`.
    """
    path, name = Path(spec.blend_file.path), spec.blend_file.empty
    if not path.is_file():
        raise SpecError(f"blend_file.path: there is no file {path}")
    scene = _append_scene(path)
    cut_links(path)
    marker = scene.objects.get(name)
    if marker is None:
        empties = sorted(object_.name for object_ in scene.objects if object_.type == "EMPTY")
        raise SpecError(f"blend_file.empty: {path} has no object {name!r}; its empties: {', '.join(empties) or 'none'}")
    scale = scene.unit_settings.scale_length
    to_ours = place.to_our_world(marker.matrix_world, scale)
    poses = {object_: to_ours @ object_.matrix_world for object_ in scene.objects}
    for object_, pose in poses.items():
        if object_ is not marker and stays_out(object_):
            bpy.data.objects.remove(object_)  # also for its name, which may be one of ours
            continue
        _place(object_, pose, scale)
        # A hidden object may shape others all the same, by a modifier of theirs.
        if object_ is marker or is_obstacle(object_) or not object_.hide_render:
            collection.objects.link(object_)
    ours = bpy.context.scene
    ours.world = scene.world
    bpy.data.scenes.remove(scene)
    bpy.context.view_layer.update()
    marker.pop(place.PART, None)  # of a fire that is not here
    forget_origin()
    stand_still()
    take_pictures(path)  # scene.blend must not depend on where the user's textures are


def save(collection: bpy.types.Collection, path: Path) -> None:
    """Write the surroundings to a .blend of their own, which `build` reads as it read the user's.

    It is in the dataset, so that the scene can be built again from that alone.
    """
    surroundings = bpy.data.scenes.new("Surroundings")
    surroundings.collection.children.link(collection)
    surroundings.world = bpy.context.scene.world
    paths.overwrite(surroundings.render, "filepath", "//")
    surroundings.view_layers[0].update()  # Blender 5.2 crashes where it writes a scene that was never looked at
    with atomic_path(path) as draft:
        bpy.data.libraries.write(str(draft), {surroundings}, path_remap="NONE", fake_user=True, compress=True)
    bpy.data.scenes.remove(surroundings)


def _append_scene(path: Path) -> bpy.types.Scene:
    try:
        with bpy.data.libraries.load(str(path), link=False) as (theirs, ours):
            ours.scenes = theirs.scenes[:1]
    except OSError as error:
        raise SpecError(f"blend_file.path: Blender cannot read {path}: {error}") from error
    if not ours.scenes:
        raise SpecError(f"blend_file.path: {path} holds no scene")
    scene = ours.scenes[0]
    scene.view_layers[0].update()  # poses of parents and constraints
    return scene


def stays_out(object_: bpy.types.Object) -> bool:
    """Return whether an object of a user's scene is no part of the surroundings."""
    fluid = any(
        modifier.type == "FLUID" and modifier.fluid_type in ("DOMAIN", "FLOW") for modifier in object_.modifiers
    )
    return bool(object_.type == "CAMERA" or fluid or place.part_of(object_))


def is_obstacle(object_: bpy.types.Object) -> bool:
    """Return whether gas flows around an object."""
    effectors = [modifier.effector_settings for modifier in object_.modifiers if modifier.type == "FLUID"]
    return any(settings and settings.effector_type == "COLLISION" and settings.use_effector for settings in effectors)


def _place(object_: bpy.types.Object, pose: Matrix, scale: float) -> None:
    """Fix an object at its pose in our world, free of parents, constraints and animation."""
    object_.animation_data_clear()
    object_.parent = None
    object_.constraints.clear()
    object_.matrix_world = pose
    if object_.type == "LIGHT" and object_.data.type != "SUN":
        # Power falls off with squared distance, which has just changed by the scale.
        object_.data = object_.data.copy()
        object_.data.energy *= scale**2
        if object_.data.type in ("POINT", "SPOT"):
            object_.data.shadow_soft_size *= scale


# ----------------------------------------------------------------
# From a .blend that anybody may have made only its look comes in, and nothing else of this disk.
#
# A .blend names files: whatever Blender packs would be published with the dataset, also another person's.

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
    """Take away what moves or acts: animation, drivers, scripts, sounds. Values are kept."""
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
    """Pack it. One that is not there stays away, as in Blender."""
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
