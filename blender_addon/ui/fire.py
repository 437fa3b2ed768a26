"""Panel "Fire": a burning fire and its camera rig as ordinary Blender data."""

import bpy
from bpy.props import EnumProperty, FloatProperty, FloatVectorProperty, IntProperty, IntVectorProperty, PointerProperty

from ..core.checked_json import SpecError
from ..core.errors import GofError
from ..pure import cost_model
from ..pure.fires import LEAST_LOGS, MOST_LOGS
from ..pure.fuels import FUELS
from ..scene import baked, place
from . import effect_groups, scene_spec
from .field_labels import in_fire_panel
from .panel import SidebarPanel, number, vector, write_lines


class GOF_PG_cameras(bpy.types.PropertyGroup):
    """``scene.gof.fire.cameras``: the rig, relative to the place of the fire."""

    count: IntProperty(
        name="Cameras",
        description="Cameras that methods may train on, evenly spaced on an arc",
        default=3,
        min=1,
        soft_max=16,
    )
    eval_count: IntProperty(
        name="Evaluation",
        description="More cameras, for evaluation: no method may train on them",
        default=0,
        min=0,
        soft_max=8,
    )
    around_frames: IntProperty(
        name="All Around",
        description="Frames that nine more cameras see from every side and from above, to score unfilmed views",
        default=0,
        min=0,
        soft_max=8,
    )
    arc_deg: FloatProperty(
        name="Arc (°)",
        description="Angle between the first and the last camera",
        default=70,
        min=0,
        max=359,
        precision=3,
    )
    azimuth_deg: FloatProperty(
        name="Facing (°)",
        description="Angle from +X to the middle of the arc, counter-clockwise",
        default=-90,
        precision=3,
    )
    radius: FloatProperty(
        name="Distance (m)",
        description="Distance of the cameras from the fire",
        default=2.8,
        min=0.05,
        soft_max=20,
        precision=3,
    )
    height: FloatProperty(
        name="Height (m)", description="Height of the cameras above the place of the fire", default=0.9, precision=3
    )
    look_at_height: FloatProperty(
        name="Aim (m)", description="Height of the point that the cameras look at", default=0.75, precision=3
    )
    focal_mm: FloatProperty(
        name="Focal (mm)",
        description="Focal length, for a sensor whose long side is 36 mm",
        default=50,
        min=1,
        soft_max=200,
        precision=3,
    )
    sensor_px: IntVectorProperty(
        name="Sensor (px)",
        description="Pixels along a row, and number of rows",
        size=2,
        default=(1280, 720),
        min=16,
        subtype="XYZ",
    )
    roll_deg: EnumProperty(
        name="Roll",
        description="How the camera body is turned about its viewing direction; the rows of the sensor turn with it",
        items=[
            ("90", "90° Portrait", "Clockwise seen from behind"),
            ("-90", "-90° Portrait", "Counter-clockwise seen from behind"),
            ("0", "0° Landscape", "Upright"),
            ("180", "180° Landscape", "Upside down"),
        ],
    )
    fps: FloatProperty(
        name="Rate (fps)",
        description="Pictures per second of the benchmark; the scene keeps its own frame rate",
        default=100,
        min=1,
        max=32767,
        precision=3,
    )


class GOF_PG_fire(bpy.types.PropertyGroup):
    """``scene.gof.fire``."""

    fuel: EnumProperty(
        name="Fuel",
        description="How the fire burns, and its color",
        default="propane_high",
        items=[(name, name.replace("_", " ").capitalize(), "") for name in FUELS],
    )
    shape: EnumProperty(
        name="Burner",
        description="Where the fuel comes from",
        items=[
            ("disc", "Disc", "A flat round burner"),
            ("sphere", "Sphere", "A ball"),
            ("logs", "Logs", "Crossed logs"),
        ],
    )
    logs: IntProperty(
        name="Logs", description="How many logs, leaning on each other", default=3, min=LEAST_LOGS, max=MOST_LOGS
    )
    radius: FloatProperty(
        name="Radius (m)", description="Radius of the burner", default=0.13, min=0.001, soft_max=2, precision=4
    )
    intensity: FloatProperty(
        name="Intensity",
        description="Factor on the flame's light",
        default=1,
        min=1e-4,
        max=1e4,
        soft_max=10,
        precision=4,
    )
    light: EnumProperty(
        name="Light",
        description="How the flame's light follows from the simulation",
        default="sheets",
        items=[
            ("soot", "Soot", "All that burns glows and absorbs by its soot: a soft glow"),
            ("sheets", "Soot in Sheets", "Soot in thin sheets: folds and sharp edges, as real flames have"),
            (
                "reaction",
                "Reaction",
                "All gas shines equally and absorbs nothing, as in version 1 of the spec",
            ),
        ],
    )
    speeds: EnumProperty(
        name="Speeds",
        description="Speed of the gas",
        items=[
            ("physical", "Physical", "Lift and burning follow the fire's size, as in real fires"),
            ("solver", "Solver", "The solver's own constants: much too fast for fires below a metre"),
        ],
    )
    clearance: FloatProperty(
        name="Lift (m)",
        description="Height of the burner above the place of the fire",
        default=0.03,
        min=0,
        precision=4,
    )
    domain_size: FloatVectorProperty(
        name="Domain (m)",
        description="Box of air around the fire",
        default=(0.8, 0.8, 1.6),
        min=0.01,
        precision=3,
        subtype="XYZ",
    )
    resolution: IntProperty(
        name="Cells",
        description="Cells of the simulation in this scene, along the domain's longest side. "
        "A benchmark takes those of its preset",
        default=48,
        min=8,
        max=2048,
    )
    seed: IntProperty(name="Seed", description="Another seed is another flame of the same kind", min=0)
    spot: EnumProperty(
        name="Place",
        description="Where the fire is put",
        items=[
            ("CURSOR", "At the Cursor", "At the 3D cursor"),
            ("OBJECT", "On the Object", "On top of the active object"),
        ],
    )
    effects: PointerProperty(type=effect_groups.GOF_PG_effects)
    cameras: PointerProperty(type=GOF_PG_cameras)


class _SpecOperator:
    """An operator that builds from the panel's settings, and reports what is wrong with them."""

    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context):
        return context.mode == "OBJECT"

    def execute(self, context):
        try:
            self.build(context, scene_spec.of_settings(context.scene))
        except GofError as error:
            self.report({"ERROR"}, in_fire_panel(context.scene, str(error)))
            return {"CANCELLED"}
        return {"FINISHED"}


class GOF_OT_add_fire(_SpecOperator, bpy.types.Operator):
    """Put a fire into the scene: an empty, its burner and its domain. One that is there is replaced, with its edits"""

    bl_idname = "gof.add_fire"
    bl_label = "Add Fire"

    def build(self, context, spec):
        scene = context.scene
        spot = scene.cursor.location.copy()
        if scene.gof.fire.spot == "OBJECT":
            object_, marker = context.active_object, place.find(scene, place.PLACE)
            if object_ is None or (place.part_of(object_) and marker is None):
                raise SpecError("there is no active object to burn: click one, or choose At the Cursor")
            spot = marker.location.copy() if place.part_of(object_) else place.on_top_of(object_)  # itself: it stays
        cost_model.require_memory(spec)  # Blender itself ends where a simulation does not fit
        place.add_fire(spec, scene, place.mark(scene, spot))
        self.report({"INFO"}, "Play the animation to see it burn, or make a benchmark of it")


class GOF_OT_add_cameras(_SpecOperator, bpy.types.Operator):
    """Put the camera rig around the fire and set the render size; a rig that is there is replaced"""

    bl_idname = "gof.add_cameras"
    bl_label = "Add Cameras"

    def build(self, context, spec):
        scene = context.scene
        marker = place.find(scene, place.PLACE) or place.mark(scene, scene.cursor.location)
        cameras = place.add_cameras(spec, scene, marker)
        size = f"{scene.render.resolution_x} x {scene.render.resolution_y}"
        self.report({"INFO"}, f"{len(cameras)} cameras; pictures are {size} pixels")


class GOF_OT_next_view(bpy.types.Operator):
    """Look through the rig's next camera"""

    bl_idname = "gof.next_view"
    bl_label = "Next View"

    @classmethod
    def poll(cls, context):
        return bool(place.cameras(context.scene))

    def execute(self, context):
        scene, cameras = context.scene, place.cameras(context.scene)
        after = cameras.index(scene.camera) + 1 if scene.camera in cameras else 0
        view = getattr(context.space_data, "region_3d", None)
        looked_through = view is None or view.view_perspective == "CAMERA"
        if looked_through or scene.camera not in cameras:
            scene.camera = cameras[after % len(cameras)]
        if view is not None:
            view.view_perspective = "CAMERA"
        return {"FINISHED"}


class GOF_PT_fire(SidebarPanel, bpy.types.Panel):
    bl_label = "Fire"
    bl_order = 1

    def draw(self, context):
        fire, layout = context.scene.gof.fire, self.layout
        for line in baked.missing(context.scene):
            write_lines(layout, context, line, "ERROR")
        layout.use_property_split, layout.use_property_decorate = True, False
        column = layout.column(align=True)
        for name in ("fuel", "light", "speeds", "shape"):
            column.prop(fire, name)
        if fire.shape == "logs":
            number(column, fire, "logs")
        for name in ("intensity", "radius", "clearance"):
            number(column, fire, name)
        vector(layout.column(align=True), fire, "domain_size")
        column = layout.column(align=True)
        for name in ("resolution", "seed"):
            number(column, fire, name)
        layout.prop(fire, "spot")
        domain = place.find(context.scene, place.DOMAIN)
        layout.operator(GOF_OT_add_fire.bl_idname, text="Replace Fire" if domain else "Add Fire", icon="MOD_FLUIDSIM")


class GOF_PT_effects(SidebarPanel, bpy.types.Panel):
    bl_label = "Effects"
    bl_parent_id = "GOF_PT_fire"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        effect_groups.draw(self.layout, context.scene.gof.fire.effects)


class GOF_PT_cameras(SidebarPanel, bpy.types.Panel):
    bl_label = "Cameras"
    bl_parent_id = "GOF_PT_fire"

    def draw(self, context):
        cameras, layout = context.scene.gof.fire.cameras, self.layout
        layout.use_property_split, layout.use_property_decorate = True, False
        for names in (
            ("count", "eval_count", "around_frames"),
            ("arc_deg", "azimuth_deg", "radius", "height", "look_at_height"),
            ("focal_mm", "fps"),
        ):
            column = layout.column(align=True)
            for name in names:
                number(column, cameras, name)
        column = layout.column(align=True)
        vector(column, cameras, "sensor_px")
        column.prop(cameras, "roll_deg")
        column = layout.column(align=True)
        has_cameras = bool(place.cameras(context.scene))
        column.operator(
            GOF_OT_add_cameras.bl_idname, text="Replace Cameras" if has_cameras else "Add Cameras", icon="CAMERA_DATA"
        )
        column.operator(GOF_OT_next_view.bl_idname, icon="HIDE_OFF")
        row = layout.row(align=True)
        row.operator("gof.import_cameras", text="Import...", icon="IMPORT")
        row.operator("gof.export_cameras", text="Export...", icon="EXPORT")


def register() -> None:
    baked.watch()


def unregister() -> None:
    baked.unwatch()


GROUPS = (*effect_groups.GROUPS.values(), effect_groups.GOF_PG_effects, GOF_PG_cameras)
Settings = GOF_PG_fire
CLASSES = (GOF_OT_add_fire, GOF_OT_add_cameras, GOF_OT_next_view, GOF_PT_fire, GOF_PT_effects, GOF_PT_cameras)
