"""The camera rig to other programs and back: transforms.json, COLMAP's text model, USD, Alembic, dataset.json."""

from dataclasses import replace
from pathlib import Path

import bpy
from bpy_extras.io_utils import ExportHelper, ImportHelper

from ..core.checked_json import SpecError
from ..core.description import CameraEntry
from ..core.errors import DataFormatError, GofError
from ..pure.io import camera_files
from ..scene import camera_exchange, exchange, place
from . import scene_spec

FAILURES = (GofError, OSError, RuntimeError)
FROM_FIRE = "Places count from the fire's empty, as in a dataset of this scene; otherwise from the scene's origin"


class GOF_OT_export_cameras(bpy.types.Operator, ExportHelper):
    """Write the rig as it stands, without one all cameras: transforms.json, COLMAP's images.txt, USD or Alembic"""

    bl_idname = "gof.export_cameras"
    bl_label = "Export Cameras"

    filename_ext = ".json"
    check_extension = None  # the name says which of the formats
    filter_glob: bpy.props.StringProperty(default="*.json;*.txt;*.usd;*.usdc;*.usda;*.abc", options={"HIDDEN"})
    from_fire: bpy.props.BoolProperty(name="Relative to Fire", description=f"{FROM_FIRE}. Not for USD and Alembic")

    def execute(self, context):
        path, scene = Path(bpy.path.abspath(self.filepath)), context.scene
        cameras = camera_exchange.chosen(scene)
        try:
            if not cameras:
                raise SpecError("this scene has no cameras: press Add Cameras")
            if path.suffix.lower() in exchange.ALEMBIC + exchange.USD:
                exchange.write(cameras, path, scene.frame_current, scene.frame_current)
            elif path.suffix.lower() == ".json" or path.name in camera_files.COLMAP:
                to_file = camera_exchange.world_of_files(scene, self.from_fire)
                camera_files.write(path, camera_exchange.describe_all(cameras, scene, to_file))
            else:
                raise SpecError(
                    f"{path.name}: the name must be images.txt, or end in .json, .usd, .usdc, .usda or .abc"
                )
        except FAILURES as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, f"{len(cameras)} cameras: {path}")
        return {"FINISHED"}


class GOF_OT_import_cameras(bpy.types.Operator, ImportHelper):
    """Add cameras of transforms.json, COLMAP's images, dataset.json, USD or Alembic; with a fire, as its rig"""

    bl_idname = "gof.import_cameras"
    bl_label = "Import Cameras"
    bl_options = {"UNDO"}

    filter_glob: bpy.props.StringProperty(default="*.json;*.txt;*.bin;*.usd;*.usdc;*.usda;*.abc", options={"HIDDEN"})
    from_fire: bpy.props.BoolProperty(name="Relative to Fire", description=FROM_FIRE)
    rig: bpy.props.BoolProperty(
        name="As the Rig",
        default=True,
        description="Replace the fire's cameras, where there is a fire; otherwise add the cameras unchanged",
    )

    def execute(self, context):
        path, scene = Path(bpy.path.abspath(self.filepath)), context.scene
        try:
            to_file = camera_exchange.world_of_files(scene, self.from_fire)
            entries = self._read(path, scene, to_file)
            if self.rig and place.find(scene, place.PLACE) is not None:
                added = self._as_rig(scene, entries, to_file)
            else:
                added = camera_exchange.add(entries, path.parent, scene, to_file.inverted())
        except FAILURES as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, f"{len(added)} cameras of {path.name}")
        return {"FINISHED"}

    @staticmethod
    def _read(path: Path, scene, to_file) -> tuple[CameraEntry, ...]:
        if path.suffix.lower() not in exchange.ALEMBIC + exchange.USD:
            return camera_files.read(path)
        with exchange.read(path) as objects:
            cameras = [object_ for object_ in objects if object_.type == "CAMERA"]
            if not cameras:
                raise DataFormatError(f"{path}: holds no cameras")
            return camera_exchange.describe_all(cameras, scene, to_file)

    @staticmethod
    def _as_rig(scene, entries: tuple[CameraEntry, ...], to_file) -> list[bpy.types.Object]:
        spec = scene_spec.of_settings(scene)
        to_place = camera_exchange.world_of_files(scene, True) @ to_file.inverted()
        rig = camera_exchange.as_rig(spec.cameras, entries, to_place)
        panel = scene.gof.fire.cameras
        panel.count, panel.eval_count = rig.count, rig.eval_count
        panel.focal_mm, panel.sensor_px, panel.roll_deg = rig.focal_mm, rig.sensor_px, str(rig.roll_deg)
        return camera_exchange.place_rig(replace(spec, cameras=rig), scene)


CLASSES = (GOF_OT_export_cameras, GOF_OT_import_cameras)
