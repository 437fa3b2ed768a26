"""Panel "Score"."""

import bpy

from .panel import SidebarPanel


class GOF_PG_score(bpy.types.PropertyGroup):
    """``scene.gof.score``."""


class GOF_PT_score(SidebarPanel, bpy.types.Panel):
    bl_label = "Score"
    bl_order = 4

    def draw(self, context):
        pass


Settings = GOF_PG_score
CLASSES = (GOF_PT_score,)
