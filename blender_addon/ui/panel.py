"""What every panel of the tab has in common."""


class SidebarPanel:
    """Mixed into ``bpy.types.Panel``: a box of its own in the tab "Gaussians on Fire"."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Gaussians on Fire"
