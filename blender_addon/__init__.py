"""Gaussians on Fire for Blender: fire scenes with exact ground truth, and reconstructions as animated point clouds.

Runs inside Blender and headless with the ``bpy`` wheel. Needs numpy and nothing else from outside Blender.
"""

import atexit

bl_info = {  # for Blender before 4.2; later versions read blender_manifest.toml
    "name": "Gaussians on Fire",
    "author": "Gaussians on Fire contributors",
    "version": (0, 3, 0),
    "blender": (3, 4, 0),
    "location": "3D View > Sidebar > Gaussians on Fire",
    "description": "Fire benchmarks with exact ground-truth velocity; reconstructions of fire as animated Gaussians",
    "category": "Import-Export",
}


def register() -> None:
    """Add the panels, the operators and ``scene.gof`` to Blender."""
    import bpy  # here, so that the parts without bpy can be imported anywhere

    from . import ui
    from .scene import mantaflow

    mantaflow.enable()  # a file that is opened may hold a fire
    ui.register()
    if getattr(bpy.app, "module", False):
        # Python ends before the wheel's Blender does, which then waits for ever for Python to free what is registered.
        atexit.register(unregister)


def unregister() -> None:
    """Remove everything that ``register`` added; nothing where that has happened, as at the end of a wheel's Python."""
    import bpy

    from . import ui

    atexit.unregister(unregister)
    if hasattr(bpy.types.Scene, "gof"):
        ui.unregister()
