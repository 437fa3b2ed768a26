"""What every panel of the tab has in common."""

import textwrap


class SidebarPanel:
    """Mixed into ``bpy.types.Panel``: a box of its own in the tab "Gaussians on Fire"."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Gaussians on Fire"


def write_lines(layout, context, text: str, icon: str = "NONE") -> None:
    """Show a text in as many lines as the sidebar's width needs; Blender itself would cut it."""
    characters = max(int(context.region.width / (7 * context.preferences.system.ui_scale)) - 4, 20)
    column = layout.column(align=True)
    for index, line in enumerate(textwrap.wrap(text, characters)):
        column.label(text=line, icon=icon if index == 0 else ("BLANK1" if icon != "NONE" else "NONE"))
