"""A job in other processes, started by an operator: beside the user's work in a window, to its end in a script."""

from __future__ import annotations

import bpy

from ..core.errors import GofError
from ..pure.child import python

TIMER_S = 0.5
FAILURES = (GofError, OSError, RuntimeError)  # what is wrong with the user's work, not with ours


class JobOperator:
    """Mixed into ``bpy.types.Operator``; a subclass says which job, and what becomes of its outcome.

    A job has ``poll()`` (whether there is more to do), ``run()`` (all of it now), ``stop()``, and its state as a
    string; the first two raise one of FAILURES.
    """

    job = None
    """The job that runs in this Blender, one at a time. It belongs to the process, not to a file: it is never saved."""
    stopped = "Stopped"
    ask = ""
    """Operator that Esc calls to ask before it ends the job; "" ends it at once."""

    def begin(self, context):
        """Return a job, ready to run. Raises one of FAILURES that says what to change."""
        raise NotImplementedError

    def finish(self, context, job) -> str:
        """Keep the outcome of a job that is done; returns a line for the user."""
        raise NotImplementedError

    @classmethod
    def stop_job(cls) -> None:
        """End the job, if one runs; the operator that watches it leaves at its next timer."""
        job, cls.job = cls.job, None
        if job is not None:
            job.stop()

    def execute(self, context):
        """Do the job and return when it is finished: for scripts and ``blender -b``."""
        try:
            job = self.begin(context)
            job.run()
        except FAILURES as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, self.finish(context, job))
        return {"FINISHED"}

    def invoke(self, context, event):
        """Do the job beside the user's work; Esc stops it, after a question where there is much to lose."""
        try:
            type(self).job = self.begin(context)
        except FAILURES as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self._timer = context.window_manager.event_timer_add(TIMER_S, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        job = self.job
        escape = event.type == "ESC" and event.value == "PRESS" and not _is_playing(context)
        if escape and job is not None and self.ask:
            group, name = self.ask.split(".")
            getattr(getattr(bpy.ops, group), name)("INVOKE_DEFAULT")
            return {"RUNNING_MODAL"}
        if escape or job is None:
            self.cancel(context)
            self.report({"WARNING"}, self.stopped)
            return {"CANCELLED"}
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        try:
            unfinished = job.poll()
        except FAILURES as error:
            self.cancel(context)
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        if unfinished:
            context.workspace.status_text_set(
                f"{self.bl_label}: {job}. Esc {'offers to stop it' if self.ask else 'stops it'}"
            )
            _redraw(context)
            return {"PASS_THROUGH"}
        self.cancel(context)
        self.report({"INFO"}, self.finish(context, job))
        return {"FINISHED"}

    def cancel(self, context):
        """Stop the job and clean up; Blender calls this too, when it quits or opens another file."""
        self.stop_job()
        context.window_manager.event_timer_remove(self._timer)
        context.workspace.status_text_set(None)
        _redraw(context)


def blender() -> list[str]:
    """Return a command that runs Python code in another process of this Blender, without a window."""
    if getattr(bpy.app, "module", False):  # the bpy wheel: Blender is a module of Python
        return python()
    return [bpy.app.binary_path, "-b", "--factory-startup", "--python-exit-code", "1", "--python-expr"]


def _is_playing(context) -> bool:
    """Return whether an animation is played: Esc is its key then."""
    return any(window.screen.is_animation_playing for window in context.window_manager.windows)


def _redraw(context) -> None:
    """Draw the sidebars anew, and not the 3D views beside them, which may be slow."""
    areas = [
        area for window in context.window_manager.windows for area in window.screen.areas if area.type == "VIEW_3D"
    ]
    for region in (region for area in areas for region in area.regions if region.type == "UI"):
        region.tag_redraw()
