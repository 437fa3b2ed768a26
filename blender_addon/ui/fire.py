"""Panel "Fire"."""

import bpy

from .panel import SidebarPanel


class GOF_PG_fire(bpy.types.PropertyGroup):
    """``scene.gof.fire``."""


class GOF_PT_fire(SidebarPanel, bpy.types.Panel):
    bl_label = "Fire"
    bl_order = 1

    def draw(self, context):
        pass


Settings = GOF_PG_fire
CLASSES = (GOF_PT_fire,)
