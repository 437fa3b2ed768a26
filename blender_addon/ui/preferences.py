"""The add-on's preferences, kept for all files: the Python that scores, and the way to the documentation."""

from __future__ import annotations

from pathlib import Path

import bpy

from .panel import show_text

ADDON = __package__.rpartition(".")[0]  # the name that Blender gives the add-on
ROOT = Path(__file__).resolve().parents[1]
PAGES = (ROOT / "documentation.md", ROOT.parent / "docs" / "addon.md")  # in the zip, in a checkout


class GOF_AddonPreferences(bpy.types.AddonPreferences):
    """*Edit > Preferences > Add-ons > Gaussians on Fire*."""

    bl_idname = ADDON

    python: bpy.props.StringProperty(
        name="Python for Scores",
        subtype="FILE_PATH",
        description="Python that gof is installed in, such as .venv/bin/python; the Python set in a scene is preferred",
    )

    def draw(self, context):
        layout = self.layout
        layout.prop(self, "python")
        layout.operator(GOF_OT_documentation.bl_idname, icon="HELP")


class GOF_OT_documentation(bpy.types.Operator):
    """Open the add-on's documentation in a text editor"""

    bl_idname = "gof.documentation"
    bl_label = "Gaussians on Fire Documentation"

    def execute(self, context):
        page = next((page for page in PAGES if page.is_file()), None)
        if page is None:
            self.report({"ERROR"}, f"the add-on's documentation is not in {ROOT}: install the add-on's zip again")
            return {"CANCELLED"}
        show_text(context, page)
        return {"FINISHED"}


def python() -> str:
    """Return the Python for scores that the preferences name, "" where they name none."""
    addon = bpy.context.preferences.addons.get(ADDON)  # None where a script has registered the add-on
    return addon.preferences.python if addon and addon.preferences else ""


def _menu(menu, context):
    menu.layout.operator(GOF_OT_documentation.bl_idname, icon="HELP")


def register() -> None:
    bpy.types.TOPBAR_MT_help.append(_menu)


def unregister() -> None:
    bpy.types.TOPBAR_MT_help.remove(_menu)


CLASSES = (GOF_OT_documentation, GOF_AddonPreferences)
