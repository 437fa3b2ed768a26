"""Cameras of a scene as entries of a file, and entries of a file as cameras of a scene.

In files places are metres. They count from the scene's origin, or from the fire's empty as in a dataset of the scene.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from ..core.checked_json import SpecError
from ..core.description import CameraEntry
from ..core.errors import GofError
from ..pure.rig import Pose, Rig
from ..pure.spec import SceneSpec
from . import captured, place, rig

SAME = 1e-4  # relative; lenses that differ by less are the same


def chosen(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Return the rig's cameras; without a rig all of the scene's."""
    return place.cameras(scene) or [object_ for object_ in scene.objects if object_.type == "CAMERA"]


def describe(camera: bpy.types.Object, scene: bpy.types.Scene, to_file: Matrix) -> CameraEntry:
    """Return the view of a camera at the current frame, by the very matrix that Blender projects with.

    Args:
        to_file: from the scene's world to the file's.
    Raises:
        SpecError: it is orthographic or a panorama.
    """
    if camera.data.type != "PERSP":
        raise SpecError(f"{camera.name} is no perspective camera; these files hold perspective cameras only")
    render = scene.render
    share = render.resolution_percentage / 100
    width, height = (int(side * share) for side in (render.resolution_x, render.resolution_y))
    graph = bpy.context.evaluated_depsgraph_get()
    # The clip space's [-1, 1] is the picture, y up.
    p = camera.evaluated_get(graph).calc_matrix_camera(
        graph, x=width, y=height, scale_x=render.pixel_aspect_x, scale_y=render.pixel_aspect_y
    )
    k = ((p[0][0] * width / 2, 0.0, (1 - p[0][2]) * width / 2), (0.0, p[1][1] * height / 2, (1 + p[1][2]) * height / 2))
    name = place.part_of(camera) or camera.get(captured.NAME) or camera.name
    return CameraEntry(
        name=bpy.path.clean_name(name),
        width=width,
        height=height,
        K=(*k, (0.0, 0.0, 1.0)),
        world_to_camera=rig.pose_of(to_file @ camera.matrix_world).tolist(),
        role="eval" if name.startswith("eval") else "train",
    )


def describe_all(cameras: list[bpy.types.Object], scene: bpy.types.Scene, to_file: Matrix) -> tuple[CameraEntry, ...]:
    """Return each camera's entry, under a name of its own: two may be alike without what no file name has.

    Raises SpecError: see `describe`.
    """
    entries, taken = [], set()
    for entry in (describe(camera, scene, to_file) for camera in cameras):
        name, number = entry.name, 1
        while name in taken:
            number += 1
            name = f"{entry.name}_{number}"
        taken.add(name)
        entries.append(replace(entry, name=name))
    return tuple(entries)


def add(
    entries: tuple[CameraEntry, ...], folder: Path, scene: bpy.types.Scene, to_scene: Matrix
) -> list[bpy.types.Object]:
    """Add cameras of any lens; the scene's picture size becomes that of the first.

    Args:
        folder: where the entries' pictures lie.     to_scene: from the file's world to the scene's.
    Raises:
        DataFormatError: a picture is missing or cannot be read; then no camera is added.
    """
    collection, scale = place.collection(scene, "Imported Cameras"), scene.unit_settings.scale_length
    added = []
    try:
        for entry in entries:
            camera = captured.add_camera(entry, folder, collection, scale)
            turned = to_scene @ camera.matrix_world
            camera.matrix_world = Matrix.LocRotScale(turned.to_translation(), turned.to_quaternion(), None)
            camera.data.display_size = 0.2 / scale
            added.append(camera)
    except GofError:
        for camera in added:
            bpy.data.cameras.remove(camera.data)
        if not collection.objects:
            bpy.data.collections.remove(collection)
        raise
    captured.set_picture(entries[0], scene.render)
    scene.camera = added[0]
    return added


def as_rig(planned: Rig, entries: tuple[CameraEntry, ...], to_place: Matrix) -> Rig:
    """Return the entries as a rig of cameras that were placed one by one, those for evaluation last.

    Args:
        planned: whose other settings are kept.     to_place: from the file's world to the fire's.
    Raises:
        SpecError: a rig's cameras have one size and one lens, square pixels and a centred axis.
    """
    first = entries[0]
    for entry in entries:
        k = np.array(entry.K)
        lens = [k[0, 0], k[1, 1], k[0, 2], k[1, 2], entry.width, entry.height]
        wanted = [first.K[0][0], first.K[0][0], first.width / 2, first.height / 2, first.width, first.height]
        if np.abs(np.array(lens) - wanted).max() > SAME * max(first.width, first.height):
            raise SpecError(
                f"{entry.name}: a rig's cameras have one size and one lens, square pixels and a centred axis; "
                "untick As the Rig to add them unchanged"
            )
    ordered = sorted(entries, key=lambda entry: entry.role == "eval")
    evaluation = sum(entry.role == "eval" for entry in ordered)
    long, short = max(first.width, first.height), min(first.width, first.height)
    portrait = first.height > first.width
    roll = planned.roll_deg if planned.portrait == portrait else (90 if portrait else 0)
    return replace(
        planned,
        count=len(ordered) - evaluation,
        eval_count=evaluation,
        focal_mm=round(first.K[0][0] / long * rig.SENSOR_MM, 5),
        sensor_px=(long, short),
        roll_deg=roll,
        placed=tuple(_pose(to_place @ captured.matrix_of(entry)) for entry in ordered),
    )


def world_of_files(scene: bpy.types.Scene, from_fire: bool) -> Matrix:
    """From the scene's world to that of files. Raises SpecError: places shall count from a fire that is not there."""
    scale = scene.unit_settings.scale_length
    if not from_fire:
        return Matrix.Scale(scale, 4)
    marker = place.find(scene, place.PLACE)
    if marker is None:
        raise SpecError("there is no fire in this scene to count from: press Add Fire, or untick Relative to Fire")
    return place.to_our_world(marker.matrix_world, scale)


def place_rig(spec: SceneSpec, scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Return the spec's cameras around the scene's fire, instead of those before."""
    return place.add_cameras(spec, scene, place.find(scene, place.PLACE))


def _pose(matrix: Matrix) -> Pose:
    turn = matrix.to_quaternion()
    turn.normalize()
    position = tuple(round(value, 6) + 0.0 for value in matrix.to_translation())
    if not all(map(math.isfinite, position)):
        raise SpecError("a camera of this file is too far away for Blender's numbers")
    return Pose(position, tuple(round(value, 7) + 0.0 for value in turn))
