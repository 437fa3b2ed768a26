"""A user's .blend as the surroundings of the fire.

Everything in the file's scene that is visible in renders is brought in and moved so that the chosen empty becomes the
origin of our world, with the empty's turn about Z undone and the file's unit scale applied: one of its units may be a
centimetre. Objects stand still, as they are at the file's current frame. Its cameras, fluid domains and flows stay out,
and so does a fire that the add-on has put there. An effector of its fluids is an obstacle of our gas, seen or hidden.
Of the disk only its pictures come in (`foreign`).
"""

from __future__ import annotations

from pathlib import Path

import bpy
from mathutils import Matrix

from ...core.checked_json import SpecError
from ...core.files import atomic_path
from ...pure.spec import SceneSpec
from .. import paths, place
from . import foreign


def build(spec: SceneSpec, collection: bpy.types.Collection) -> None:
    """Append the scene of ``spec.blend_file``.

    Raises SpecError if the file cannot be read, has no scene or no such empty, or see `foreign`.
    """
    path, name = Path(spec.blend_file.path), spec.blend_file.empty
    if not path.is_file():
        raise SpecError(f"blend_file.path: there is no file {path}")
    scene = _append_scene(path)
    foreign.cut_links(path)
    marker = scene.objects.get(name)
    if marker is None:
        empties = sorted(thing.name for thing in scene.objects if thing.type == "EMPTY")
        raise SpecError(f"blend_file.empty: {path} has no object {name!r}; its empties: {', '.join(empties) or 'none'}")
    scale = scene.unit_settings.scale_length
    to_ours = place.to_our_world(marker.matrix_world, scale)
    poses = {thing: to_ours @ thing.matrix_world for thing in scene.objects}
    for thing, pose in poses.items():
        if thing is not marker and stays_out(thing):
            bpy.data.objects.remove(thing)  # also for its name, which may be one of ours
            continue
        _place(thing, pose, scale)
        # What is hidden may shape others all the same, by a modifier of theirs.
        if thing is marker or is_obstacle(thing) or not thing.hide_render:
            collection.objects.link(thing)
    ours = bpy.context.scene
    ours.world = scene.world
    bpy.data.scenes.remove(scene)
    bpy.context.view_layer.update()
    marker.pop(place.PART, None)  # of a fire that is not here
    foreign.forget_origin()
    foreign.stand_still()
    foreign.take_pictures(path)  # scene.blend must not depend on where the user's textures are


def save(collection: bpy.types.Collection, path: Path) -> None:
    """Write the surroundings to a .blend of their own, which `build` reads as it read the user's.

    It lies in the dataset, so that whoever has that can build the scene again.
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


def stays_out(thing: bpy.types.Object) -> bool:
    """Whether an object of a user's scene is no part of the surroundings."""
    fluid = any(modifier.type == "FLUID" and modifier.fluid_type in ("DOMAIN", "FLOW") for modifier in thing.modifiers)
    return bool(thing.type == "CAMERA" or fluid or place.part_of(thing))


def is_obstacle(thing: bpy.types.Object) -> bool:
    """Whether gas flows around an object."""
    effectors = [modifier.effector_settings for modifier in thing.modifiers if modifier.type == "FLUID"]
    return any(settings and settings.effector_type == "COLLISION" and settings.use_effector for settings in effectors)


def _place(thing: bpy.types.Object, pose: Matrix, scale: float) -> None:
    """Fix an object at its pose in our world, free of parents, constraints and animation."""
    thing.animation_data_clear()
    thing.parent = None
    thing.constraints.clear()
    thing.matrix_world = pose
    if thing.type == "LIGHT" and thing.data.type != "SUN":
        # Power falls off with squared distance, which has just changed by the scale.
        thing.data = thing.data.copy()
        thing.data.energy *= scale**2
        if thing.data.type in ("POINT", "SPOT"):
            thing.data.shadow_soft_size *= scale
