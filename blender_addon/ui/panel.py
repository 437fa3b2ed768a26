"""Parts that every panel of the tab has in common."""

import textwrap
from pathlib import Path

import bpy

TAB, MARGIN, ICON, CHARACTER = 24, 40, 20, 6.2  # pixels of the sidebar at Blender's own size of things
LABEL = 0.56  # of the width: "Light on Scene" must fit at the sidebar's first width


class SidebarPanel:
    """Mixed into ``bpy.types.Panel``: a box of its own in the tab "Gaussians on Fire"."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Gaussians on Fire"


def number(layout, owner, name: str, text: str = "", index: int = -1) -> None:
    """Draw a property with room for its label, which says the unit; Blender's own columns would cut it."""
    split = layout.split(factor=LABEL, align=True)
    split.use_property_split = False
    label = split.row()
    label.alignment = "RIGHT"
    label.label(text=text or _rna(owner)[name].name)
    split.prop(owner, name, text="", index=index)


def vector(layout, owner, name: str, axes: str = "XYZ") -> None:
    """Draw the parts of a property of several numbers, one below the other: "Size X (m)", "Y (m)"."""
    title, _, unit = _rna(owner)[name].name.partition(" (")
    for index in range(_rna(owner)[name].array_length):
        label = f"{title} {axes[index]}" if index == 0 else axes[index]
        number(layout, owner, name, f"{label} ({unit}" if unit else label, index)


def write_lines(layout, context, text: str, icon: str = "NONE") -> None:
    """Show a text in as many lines as the sidebar's width needs; Blender itself would cut it."""
    scale = context.preferences.system.ui_scale
    room = context.region.width / scale - TAB - MARGIN - (ICON if icon != "NONE" else 0)
    column = layout.column(align=True)
    for index, line in enumerate(textwrap.wrap(text, max(int(room / CHARACTER), 16))):
        column.label(text=line, icon=icon if index == 0 else ("BLANK1" if icon != "NONE" else "NONE"))


def show_text(context, path: Path) -> None:
    """Show a file in a text editor of this screen, or in one of a new window."""
    before = next(
        (text for text in bpy.data.texts if text.filepath and Path(bpy.path.abspath(text.filepath)) == path), None
    )
    if before is not None:
        bpy.data.texts.remove(before)
    text = bpy.data.texts.load(str(path))
    area = next((area for area in context.screen.areas if area.type == "TEXT_EDITOR"), None) if context.screen else None
    if area is None and not bpy.app.background:
        bpy.ops.wm.window_new()
        area = context.window_manager.windows[-1].screen.areas[0]
        area.type = "TEXT_EDITOR"
    if area is not None:
        area.spaces.active.text = text


def _rna(owner):
    """Return Blender's record of the properties of a group or an operator."""
    return getattr(owner, "properties", owner).bl_rna.properties
