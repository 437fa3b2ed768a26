"""Panel "Reconstruction": import a result as an animated cloud, and change how it looks and plays."""

import time
from pathlib import Path

import bpy
from bpy_extras.io_utils import ImportHelper

from ..core.errors import DataFormatError, GofError
from ..pure.io import cloud as clouds
from ..scene import captured, clip_in_scene, compat, gaussian_nodes, place, point_cloud, result_file, see_through
from .panel import SidebarPanel, number, write_lines

MANY = 2_000_000  # Gaussians; above this an import needs confirmation
SECONDS_EACH, BYTES_EACH, FRAME_SECONDS_EACH = 4e-6, 250, 0.1e-6  # measured: benchmark/evidence/addon_speed.py

MODES = [
    ("points", "Points", "Round points: quick"),
    ("ellipsoids", "Ellipsoids", "The Gaussians' true shapes"),
    ("arrows", "Arrows", "Velocity of the gas"),
    ("streaks", "Streaks", "The way just travelled, as sparks leave it"),
    ("splats", "Splats", "Gaussian splats of Blender's own"),
][: len(gaussian_nodes.MODES)]
COLORS = [
    ("image", "Image Color", "As in the footage"),
    ("speed", "Speed", "Speed of the gas, m/s"),
    ("age", "Age", "Seconds since its brightest moment"),
    ("lifetime", "Lifetime", "Standard deviation of its fading, s"),
    ("error", "Velocity Error", "m/s against the true velocity; score first (panel Score, Show Errors)"),
    ("uncertainty", "Velocity Uncertainty", "m/s, standard deviation of a component, where the file states it"),
]
VECTORS = [
    ("velocity", "Velocity", "Velocity of the gas, as reconstructed"),
    ("true velocity", "True Velocity", "At the Gaussian's centre"),
    ("error", "Error", "Reconstructed minus true"),
]


UNITS = {"Line Time": "Line Time (s)"}
COLORLESS = ("SOLID", "WIREFRAME")
GREY = "Solid view shows no colors"


def _enum(socket: str, choices: tuple[str, ...], items: list, **annotations):
    """Return an enum that shows and sets one input of the active cloud."""

    def read(self) -> int:
        cloud = point_cloud.inputs(bpy.context.object)
        return int(cloud[socket]) if cloud else 0

    def write(self, number: int) -> None:
        object_ = bpy.context.object
        cloud = point_cloud.inputs(object_)
        if cloud is None:
            _say("Select a reconstruction first")
        elif socket == "Mode":
            point_cloud.show_as(object_, choices[number])
        elif socket != "Color By":
            cloud[socket] = number
        elif problem := point_cloud.why_not_color(object_.data, choices[number]):
            _say(f"{items[number][1]}: {problem}")
        else:
            try:
                point_cloud.color_by(object_, choices[number])
            except point_cloud.CloudError as error:
                _say(f"{items[number][1]}: {error}")

    return bpy.props.EnumProperty(items=items, get=read, set=write, **annotations)


def _say(text: str) -> None:
    """Print a message where no operator can report it; users of scripts read the console."""
    if bpy.app.background:
        print(text)
    else:
        bpy.context.window_manager.popup_menu(lambda menu, _: menu.layout.label(text=text), icon="ERROR")


class GOF_PG_reconstruction(bpy.types.PropertyGroup):
    """``scene.gof.reconstruction``: settings of the active cloud that have names instead of numbers."""

    mode: _enum("Mode", gaussian_nodes.MODES, MODES, name="Show As")
    color: _enum("Color By", gaussian_nodes.COLORS, COLORS, name="Color By")
    vectors: _enum("Arrows Show", gaussian_nodes.VECTORS, VECTORS, name="Arrows")


class GOF_OT_import_result(bpy.types.Operator, ImportHelper):
    """Add a reconstruction to the scene: result.npz or result.ply, an FTGS-PLY, a 3DGS PLY, or numbered PLYs"""

    bl_idname = "gof.import_result"
    bl_label = "Import Reconstruction"
    bl_options = {"UNDO"}

    filter_glob: bpy.props.StringProperty(default="*.npz;*.ply", options={"HIDDEN"})
    directory: bpy.props.StringProperty(subtype="DIR_PATH", options={"HIDDEN", "SKIP_SAVE"})
    files: bpy.props.CollectionProperty(type=bpy.types.OperatorFileListElement, options={"HIDDEN", "SKIP_SAVE"})
    mode: bpy.props.EnumProperty(name="Show As", items=MODES, default=gaussian_nodes.QUICK)
    spot: bpy.props.EnumProperty(
        name="Place",
        description="Where the flame stands",
        items=[
            ("FILMED", "Where It Was Filmed", "As its cameras see it: places count from the scene's origin"),
            ("CURSOR", "At the Cursor", "Its foot at the 3D cursor"),
            ("OBJECT", "On the Object", "Its foot on top of the active object"),
        ],
    )
    start_frame: bpy.props.FloatProperty(
        name="Start Frame", default=1.0, precision=3, description="Scene frame that is time 0 of the reconstruction"
    )
    fit: bpy.props.EnumProperty(
        name="Scene",
        description="Change of the scene's frame range and rate",
        items=[
            ("new", "Fit If New", "Fit them to the clip if they are still those of Blender's new file"),
            ("fit", "Fit to Clip", "Fit them to the clip"),
            ("keep", "Keep", "Do not change them"),
        ],
    )
    step: bpy.props.IntProperty(name="Every n-th", default=1, min=1, description="Import every n-th Gaussian only")
    everything: bpy.props.BoolProperty(
        name="No Limit", description="Import more than two million Gaussians at once", options={"SKIP_SAVE"}
    )
    fps: bpy.props.FloatProperty(
        name="Files (per s)",
        default=0.0,
        min=0.0,
        precision=3,
        description="Numbers per second of a PLY sequence; 0 = one per frame of the scene",
    )
    clip_seconds: bpy.props.FloatProperty(
        name="Clip (s)",
        default=0.0,
        min=0.0,
        precision=5,
        description="FTGS-PLY: seconds from the first to the last frame; 0 = by its number of frames",
    )

    def invoke(self, context, event):
        if self.filepath or self.files:  # dropped on the window
            return context.window_manager.invoke_props_dialog(self)
        return super().invoke(context, event)

    def draw(self, context):
        layout = self.layout
        layout.use_property_split = True
        for name in ("mode", "spot", "fit"):
            layout.prop(self, name)
        for name in ("start_frame", "step"):
            number(layout, self, name)
        layout.prop(self, "everything")
        layout.label(text="Files of other methods")
        for name in ("fps", "clip_seconds"):
            number(layout, self, name)

    def execute(self, context):
        started, spot = time.perf_counter(), None
        if self.spot != "FILMED":
            under = context.active_object
            if self.spot == "OBJECT" and under is None:
                self.report({"ERROR"}, "there is no active object to stand on: click one, or choose At the Cursor")
                return {"CANCELLED"}
            spot = place.on_top_of(under) if self.spot == "OBJECT" else context.scene.cursor.location.copy()
        render = context.scene.render
        clock = clouds.CloudTiming(self.fps or render.fps / render.fps_base, self.clip_seconds or None)
        try:
            source = self._source()
            number = clouds.count(source) // self.step
            if number > MANY and not self.everything:
                raise DataFormatError(
                    f"{number:,} Gaussians: about {number * SECONDS_EACH:.0f} s to import, "
                    f"{number * BYTES_EACH / 1e9:.1f} GB of memory and {number * FRAME_SECONDS_EACH:.1f} s per frame. "
                    f"Set Every n-th to {-(-number * self.step // MANY)} or more, or tick No Limit"
                )
            cloud = clouds.load(source, clock, self.step)
        except (GofError, OSError, MemoryError) as error:
            self.report({"ERROR"}, str(error) or "not enough memory; set Every n-th")
            return {"CANCELLED"}
        object_ = point_cloud.add_point_cloud(
            cloud, self.start_frame, self.mode, source[0].stem if len(source) == 1 else source[0].parent.name
        )
        if spot is not None:
            point_cloud.stand_on(object_, cloud, spot)
        result_file.keep(object_, source)
        object_["gof_time_unit"] = self.clip_seconds if len(source) == 1 else 1 / clock.fps  # for `gof evaluate`
        clip_in_scene.keep(object_, cloud)
        if self.fit == "fit" or (self.fit == "new" and clip_in_scene.is_new(context.scene)):
            clip_in_scene.fit(context.scene, object_)
        for other in context.selected_objects:
            other.select_set(False)
        object_.select_set(True)
        context.view_layer.objects.active = object_
        message = f"{object_.name}: {len(cloud):,} Gaussians in {time.perf_counter() - started:.1f} s"
        if clip := clip_in_scene.line(context.scene, object_):
            message += f". {clip}"
        if cloud.datum:  # Blender knows seven digits: the datum's place is the origin here
            message += ". The origin is x {:.10g}, y {:.10g}, z {:.10g} m of its world, and time 0 is {:.10g} s".format(
                *cloud.datum.numbers()
            )
        if _shows_no_colors(context):
            message += f". {GREY}: press Show Colors in the panel"
        self.report({"INFO"}, message)
        return {"FINISHED"}

    def _source(self) -> list[Path]:
        chosen = [Path(self.directory) / file.name for file in self.files if file.name]
        if not chosen:
            chosen = [Path(bpy.path.abspath(self.filepath or self.directory))]
        return clouds.files_of(chosen)


class GOF_OT_fit_scene(bpy.types.Operator):
    """Set the scene's frame range to the clip, and its rate to one at which the clip is no flicker"""

    bl_idname = "gof.fit_scene"
    bl_label = "Fit Scene to Clip"
    bl_options = {"UNDO"}

    @classmethod
    def poll(cls, context):
        return point_cloud.inputs(context.object) is not None and clip_in_scene.CLIP in context.object

    def execute(self, context):
        clip_in_scene.fit(context.scene, context.object)
        self.report({"INFO"}, clip_in_scene.line(context.scene, context.object))
        return {"FINISHED"}


class GOF_OT_show_colors(bpy.types.Operator):
    """Show materials in this view: Solid and Wireframe show no colors of Gaussians"""

    bl_idname = "gof.show_colors"
    bl_label = "Show Colors"

    @classmethod
    def poll(cls, context):
        return context.space_data is not None and context.space_data.type == "VIEW_3D"

    def execute(self, context):
        context.space_data.shading.type = "MATERIAL"
        return {"FINISHED"}


class GOF_OT_fit_colors(bpy.types.Operator):
    """Set the color map's range to that of the values, without the largest two percent"""

    bl_idname = "gof.fit_colors"
    bl_label = "Fit Range"
    bl_options = {"UNDO"}

    @classmethod
    def poll(cls, context):
        cloud = point_cloud.inputs(context.object)
        return cloud is not None and cloud["Color By"] > 0

    def execute(self, context):
        try:
            point_cloud.color_by(context.object, context.scene.gof.reconstruction.color)
        except point_cloud.CloudError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


class GOF_PT_reconstruction(SidebarPanel, bpy.types.Panel):
    bl_label = "Reconstruction"
    bl_order = 3

    def draw(self, context):
        layout, settings = self.layout, context.scene.gof.reconstruction
        layout.operator("gof.import_result", icon="IMPORT", text="Import Reconstruction...")
        cloud = point_cloud.inputs(context.object)
        if cloud is None:
            write_lines(layout, context, "Select a reconstruction to change it", "INFO")
            return
        layout.use_property_split = True
        layout.use_property_decorate = False

        def show(column, *names):
            for name in names:
                number(column, *cloud.place(name), UNITS.get(name, name))

        column = layout.column(align=True)
        column.label(text=f"{len(context.object.data.vertices):,} Gaussians", icon="POINTCLOUD_DATA")
        if clip := clip_in_scene.line(context.scene, context.object):
            write_lines(column, context, clip)
            column.operator("gof.fit_scene")
        self._warn(context, layout, settings.mode)
        if words := captured.guess(context.scene, context.space_data.region_3d.view_rotation @ captured.AHEAD):
            write_lines(layout, context, words, "INFO")
        column = layout.column(align=True)
        column.prop(settings, "mode")
        if settings.mode in ("arrows", "streaks"):
            show(column, "Line Time")
        if settings.mode == "arrows" and "gs_true_velocity" in context.object.data.attributes:
            column.prop(settings, "vectors")
        show(column, "Opacity Cut", "Share")
        column = layout.column(align=True)
        column.prop(settings, "color")
        if settings.color != "image":
            unit = "s" if settings.color in ("age", "lifetime") else "m/s"
            for name in ("Color Min", "Color Max"):
                number(column, *cloud.place(name), f"{name} ({unit})")
            column.operator("gof.fit_colors")
        column = layout.column(align=True)
        show(column, "Start Frame", "Time Scale")
        column = layout.column(align=True)
        show(column, "Emission", "Light on Scene")
        column = layout.column(align=True)
        column.operator("gof.export_vdb", icon="EXPORT", text="Export OpenVDB...")
        column.operator("gof.export_points", icon="EXPORT", text="Export Points...")

    @staticmethod
    def _warn(context, layout, mode: str) -> None:
        """Why the view shows less than there is, with the way out."""
        shading = context.space_data.shading.type
        if shading in COLORLESS:
            write_lines(layout, context, GREY, "INFO")
            layout.operator("gof.show_colors", icon="SHADING_TEXTURE")
        elif mode == "points" and shading == "MATERIAL" and not compat.EEVEE_DRAWS_POINTS:
            write_lines(layout, context, "Material Preview of this Blender draws no points: show Ellipsoids", "ERROR")


def _shows_no_colors(context) -> bool:
    """Return whether all 3D views of the screen are of a kind that shows no materials."""
    areas = [area for area in (context.screen.areas if context.screen else ()) if area.type == "VIEW_3D"]
    return bool(areas) and all(area.spaces.active.shading.type in COLORLESS for area in areas)


def _menu(menu, context):
    menu.layout.operator("gof.import_result", text="Gaussians on Fire (.npz, .ply)")


def register() -> None:
    see_through.watch()
    bpy.types.TOPBAR_MT_file_import.append(_menu)


def unregister() -> None:
    see_through.unwatch()
    bpy.types.TOPBAR_MT_file_import.remove(_menu)


Settings = GOF_PG_reconstruction
CLASSES = (GOF_OT_import_result, GOF_OT_fit_scene, GOF_OT_show_colors, GOF_OT_fit_colors, GOF_PT_reconstruction)
if compat.HAS_DROP:

    class GOF_FH_result(bpy.types.FileHandler):
        bl_idname = "GOF_FH_result"
        bl_label = "Gaussians on Fire"
        bl_import_operator = "gof.import_result"
        bl_file_extensions = ".npz;.ply"

        @classmethod
        def poll_drop(cls, context):
            return context.area is not None and context.area.type in {"VIEW_3D", "OUTLINER"}

    CLASSES = (*CLASSES, GOF_FH_result)
