"""The scene's colour management as a spec has it: for panels too, so it needs nothing that old Blenders lack."""

from __future__ import annotations

import bpy

from ..core.checked_json import SpecError
from ..pure.spec import Display


def apply(display: Display, scene: bpy.types.Scene) -> None:
    """Set a scene's view transform and look. Raises SpecError: this Blender does not know one of them."""
    view = scene.view_settings
    for name, value in (("view_transform", display.view_transform), ("look", display.look)):
        try:
            setattr(view, name, value)
        except TypeError as error:
            known = str(error).partition("not found in ")[2]
            raise SpecError(f"display.{name} must be one of {known}, got {value!r}") from None
    view.exposure, view.gamma = display.exposure, display.gamma


def require_display(display: Display) -> None:
    """Raise SpecError if this Blender cannot show it so; the open scene is not changed."""
    trial = bpy.data.scenes.new("Trial")
    try:
        apply(display, trial)
    finally:
        bpy.data.scenes.remove(trial)
