"""Panel "Score": a reconstruction against a dataset's true velocity, as numbers and as views beside the cloud."""

from pathlib import Path

import bpy

from ..core.errors import GofError
from ..pure import dve
from ..pure.score_process import Evaluation
from ..scene import compat, error_cloud, point_cloud, result_file
from . import preferences
from .job_operator import JobOperator, blender
from .panel import SidebarPanel, write_lines

MOST_BESIDE = 7  # characters that have room beside a name at the sidebar's first width


class GOF_PG_score(bpy.types.PropertyGroup):
    """``scene.gof.score``."""

    dataset: bpy.props.StringProperty(
        name="Dataset",
        subtype="DIR_PATH",
        description="Folder of the dataset with the true velocity",
        options=compat.BLEND_PATH,
    )
    result: bpy.props.StringProperty(
        name="Result",
        subtype="FILE_PATH",
        options=compat.BLEND_PATH,
        description="The file that the reconstruction was imported from, where the add-on does not find it: a .blend "
        "keeps its name and not its folder",
    )
    python: bpy.props.StringProperty(
        name="Python",
        subtype="FILE_PATH",
        options=compat.BLEND_PATH,
        description="Python that gof is installed in, such as .venv/bin/python; the preferences keep one for all "
        "files. Without one the add-on scores by itself, with the same numbers",
    )
    numbers: bpy.props.StringProperty(description="The last scores, one 'name: value' per line")
    centres: bpy.props.StringProperty(description="The last velocity error at the Gaussians' centres")


def _cloud(context) -> bpy.types.Object | None:
    """Return the cloud in question: the active object, or the cloud that it is a view of."""
    object_ = context.object
    if object_ is not None and error_cloud.VIEW_OF in object_:
        object_ = error_cloud.seen_by(object_)
    return object_ if point_cloud.inputs(object_) else None


class _ScoreOperator:
    @classmethod
    def poll(cls, context):
        return _cloud(context) is not None and bool(context.scene.gof.score.dataset)


class GOF_OT_score(_ScoreOperator, JobOperator, bpy.types.Operator):
    """Compute DVE of the selected reconstruction: by `gof evaluate` where Python is set, otherwise by the add-on"""

    bl_idname = "gof.score"
    bl_label = "Compute Score"

    @classmethod
    def poll(cls, context):
        return cls.job is None and super().poll(context)

    def begin(self, context) -> Evaluation:
        settings, object_ = context.scene.gof.score, _cloud(context)
        python = settings.python or preferences.python()
        result, dataset = result_file.find(object_, settings.result), Path(bpy.path.abspath(settings.dataset))
        unit_s = object_.get("gof_time_unit", 0.0)
        if python:
            return Evaluation.by_gof(Path(bpy.path.abspath(python)), result, dataset, unit_s)
        return Evaluation.by_addon(blender(), result, dataset, unit_s)

    def finish(self, context, job: Evaluation) -> str:
        rows = [*job.scores.rows(), ("Computed by", job.by)]
        context.scene.gof.score.numbers = "\n".join(f"{name}: {value}" for name, value in rows)
        return ", ".join(f"{name} {value}" for name, value in rows)


class GOF_OT_show_errors(_ScoreOperator, bpy.types.Operator):
    """Place views beside the reconstruction: colored by velocity error; true velocity and error as arrows"""

    bl_idname = "gof.show_errors"
    bl_label = "Show Errors"
    bl_options = {"UNDO"}

    def execute(self, context):
        settings, object_ = context.scene.gof.score, _cloud(context)
        try:
            truth = dve.true_velocity(Path(bpy.path.abspath(settings.dataset)), point_cloud.datum_of(object_))
            found = error_cloud.add_truth(object_, truth)
            error_cloud.show(object_)
        except (GofError, OSError, point_cloud.CloudError, MemoryError) as error:
            self.report({"ERROR"}, str(error) or "not enough memory for the true velocity")
            return {"CANCELLED"}
        settings.centres = (
            f"At the centres of {found.compared:,} Gaussians at their brightest time: median error "
            f"{found.median:.2f} m/s, {100 * found.relative:.0f} % of the true speed (root mean square)"
        )
        self.report({"INFO"}, settings.centres)
        return {"FINISHED"}


class GOF_PT_score(SidebarPanel, bpy.types.Panel):
    bl_label = "Score"
    bl_order = 4

    def draw(self, context):
        layout, settings = self.layout, context.scene.gof.score
        layout.use_property_split = True
        object_ = _cloud(context)
        write_lines(
            layout, context, f"Score of {object_.name}" if object_ else "Select a reconstruction", "POINTCLOUD_DATA"
        )
        layout.prop(settings, "dataset")
        if settings.result or (object_ and not result_file.known(object_)):
            layout.prop(settings, "result")
        if settings.python or not preferences.python():
            layout.prop(settings, "python")
        job = GOF_OT_score.job
        layout.operator("gof.score", text=f"{job} (Esc stops it)" if job else "Compute Score")
        if settings.numbers:
            box = layout.box().column(align=True)
            for line in settings.numbers.splitlines():
                name, value = line.split(": ", 1)
                if len(value) > MOST_BESIDE:
                    write_lines(box, context, f"{name} {value}")
                    continue
                row = box.split(factor=0.65)
                row.label(text=name)
                row.label(text=value)
        layout.operator("gof.show_errors")
        if settings.centres:
            write_lines(layout, context, settings.centres)


def unregister() -> None:
    """End the job: it does not outlive the add-on."""
    GOF_OT_score.stop_job()


Settings = GOF_PG_score
CLASSES = (GOF_OT_score, GOF_OT_show_errors, GOF_PT_score)
