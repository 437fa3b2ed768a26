"""A real capture in Blender: its cameras where they stood, each before its picture without fire.

Nothing of a capture's surroundings is known in 3D, so there is no light and no floor: the plate is the background of
the camera that renders, and in the viewport of every camera that is looked through.
"""

from __future__ import annotations

import math
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix, Vector

from ..core.description import CameraEntry, DatasetDescription
from ..core.errors import DataFormatError
from ..core.files import path_in
from . import compat, paths, place

FIRST_FRAME = 1  # Blender's frame at time 0
SENSOR_MM = 36.0
SAMPLES = 16
NAME = "gof_camera"  # custom property: the camera's name in its file


def scene(description: DatasetDescription, folder: Path) -> None:
    """Replace the open scene by the capture's cameras and clock: one Blender frame per frame of the dataset.

    Raises:
        DataFormatError: a camera's plate is not in the dataset.
    """
    bpy.ops.wm.read_factory_settings(use_empty=True)
    current = bpy.context.scene
    current.name = description.name
    rate = frames_per_second(description)
    current.render.fps, current.render.fps_base = max(1, round(rate)), max(1, round(rate)) / rate
    current.frame_start = FIRST_FRAME
    current.frame_end = round(moment(description, description.time_s[-1]))
    current.view_settings.view_transform = "Standard"  # plates are pictures for display already
    current.render.engine = "CYCLES"
    current.cycles.device = "CPU"
    current.cycles.samples = SAMPLES
    current.cycles.use_denoising = False
    current.render.dither_intensity = 0.0
    current.cycles.pixel_filter_type, current.cycles.filter_width = "BOX", 1.0  # a wider filter would blur the plate
    collection = bpy.data.collections.new("Cameras")
    current.collection.children.link(collection)
    for entry in description.cameras:
        add_camera(entry, folder, collection)


def frames_per_second(description: DatasetDescription) -> float:
    """Return the dataset's usual rate; 25 for a single frame."""
    return 1 / float(np.median(np.diff(description.time_s))) if len(description.time_s) > 1 else 25.0


def moment(description: DatasetDescription, time_s: float) -> float:
    """Blender frame, with its fraction, of a time on the dataset clock."""
    return FIRST_FRAME + time_s * frames_per_second(description)


def add_camera(
    entry: CameraEntry, folder: Path, collection: bpy.types.Collection, metres_per_unit: float = 1.0
) -> bpy.types.Object:
    """Return a camera with the entry's pose and lens, and its plate behind what it sees.

    Its pose is in metres; how far it sees is in the scene's units, as Blender takes it.
    Raises DataFormatError: its plate is not in the folder, or no picture.
    """
    plate = _plate(entry, folder)
    data = bpy.data.cameras.new(entry.name)
    K = np.array(entry.K)
    data.sensor_fit, data.sensor_width = "HORIZONTAL", SENSOR_MM
    data.lens = K[0, 0] / entry.width * SENSOR_MM
    # Shifts are in widths of the picture; heights of its pixels are those of `look_through`.
    data.shift_x = 0.5 - K[0, 2] / entry.width
    data.shift_y = (K[1, 2] - entry.height / 2) * (K[0, 0] / K[1, 1]) / entry.width
    data.clip_start, data.clip_end = 0.01 / metres_per_unit, 1000.0 / metres_per_unit
    if plate:
        data.show_background_images = True
        behind = data.background_images.new()
        behind.image, behind.alpha, behind.frame_method = plate, 1.0, "STRETCH"
    camera = bpy.data.objects.new(entry.name, data)
    camera[NAME] = entry.name  # Blender cuts long names, and numbers those that are taken
    collection.objects.link(camera)
    camera.matrix_world = matrix_of(entry)
    return camera


def matrix_of(entry: CameraEntry) -> Matrix:
    """Return camera to world in Blender's axes."""
    return Matrix((np.linalg.inv(np.array(entry.world_to_camera)) @ np.diag([1.0, -1.0, -1.0, 1.0])).tolist())


def set_picture(entry: CameraEntry, render: bpy.types.RenderSettings) -> None:
    """Give renders the entry's size, and pixels of its shape."""
    render.resolution_x, render.resolution_y, render.resolution_percentage = entry.width, entry.height, 100
    ratio = entry.K[1][1] / entry.K[0][0]
    render.pixel_aspect_x, render.pixel_aspect_y = max(ratio, 1.0), max(1 / ratio, 1.0)


def look_through(entry: CameraEntry) -> None:
    """Make a camera the scene's: its picture size, and its plate as what is behind everything in renders."""
    current = bpy.context.scene
    current.camera = next(object_ for object_ in current.objects if object_.get(NAME) == entry.name)
    set_picture(entry, current.render)
    current.world = bpy.data.worlds.new("Plate")
    behind = current.camera.data.background_images
    _show(current.world, behind[0].image if len(behind) else None)


def _plate(entry: CameraEntry, folder: Path) -> bpy.types.Image | None:
    """Return the camera's picture without fire, packed into the .blend."""
    if entry.static is None:
        return None
    file = path_in(folder, entry.static)
    if not file.is_file():
        raise DataFormatError(f"{file}: no such file, though camera {entry.name} of {folder.resolve().name} names it")
    image = bpy.data.images.load(str(file))
    if not image.size[0]:
        bpy.data.images.remove(image)
        raise DataFormatError(f"{file}: is no picture that Blender can read")
    image.pack()
    image.name = f"Plate of {entry.name}"
    paths.forget_folder(image)
    return image


def _show(world: bpy.types.World, plate: bpy.types.Image | None) -> None:
    """Fill the camera's frame with the plate; black without one."""
    tree = compat.add_nodes(world)
    nodes, links = tree.nodes, tree.links
    nodes.clear()
    output, light = nodes.new("ShaderNodeOutputWorld"), nodes.new("ShaderNodeBackground")
    links.new(light.outputs["Background"], output.inputs["Surface"])
    light.inputs["Color"].default_value = (0.0, 0.0, 0.0, 1.0)
    world.cycles.sampling_method = "NONE"  # it lights nothing
    if plate is None:
        return
    place, picture = nodes.new("ShaderNodeTexCoord"), nodes.new("ShaderNodeTexImage")
    picture.image, picture.extension, picture.interpolation = plate, "EXTEND", "Closest"
    links.new(place.outputs["Window"], picture.inputs["Vector"])
    links.new(picture.outputs["Color"], light.inputs["Color"])


# ----------------------------------------------------------------
# From which sides the cameras filmed.

GUESSED_DEG = 20.0  # from the nearest camera on, a flame's shape is a guess
HELD_OUT = ("eval", "around")  # names of cameras that no method learns from begin so
AHEAD = Vector((0.0, 0.0, -1.0))  # a camera's and a view's own axis


def cameras(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Return the cameras of the scene's rig, or of its capture, that a method may learn from."""
    named = [(place.part_of(object_) or object_.get(NAME), object_) for object_ in scene.objects]
    return [object_ for name, object_ in named if object_.type == "CAMERA" and name and not name.startswith(HELD_OUT)]


def guess(scene: bpy.types.Scene, forward: Vector) -> str | None:
    """Return in words how far a view is from the nearest camera that filmed; None where it is near.

    Args:
        forward: where the view looks, in the world; any length above 0.
    """
    filmed = cameras(scene)
    if not filmed:
        return "Sides that no camera filmed are guesses"
    away = min(math.degrees(forward.angle(camera.matrix_world.to_3x3() @ AHEAD)) for camera in filmed)
    return f"{away:.0f}° from the nearest camera: its shape is a guess" if away > GUESSED_DEG else None
