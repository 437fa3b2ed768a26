"""The active cloud at the current frame as Blender's own Gaussian splats, where the version has them."""

import bpy
import numpy as np

from ..core.errors import GofError
from ..pure import points
from ..scene import compat, native_splats, point_cloud
from .export import Recording


class GOF_OT_native_splats(bpy.types.Operator):
    """Add what the selected reconstruction shows at this frame as Blender's own Gaussian splats; they stand still"""

    bl_idname = "gof.native_splats"
    bl_label = "As Blender's Splats"
    bl_options = {"UNDO"}

    @classmethod
    def poll(cls, context):
        return compat.splat_type() is not None and point_cloud.inputs(context.object) is not None

    def execute(self, context):
        scene, thing = context.scene, context.object
        try:
            recording = Recording.of(scene, thing)
            now = points.at(recording.cloud, recording.time_s(scene.frame_current_final), recording.least)
            copy = native_splats.add(now, f"{thing.name} {scene.frame_current}")
        except (GofError, OSError, RuntimeError, TypeError, MemoryError) as error:
            self.report({"ERROR"}, str(error) or "not enough memory")
            return {"CANCELLED"}
        copy.matrix_world = thing.matrix_world
        self.report({"INFO"}, f"{len(now):,} splats of frame {np.round(scene.frame_current_final, 2):g}")
        return {"FINISHED"}


CLASSES = (GOF_OT_native_splats,)
