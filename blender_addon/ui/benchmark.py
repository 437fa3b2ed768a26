"""Panel "Benchmark"."""

import bpy

from .panel import SidebarPanel


class GOF_PG_benchmark(bpy.types.PropertyGroup):
    """``scene.gof.benchmark``."""


class GOF_PT_benchmark(SidebarPanel, bpy.types.Panel):
    bl_label = "Benchmark"
    bl_order = 2

    def draw(self, context):
        pass


Settings = GOF_PG_benchmark
CLASSES = (GOF_PT_benchmark,)
