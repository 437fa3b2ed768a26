"""Panel "Benchmark": a dataset with exact ground truth, made by Blender processes beside this one."""

import time
from dataclasses import replace
from pathlib import Path

import bpy
from bpy.props import EnumProperty, FloatProperty, StringProperty

from ..core.checked_json import SpecError
from ..core.errors import GofError
from ..core.time_left import duration
from ..pure import cost_model, dataset_process
from ..pure import spec as spec_file
from ..pure.dataset_process import Job, expected_s, left_s
from ..pure.effects import changes_bake, name_of
from ..pure.layout import Layout, warnings_of_bake
from ..pure.plausibility import require_sense
from ..pure.presets import PRESETS
from ..pure.spec import BACKGROUND, BlendFile, SceneSpec
from ..scene import bodies, compat, place
from ..scene.backgrounds import blend_file
from ..scene.view import require_display
from . import scene_spec
from .field_labels import in_benchmark_panel
from .job_operator import JobOperator, blender
from .panel import SidebarPanel, number, show_text, write_lines

PURPOSE = {
    "toy": "Seconds, to see whether it works",
    "preview": "A look at the scene",
    "standard": "Motion worth scoring",
    "large": "Pictures of the whole sensor, few paths for each pixel",
    "full": "A job for a cluster",
}
BACKGROUNDS = ("studio", "workshop", "classroom", "cloister", "ground")


class GOF_PG_benchmark(bpy.types.PropertyGroup):
    """``scene.gof.benchmark``."""

    background: EnumProperty(
        name="Background",
        description="Surroundings of the fire",
        items=[
            ("scene", "This Scene", "Everything in this scene that is visible in renders, as at the current frame"),
            *(
                (name, name.capitalize(), "Built by the add-on; the fire and the cameras are those of the Fire panel")
                for name in BACKGROUNDS
            ),
            ("file", "Spec File", "A scene spec written for the command line: it replaces the Fire panel's settings"),
        ],
    )
    spec_file: StringProperty(
        name="Spec", description="Scene spec (.json)", subtype="FILE_PATH", options=compat.BLEND_PATH
    )
    grids: StringProperty(
        name="Grids",
        description=(
            "Folder of a fire that another solver has made (fire.json, velocity.zarr, emission.zarr). It burns instead "
            "of the Fire panel's and nothing is simulated; empty: the Fire panel's fire"
        ),
        subtype="DIR_PATH",
        options=compat.BLEND_PATH,
    )
    start_s: FloatProperty(
        name="Start (s)",
        description="Time of the first picture on the clock of the grids",
        default=0,
        min=0,
        step=1,
        precision=5,
    )
    radiance: FloatProperty(
        name="Radiance",
        description=(
            "Factor on the light of the grids, which a solver knows up to one. The right one puts the brightest pixels "
            "of the flame near 10 (linear); python -m gof_benchmark.solvers.radiance suggests it"
        ),
        default=1,
        min=1e-6,
        soft_max=100,
        precision=6,
    )
    preset: EnumProperty(
        name="Preset",
        description="How fine and how long, hence how much time it takes",
        items=[(name, name.capitalize(), PURPOSE[name]) for name in PRESETS],
        default="preview",
    )
    folder: StringProperty(
        name="Output",
        description="New folder for the dataset, or one to go on with",
        subtype="DIR_PATH",
        options=compat.BLEND_PATH,
        default="//benchmark",
    )


def spec_of(scene: bpy.types.Scene, background_file: Path) -> SceneSpec:
    """Return the spec that the two panels describe. Raises SpecError that says what to change.

    Args:
        background_file: where the surroundings are, or will be, for a benchmark of this scene.
    """
    if problem := why_not():
        raise SpecError(problem)
    from ..scene import render

    settings = scene.gof.benchmark
    if settings.background == "file":
        if not settings.spec_file:
            raise SpecError("choose a spec file (.json), or another background")
        spec = spec_file.load(bpy.path.abspath(settings.spec_file))
    else:
        spec = scene_spec.of_scene(scene)
        if settings.grids:
            grids, lift = Path(bpy.path.abspath(settings.grids)).resolve(), scene.gof.fire.clearance
            spec = scene_spec.with_grids(spec, grids, settings.start_s, settings.radiance, lift)
        if settings.background == "scene":
            marker = place.find(scene, place.PLACE)
            if marker is None:
                raise SpecError("there is no fire in this scene: press Add Fire, or choose another background")
            background = BlendFile(background_file.as_posix(), marker.name)
            spec = replace(spec, background="blend_file", blend_file=background, display=scene_spec.display_of(scene))
        else:
            spec = replace(spec, background=settings.background)
    spec = spec.with_preset(settings.preset)
    return spec if render.can_denoise() else replace(spec, render=replace(spec.render, denoise=False))


def folder_of(scene: bpy.types.Scene) -> Layout:
    """Return where the dataset goes. Raises SpecError that says what to change."""
    settings = scene.gof.benchmark
    if not settings.folder or (settings.folder.startswith("//") and not bpy.data.filepath):
        raise SpecError("choose an output folder: this file has not been saved, so there is no folder beside it")
    return Layout(Path(bpy.path.abspath(settings.folder)).resolve())


def planned(scene: bpy.types.Scene) -> tuple[SceneSpec, Layout]:
    """Return the spec that the two panels describe, and where its dataset goes. Raises SpecError that says what to
    change."""
    layout = folder_of(scene)
    spec = spec_of(scene, layout.background)
    return (
        spec if scene.gof.benchmark.background == "file" else replace(spec, name=layout.root.name or "fire")
    ), layout


def why_not() -> str | None:
    """Why this Blender cannot make datasets, if it cannot."""
    try:
        from ..scene import images  # noqa: F401
    except ImportError:
        return (
            "This Blender comes without the OpenImageIO module for Python: "
            "use Blender 4.2 or later (Debian: python3-openimageio)"
        )
    return None


class GOF_OT_bake_render(JobOperator, bpy.types.Operator):
    """Simulate the fire, render all cameras and write the dataset. Finished parts are not made again"""

    bl_idname = "gof.bake_render"
    bl_label = "Bake & Render"
    stopped = "Stopped; what is finished stays. Resume goes on there"
    ask = "gof.stop_benchmark"

    @classmethod
    def poll(cls, context):
        return cls.job is None and why_not() is None

    def begin(self, context) -> Job:
        """Return a job whose folder is claimed and which fits this machine."""
        try:
            return self._claimed(context)
        except SpecError as error:
            raise SpecError(in_benchmark_panel(context.scene, str(error))) from error

    def _claimed(self, context) -> Job:
        spec, layout = planned(context.scene)
        notes = require_sense(spec, files=not _brings_its_scene(spec, layout))
        require_display(spec.display)
        layout.require_free(spec)
        if not layout.bake_marker.is_file():
            cost_model.require_room(spec, layout.root)
            brings = _brings_its_scene(spec, layout)
            notes += (
                _in_this_scene(context, spec, again=True) if brings else dataset_process.scene_notes(spec, blender())
            )
        for note in notes:
            self.report({"WARNING"}, in_benchmark_panel(context.scene, note))
        layout.claim(spec)
        if _brings_its_scene(spec, layout) and not layout.bake_marker.is_file():
            _copy_scene(context.scene, layout.background)
        return Job(spec, layout, blender())

    def finish(self, context, job: Job) -> str:
        return f"Dataset finished: {job.layout.root}"


QUESTION = ("Stop the benchmark?", "Finished steps and pictures stay; Resume goes on there.", "Esc goes on with it.")


class GOF_OT_stop_benchmark(bpy.types.Operator):
    """Stop the running benchmark, after a question; what is finished stays"""

    bl_idname = "gof.stop_benchmark"
    bl_label = "Stop"

    @classmethod
    def poll(cls, context):
        return GOF_OT_bake_render.job is not None

    def invoke(self, context, event):
        return context.window_manager.invoke_props_dialog(self, width=350)

    def draw(self, context):
        job = GOF_OT_bake_render.job
        column = self.layout.column(align=True)
        for index, line in enumerate(QUESTION if job else ("It has ended already.",)):
            column.label(text=line, icon="QUESTION" if index == 0 else "BLANK1")

    def execute(self, context):
        GOF_OT_bake_render.stop_job()
        return {"FINISHED"}


class GOF_OT_open_benchmark(bpy.types.Operator):
    """Open what the benchmark has written"""

    bl_idname = "gof.open_benchmark"
    bl_label = "Open"

    what: EnumProperty(
        items=[
            ("report", "Report", "Pictures and costs, in the web browser"),
            ("log", "Log", "Messages of the run, in a text editor"),
            ("folder", "Folder", "The dataset, in the file manager"),
        ]
    )

    def execute(self, context):
        try:
            _, layout = planned(context.scene)
        except (GofError, OSError) as error:
            self.report({"ERROR"}, in_benchmark_panel(context.scene, str(error)))
            return {"CANCELLED"}
        path = {"report": layout.report, "log": layout.job_log, "folder": layout.root}[self.what]
        if not path.exists():
            self.report({"ERROR"}, f"there is no {path} yet: press Bake & Render")
            return {"CANCELLED"}
        if self.what == "log":
            show_text(context, path)
        else:
            bpy.ops.wm.path_open(filepath=str(path))
        return {"FINISHED"}


class GOF_PT_benchmark(SidebarPanel, bpy.types.Panel):
    bl_label = "Benchmark"
    bl_order = 2
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context):
        settings, layout, job = context.scene.gof.benchmark, self.layout, GOF_OT_bake_render.job
        layout.use_property_split, layout.use_property_decorate = True, False
        if problem := why_not():
            write_lines(layout, context, problem, "ERROR")
            return
        column = layout.column()
        column.enabled = job is None
        column.prop(settings, "background")
        if settings.background == "file":
            column.prop(settings, "spec_file")
        else:
            column.prop(settings, "grids")
            if settings.grids:
                number(column, settings, "start_s")
                number(column, settings, "radiance")
        column.prop(settings, "preset")
        column.prop(settings, "folder")
        if job is not None:
            _draw_job(layout, context, job)
        else:
            self._draw_plan(context, layout)
        row = layout.row(align=True)
        for what in ("report", "log", "folder"):
            row.operator(GOF_OT_open_benchmark.bl_idname, text=what.capitalize()).what = what

    def _draw_plan(self, context, layout) -> None:
        try:
            spec = spec_of(context.scene, Path(BACKGROUND).absolute())
            notes = require_sense(spec, files=context.scene.gof.benchmark.background == "file")
        except (GofError, OSError) as error:
            write_lines(layout, context, in_benchmark_panel(context.scene, str(error)), "ERROR")
            return
        try:
            spec, folders = planned(context.scene)
            folders.require_free(spec)
        except (GofError, OSError) as error:
            _draw_cost(layout.box(), context, spec, None)
            write_lines(layout, context, in_benchmark_panel(context.scene, str(error)), "ERROR")
            return
        if folders.description.is_file():
            made = time.strftime("%Y-%m-%d %H:%M", time.localtime(folders.description.stat().st_mtime))
            write_lines(layout, context, f"Finished {made}: see the report", "CHECKMARK")
            return
        _draw_cost(layout.box(), context, spec, folders)
        if _brings_its_scene(spec, folders) and not folders.bake_marker.is_file():
            notes += _in_this_scene(context, spec, again=False)
        for note in (*notes, *_unused(context.scene), *warnings_of_bake(folders)):
            write_lines(layout, context, in_benchmark_panel(context.scene, note), "INFO")
        begun = folders.spec.is_file()
        layout.operator(
            GOF_OT_bake_render.bl_idname, text="Resume" if begun else "Bake & Render", icon="RENDER_ANIMATION"
        )


def _unused(scene: bpy.types.Scene) -> list[str]:
    """Return the settings of the Fire panel that are left out because the fire comes as grids."""
    settings = scene.gof.benchmark
    if settings.background == "file" or not settings.grids:
        return []
    changing = [name_of(effect) for effect in scene_spec.of_settings(scene).effects if changes_bake(effect)]
    return [f"Grids are not simulated: {', '.join(changing)} of the Fire panel left out"] if changing else []


_seen: tuple[tuple, list[str]] = ((), [])  # what the panel has said last of this scene's objects, and of which


def _in_this_scene(context, spec: SceneSpec, again: bool) -> list[str]:
    """Return notes for the user on this scene's objects in the fire's domain.

    A panel, which is drawn all the time, looks ``again`` only where an object has moved or changed its size.
    """
    global _seen
    scene, graph = context.scene, context.view_layer.depsgraph
    objects = {object_ for object_ in scene.objects if not blend_file.stays_out(object_)}
    to_ours = place.to_our_world(place.find(scene, place.PLACE).matrix_world, scene.unit_settings.scale_length)
    these = bodies.signature(spec, graph, objects, to_ours)
    if again or these != _seen[0]:
        _seen = these, bodies.notes(spec, graph, objects, to_ours)
    return list(_seen[1])


def _brings_its_scene(spec: SceneSpec, layout: Layout) -> bool:
    """Return whether the surroundings are this very scene, which is written into the dataset's folder."""
    return bool(spec.blend_file) and layout.background == Path(spec.blend_file.path)


def _draw_cost(box, context, spec: SceneSpec, layout: Layout | None) -> None:
    """Draw the dataset's figures and its expected cost; of one that was begun, what is left."""
    prediction = cost_model.predict_here(spec)
    expected = expected_s(spec, prediction)
    frames, cameras = spec.clip.frames, len(spec.cameras.whole_clip)
    column = box.column(align=True)
    length_s = frames / spec.clip.fps
    done = layout.pictures() if layout else 0
    made = f", {done} made" if done else ""
    along_rows, rows = spec.picture_px
    width, height = (rows, along_rows) if spec.cameras.portrait else (along_rows, rows)
    cell_mm = 1000 * max(spec.box.size) / spec.box.resolution
    write_lines(
        column,
        context,
        f"{len(spec.pictures)} pictures ({frames} x {cameras}){made}, of {width} x {height} pixels; {frames} frames "
        f"at {spec.clip.fps:g} per s are {length_s:.3g} s; {spec.box.resolution} cells of {cell_mm:.3g} mm",
        "CAMERA_DATA",
    )
    seconds = sum(left_s(spec, layout, expected).values()) if layout else sum(expected.values())
    begun = layout is not None and layout.bake_marker.is_file()
    column.label(text=f"About {duration(seconds)}{' left' if begun else ''}", icon="TIME")
    column.label(text=f"{prediction.memory_mb / 1000:.1f} GB of memory", icon="MEMORY")
    column.label(text=f"{prediction.disk_mb / 1000:.2f} GB of disk", icon="DISK_DRIVE")
    source = f"within {100 * prediction.error:.0f} %" if prediction.error < 1 else "roughly"
    write_lines(column, context, f"Predicted {source}, measured on {prediction.measured_on}")


def _draw_job(layout, context, job: Job) -> None:
    box = layout.box()
    if compat.has_function("UILayout", "progress"):  # since Blender 4.0
        box.progress(factor=job.fraction, text=f"{100 * job.fraction:.0f} %")
    else:
        filled = round(20 * job.fraction)
        box.label(text=f"{'|' * filled}{'.' * (20 - filled)}  {100 * job.fraction:.0f} %")
    write_lines(box, context, str(job), "TIME")
    box.operator(GOF_OT_stop_benchmark.bl_idname, text="Stop", icon="CANCEL")


def _copy_scene(scene: bpy.types.Scene, path: Path) -> None:
    """Write the current scene, with unsaved changes, to a separate file."""
    bpy.data.libraries.write(str(path), {scene}, path_remap="ABSOLUTE", fake_user=True)


Settings = GOF_PG_benchmark
CLASSES = (GOF_OT_bake_render, GOF_OT_stop_benchmark, GOF_OT_open_benchmark, GOF_PT_benchmark)


def unregister() -> None:
    """End the job: it does not outlive the add-on."""
    GOF_OT_bake_render.stop_job()
