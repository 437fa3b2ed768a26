"""The sidebar tab "Gaussians on Fire": one module per panel, all settings in ``scene.gof``.

A panel module has ``Settings`` (a property group), ``CLASSES`` (operators and panels, in the order they are registered)
and may have ``GROUPS`` (property groups that its settings consist of), and ``register()`` and ``unregister()`` for what
is not a class, such as menu entries.
"""

from __future__ import annotations

import bpy

from . import benchmark, camera_files, export, fire, preferences, reconstruction, score

PANELS = {"fire": fire, "benchmark": benchmark, "reconstruction": reconstruction, "score": score}


class GOF_PG_scene(bpy.types.PropertyGroup):
    """``scene.gof``: ``scene.gof.fire``, ``scene.gof.benchmark``, ... hold each panel's settings."""

    __annotations__ = {name: bpy.props.PointerProperty(type=module.Settings) for name, module in PANELS.items()}


def _classes(module) -> tuple[type, ...]:
    settings = (module.Settings,) if module in PANELS.values() else ()
    return (*getattr(module, "GROUPS", ()), *settings, *module.CLASSES)


def register() -> None:
    for module in (preferences, export, camera_files, *PANELS.values()):
        for kind in _classes(module):
            bpy.utils.register_class(kind)
        getattr(module, "register", lambda: None)()
    bpy.utils.register_class(GOF_PG_scene)
    bpy.types.Scene.gof = bpy.props.PointerProperty(type=GOF_PG_scene)


def unregister() -> None:
    del bpy.types.Scene.gof
    bpy.utils.unregister_class(GOF_PG_scene)
    for module in reversed((preferences, export, camera_files, *PANELS.values())):
        getattr(module, "unregister", lambda: None)()
        for kind in reversed(_classes(module)):
            bpy.utils.unregister_class(kind)
