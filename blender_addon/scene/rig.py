"""The camera rig: cameras on an arc, and their exact intrinsics and poses as the dataset records them."""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Matrix, Quaternion, Vector

from ..core.description import CameraEntry
from ..pure.rig import AROUND, Rig, positions, role_of
from ..pure.spec import SceneSpec

NEAREST = 0.05  # m; what is nearer to a camera is not drawn
SENSOR_MM = 36.0  # long side of the sensor
READOUT = {0: "down", 90: "left", 180: "up", -90: "right"}
"""Direction in the stored (upright) image in which successive sensor rows are read, per roll of the camera body."""


def build(spec: SceneSpec, collection: bpy.types.Collection) -> list[bpy.types.Object]:
    """Add the cameras of the spec and set the scene's image size."""
    rig = spec.cameras
    set_picture_size(spec)
    cameras = []
    for name, pose in zip(rig.names, poses(rig), strict=True):
        data = bpy.data.cameras.new(name)
        data.lens = rig.focal_mm
        # The focal length refers to the sensor's long side, which is vertical in a portrait image.
        data.sensor_fit = "VERTICAL" if rig.portrait else "HORIZONTAL"
        data.sensor_width = data.sensor_height = SENSOR_MM
        nearest = _fire_begins_at(spec, pose) if role_of(name) == "around" else 0.0
        data.clip_start, data.clip_end = max(nearest, NEAREST), 1000.0
        camera = bpy.data.objects.new(name, data)
        collection.objects.link(camera)
        camera.matrix_world = pose
        cameras.append(camera)
    bpy.context.scene.camera = cameras[0]
    return cameras


def _fire_begins_at(spec: SceneSpec, pose: Matrix) -> float:
    """Return the distance from a camera to the fire's box, m; below 0 for a camera in it.

    Surroundings are made to be seen from one side: what of them is nearer than the fire would hide it.
    """
    box = spec.box
    corners = np.array(np.meshgrid(*zip(box.min, box.max, strict=True))).reshape(3, -1).T
    x = np.array(pose, np.float64)
    return float((-(corners - x[:3, 3]) @ x[:3, 2]).min())


def set_picture_size(spec: SceneSpec) -> None:
    # The rendered size at 100 %: with a percentage that does not divide, Blender's own view functions and Cycles would
    # disagree about the shape of the image.
    along_rows, rows = spec.picture_px
    width, height = (rows, along_rows) if spec.cameras.portrait else (along_rows, rows)
    settings = bpy.context.scene.render
    settings.resolution_x, settings.resolution_y, settings.resolution_percentage = width, height, 100


def find(spec: SceneSpec) -> list[bpy.types.Object]:
    """Return the rig's cameras in the open scene, in order."""
    return [bpy.data.objects[name] for name in spec.cameras.names]


def intrinsics(camera: bpy.types.Object, scene: bpy.types.Scene) -> np.ndarray:
    """Return (3, 3) matrix K in pixels; pixel centres are at integer + 0.5, so the image spans [0, width] x [0,
    height]."""
    width, height = scene.render.resolution_x, scene.render.resolution_y
    data = camera.data
    side_px, side_mm = (height, data.sensor_height) if data.sensor_fit == "VERTICAL" else (width, data.sensor_width)
    focal_px = data.lens / side_mm * side_px
    return np.array([[focal_px, 0.0, width / 2], [0.0, focal_px, height / 2], [0.0, 0.0, 1.0]])


def world_to_camera(camera: bpy.types.Object) -> np.ndarray:
    """Return (4, 4) pose in OpenCV axes (x right, y down, z forward), from the single-precision pose Blender renders
    with."""
    return pose_of(camera.matrix_world)


def pose_of(to_world: Matrix) -> np.ndarray:
    """Return (4, 4) world to camera in OpenCV axes; the rotation is made orthonormal in double precision.

    Args:
        to_world: camera to world, x right, y up, z backward.
    """
    pose = np.array(to_world, dtype=np.float64)
    u, _, vt = np.linalg.svd(pose[:3, :3] @ np.diag([1.0, -1.0, -1.0]))
    rotation = (u @ vt).T
    result = np.eye(4)
    result[:3, :3] = rotation
    result[:3, 3] = -rotation @ pose[:3, 3]
    return result


def describe(camera: bpy.types.Object, spec: SceneSpec, files: dict[str, str]) -> CameraEntry:
    """Return the camera's entry in dataset.json; `files` are its file names by kind."""
    scene = bpy.context.scene
    index = spec.cameras.names.index(camera.name)
    timings = [spec.timeline.timing(index, frame) for frame in range(spec.clip.frames)]
    return CameraEntry(
        name=camera.name,
        width=scene.render.resolution_x,
        height=scene.render.resolution_y,
        K=intrinsics(camera, scene).tolist(),
        world_to_camera=world_to_camera(camera).tolist(),
        roll_deg=spec.cameras.roll_deg,
        row_time_s=timings[0].line,
        readout=READOUT[spec.cameras.roll_deg],
        role=role_of(camera.name),
        frames=tuple(frame for frame, seen_by in spec.pictures if seen_by == index) if camera.name in AROUND else None,
        # Middle of the first line's exposure.
        time_s=tuple(k / spec.clip.fps + when.delay + when.open / 2 for k, when in enumerate(timings)),
        **files,
    )


def as_picture(values: np.ndarray, spec: SceneSpec) -> np.ndarray:
    """Return values of lines in reading order as (H, 1, 1) or (1, W, 1), to be combined with a stored picture."""
    direction = READOUT[spec.cameras.roll_deg]
    ordered = values[::-1] if direction in ("left", "up") else values
    return ordered[None, :, None] if direction in ("left", "right") else ordered[:, None, None]


def poses(rig: Rig) -> list[Matrix]:
    """Return camera to world of all cameras, in the order of their names: as they were placed, on the arc, or
    around."""
    placed = [Matrix.LocRotScale(Vector(pose.position), Quaternion(pose.rotation), None) for pose in rig.placed]
    places = positions(rig)[len(placed) :].tolist()
    turns = [(Vector(rig.look_at) - Vector(position)).to_track_quat("-Z", "Y") for position in places]
    return placed + [
        Matrix.LocRotScale(Vector(position), turn, None) for position, turn in zip(places, turns, strict=True)
    ]
