"""Export of a reconstruction as OpenVDB files, one for each frame of the scene's range."""

from pathlib import Path

import bpy
import numpy as np
from bpy_extras.io_utils import ExportHelper

from ..pure import voxels
from ..pure.io import FileFormatError, gaussians_file, vdb_file
from ..scene import point_cloud
from .panel import number

FINENESS = 96  # voxels along the longest side, where no size is given


class GOF_OT_export_vdb(bpy.types.Operator, ExportHelper):
    """Write the selected reconstruction as OpenVDB, a file per frame: light (emission), opacity (density), velocity"""

    bl_idname = "gof.export_vdb"
    bl_label = "Export OpenVDB"

    filename_ext = ".vdb"
    filter_glob: bpy.props.StringProperty(default="*.vdb", options={"HIDDEN"})
    voxel_m: bpy.props.FloatProperty(
        name="Voxel (m)", default=0.0, min=0.0, precision=4, description="0: the longest side is 96 voxels"
    )

    @classmethod
    def poll(cls, context):
        return point_cloud.inputs(context.object) is not None and "gof_source" in context.object

    def draw(self, context):
        number(self.layout, self, "voxel_m")

    def execute(self, context):
        try:
            written = self._write(context.scene, context.object, Path(bpy.path.abspath(self.filepath)))
        except (FileFormatError, OSError, voxels.VoxelError, MemoryError) as error:
            self.report({"ERROR"}, str(error) or "not enough memory; make the voxels larger")
            return {"CANCELLED"}
        self.report({"INFO"}, f"{len(written)} files, {written[0].name} to {written[-1].name}, in {written[0].parent}")
        return {"FINISHED"}

    def _write(self, scene, thing, path: Path) -> list[Path]:
        try:
            from ..scene import images  # noqa: F401  (the wheel's Blender finds its own Python packages by it)

            import openvdb  # noqa: F401  # isort: skip
        except ImportError:
            raise FileFormatError(
                "this Blender comes without the openvdb module for Python: use 4.4 or later"
            ) from None
        rate = scene.render.fps / scene.render.fps_base
        cloud = gaussians_file.load(
            Path(thing["gof_source"]), gaussians_file.Clock(thing.get("gof_fps", rate), thing["gof_time_unit"] or None)
        )
        settings = point_cloud.inputs(thing)
        frames = np.arange(scene.frame_start, scene.frame_end + 1)
        times_s = (frames - settings["Start Frame"]) / rate * settings["Time Scale"]
        voxel_m = self.voxel_m
        if not voxel_m:
            low, high = np.percentile(cloud.position, [1, 99], axis=0)
            voxel_m = float((high - low).max()) / FINENESS or 0.01
        low, shape = voxels.box_of(cloud, times_s, voxel_m)
        manager, written = bpy.context.window_manager, []
        manager.progress_begin(0, len(frames))
        try:
            for frame, time_s in zip(frames, times_s, strict=True):
                grids = voxels.grids_at(cloud, float(time_s), low, shape, voxel_m)
                grids["velocity"] = grids["velocity"] * settings["Time Scale"]  # on the scene's clock
                written.append(path.with_name(f"{path.stem}_{frame:04d}.vdb"))
                vdb_file.write(written[-1], grids, voxels.index_to_world(low, voxel_m))
                manager.progress_update(len(written))
        finally:
            manager.progress_end()
        return written


CLASSES = (GOF_OT_export_vdb,)
