"""Panel "Reconstruction"."""

import bpy

from .panel import SidebarPanel


class GOF_PG_reconstruction(bpy.types.PropertyGroup):
    """``scene.gof.reconstruction``."""


class GOF_PT_reconstruction(SidebarPanel, bpy.types.Panel):
    bl_label = "Reconstruction"
    bl_order = 3

    def draw(self, context):
        pass


Settings = GOF_PG_reconstruction
CLASSES = (GOF_PT_reconstruction,)
