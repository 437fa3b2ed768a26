"""A reconstruction out again: as Gaussians that move as here, as points or as OpenVDB files over the frame range."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from bpy_extras.io_utils import ExportHelper

from ..core.errors import DataFormatError, GofError
from ..pure import voxels
from ..pure.io import usd_points, vdb_file
from ..pure.io.cloud import GaussianCloud
from ..scene import compat, exchange, point_cloud
from .panel import number

FINENESS = 96  # voxels along the longest side, where no size is given
RESULTS = (".npz", ".ply")  # files of moving Gaussians


@dataclass(frozen=True)
class Recording:
    """A cloud's Gaussians, and the scene's frames with what its clock says at each."""

    cloud: GaussianCloud
    frames: np.ndarray  # (F,) whole numbers
    start: float  # frame that is time 0
    rate: float
    time_scale: float
    least: float  # opacity that is drawn

    @classmethod
    def of(cls, scene: bpy.types.Scene, object_: bpy.types.Object) -> "Recording":
        """Read the settings in the .blend, without any other file.

        Raises:
            DataFormatError: it holds too little, or time or place may change: such a recording has one of each.
        """
        settings = point_cloud.inputs(object_)
        clock = {settings.path(name): name for name in ("Start Frame", "Time Scale", "Opacity Cut")}
        if moving := sorted({*_keyed(object_, clock), *_moves(object_)}):
            raise DataFormatError(
                f"{object_.name}: {', '.join(moving)} may change over time: remove what keys, drives or binds it, or "
                "write .abc"
            )
        rate, cloud = scene.render.fps / scene.render.fps_base, None
        if object_.type == "MESH":
            cloud = point_cloud.cloud_of(object_)
        if cloud is None:
            raise DataFormatError(
                f"{object_.name}: edited since, or imported by an older version of the add-on: its colors are not in "
                "this .blend; import the reconstruction again"
            )
        return cls(
            cloud,
            np.arange(scene.frame_start, scene.frame_end + 1),
            settings["Start Frame"],
            rate,
            settings["Time Scale"],
            settings["Opacity Cut"],
        )

    def time_s(self, frame):
        """Return the time of the recording, at a frame or at an array of frames."""
        return (frame - self.start) / self.rate * self.time_scale

    @property
    def times_s(self) -> np.ndarray:
        """(F,)"""
        return self.time_s(self.frames)

    def drawn(self, world: np.ndarray) -> GaussianCloud:
        """Return the Gaussians that are drawn, in another world. Args and errors as `moved_to`, but for still ones."""
        return self.cloud[self.cloud.opacity >= self.least].transformed(world)

    def moved_to(self, world: np.ndarray) -> GaussianCloud:
        """Return the Gaussians that are drawn, in another world, on the scene's clock: 0 s is its first frame.

        Args:
            world: similarity (4, 4) from the cloud's own metres.
        Raises:
            DataFormatError: they are stills, or time stands still.   GofError: no similarity.
        """
        pace = self.time_scale
        if self.cloud.begin is not None:
            raise DataFormatError("these are stills, one after another, and nothing in them moves: write .usdc or .abc")
        if not pace:
            raise DataFormatError("Time Scale is 0, so nothing moves: set it, or write .usdc or .abc")
        cloud: Any = self.drawn(world)
        light = np.where(cloud.dynamic[:, None], cloud.velocity, 0)
        known = not np.array_equal(cloud.moving_gas, light)  # the .blend has the light's where a result has no gas'
        return replace(
            cloud,
            t_mu=(self.start - self.frames[0]) / self.rate + cloud.t_mu / np.float64(pace),
            t_sigma=cloud.t_sigma / abs(pace),
            velocity=cloud.velocity * pace,
            gas_velocity=cloud.moving_gas * pace if known else None,
            velocity_sd=cloud.velocity_sd * abs(pace),
        )


def _world_m(scene: bpy.types.Scene, object_: bpy.types.Object) -> np.ndarray:
    """Return the similarity (4, 4) from a cloud's own metres to those of the scene."""
    return np.diag([scene.unit_settings.scale_length] * 3 + [1.0]) @ np.array(object_.matrix_world)


def _keyed(object_: bpy.types.Object, paths: dict[str, str]) -> list[str]:
    """Return which of some properties, by their paths, are keyed or driven on an object."""
    return [paths[curve.data_path] for curve in compat.curves(object_) if curve.data_path in paths]


def _moves(object_: bpy.types.Object) -> Iterator[str]:
    """Yield what may move an object: its own place, its constraints, and those of all that it hangs on."""
    place = {f"rotation_{kind}": "rotation" for kind in ("euler", "quaternion", "axis_angle")}
    place |= {name: name for name in ("location", "scale")}
    place |= {f"delta_{path}": name for path, name in place.items()}
    whose, it = "", object_
    while it is not None:
        yield from (f"{name}{whose}" for name in _keyed(it, place))
        yield from (f"constraint {bond.name}{whose}" for bond in it.constraints if not bond.mute)
        if it.parent is not None and it.parent_type != "OBJECT":  # a bone, a corner: posed without a key of the object
            yield f"{it.parent_type.lower()} of {it.parent.name}"
        it = it.parent
        whose = f" of {it.name}" if it else ""


class _CloudExport(ExportHelper):
    """An export of the active reconstruction."""

    @classmethod
    def poll(cls, context):
        return point_cloud.inputs(context.object) is not None

    def invoke(self, context, event):
        """Ask for a name, where this Blender can write any such file."""
        if problem := self.why_not():
            self.report({"ERROR"}, problem)
            return {"CANCELLED"}
        return super().invoke(context, event)

    def execute(self, context):
        try:
            message = self.write(context, context.object, Path(bpy.path.abspath(self.filepath)))
        except (GofError, OSError, RuntimeError, voxels.VoxelError, MemoryError) as error:
            self.report({"ERROR"}, str(error) or "not enough memory; fewer frames, or larger voxels, need less")
            return {"CANCELLED"}
        self.report({"INFO"}, message)
        return {"FINISHED"}

    @staticmethod
    def why_not() -> str | None:
        """Why this Blender can write no such file, if it cannot."""
        return None

    def write(self, context, object_: bpy.types.Object, path: Path) -> str:
        """Write the files; returns a line for the user."""
        raise NotImplementedError


class GOF_OT_export_vdb(_CloudExport, bpy.types.Operator):
    """Write the selected reconstruction as OpenVDB, a file per frame: light (emission), opacity (density), velocity"""

    bl_idname = "gof.export_vdb"
    bl_label = "Export OpenVDB"

    filename_ext = ".vdb"
    filter_glob: bpy.props.StringProperty(default="*.vdb", options={"HIDDEN"})
    voxel_m: bpy.props.FloatProperty(
        name="Voxel (m)", default=0.0, min=0.0, precision=4, description="0: the longest side is 96 voxels"
    )

    @staticmethod
    def why_not() -> str | None:
        _find_packages()
        try:
            vdb_file.library()
        except ImportError:
            return (
                "This Blender comes without the OpenVDB module for Python: "
                "use Blender 4.4 or later (Debian: python3-openvdb)"
            )
        return None

    def draw(self, context):
        number(self.layout, self, "voxel_m")

    def write(self, context, object_, path):
        if problem := self.why_not():
            raise DataFormatError(problem)
        recording = Recording.of(context.scene, object_)
        cloud, voxel_m = recording.drawn(_world_m(context.scene, object_)), self.voxel_m
        if not voxel_m:
            low, high = np.percentile(cloud.position, [1, 99], axis=0)
            voxel_m = float((high - low).max()) / FINENESS or 0.01
        low, shape = voxels.box_of(cloud, recording.times_s, voxel_m)
        written = []
        for frame, time_s in _with_progress(recording):
            grids = voxels.grids_at(cloud, time_s, low, shape, voxel_m)
            grids["velocity"] = grids["velocity"] * recording.time_scale  # on the scene's clock
            written.append(path.with_name(f"{path.stem}_{frame:04d}.vdb"))
            vdb_file.write(written[-1], grids, voxels.index_to_world(low, voxel_m))
        return f"{len(written)} files, {written[0].name} to {written[-1].name}, in {written[0].parent}"


class GOF_OT_export_points(_CloudExport, bpy.types.Operator):
    """Write the selected reconstruction into one file: .npz or .ply as moving Gaussians, USD or Alembic as points"""

    bl_idname = "gof.export_points"
    bl_label = "Export Points"

    filename_ext = ".usdc"
    check_extension = None  # the name says which of the formats
    filter_glob: bpy.props.StringProperty(default="*.npz;*.ply;*.usd;*.usdc;*.usda;*.abc", options={"HIDDEN"})

    def write(self, context, object_, path):
        scene = context.scene
        suffix = path.suffix.lower()
        if suffix in RESULTS:
            moving = Recording.of(scene, object_).moved_to(_world_m(scene, object_))
            moving.save(path, source=object_.name)
            return f"{len(moving)} Gaussians: {path}"
        if suffix == ".abc":
            exchange.write_points(path, object_, scene.frame_start, scene.frame_end)
        elif suffix in usd_points.SUFFIXES:
            self._usd(scene, object_, path)
        else:
            raise DataFormatError(f"{path.name}: the name must end in .npz, .ply, .usd, .usdc, .usda or .abc")
        return f"Frames {scene.frame_start} to {scene.frame_end}: {path}"

    @staticmethod
    def _usd(scene, object_, path: Path) -> None:
        _find_packages()
        recording = Recording.of(scene, object_)

        def frames() -> Iterator[tuple[int, usd_points.VisibleGaussians]]:
            for frame, time_s in _with_progress(recording):
                yield frame, usd_points.at(recording.cloud, time_s, recording.least, recording.time_scale)

        clock = usd_points.SceneFrames(scene.frame_start, scene.frame_end, recording.rate)
        usd_points.write(path, frames(), clock, np.array(object_.matrix_world), scene.unit_settings.scale_length)


def _find_packages() -> None:
    """Let the wheel's Blender find its own Python packages; others do."""
    try:
        from ..scene import images  # noqa: F401
    except ImportError:
        pass  # Debian's Blender without OpenImageIO, which may have the packages all the same


def _with_progress(recording: Recording) -> Iterator[tuple[int, float]]:
    """Yield frames and times of a recording, with the share that is done shown at the mouse pointer."""
    manager = bpy.context.window_manager
    manager.progress_begin(0, len(recording.frames))
    try:
        for done, (frame, time_s) in enumerate(zip(recording.frames, recording.times_s, strict=True)):
            yield int(frame), float(time_s)
            manager.progress_update(done + 1)
    finally:
        manager.progress_end()


CLASSES = (GOF_OT_export_vdb, GOF_OT_export_points)
