"""Errors and notes on a scene spec in the words of the panels: a field of the spec has a label there."""

from __future__ import annotations

import re

import bpy

from . import effect_groups

OF_FIRE = {  # field of the spec: property of scene.gof.fire
    "fire.position": "shape",
    "domain.size": "domain_size",
    **{f"fire.{name}": name for name in ("fuel", "shape", "radius", "light", "speeds", "intensity", "logs")},
}
OF_CAMERAS = {"clip.fps": "fps", "cameras.look_at": "look_at_height"}
OF_BENCHMARK = {f"fire.{name}": name for name in ("grids", "start_s", "radiance")}
OF_PRESET = {
    "domain.resolution": "Preset (cells)",
    "clip.frames": "Preset (frames)",
    "render.percentage": "Preset (percentage)",
}
FIELD = re.compile(r"\b(fire|domain|clip|render|cameras|effects)\.(\w+)(?:\.(\w+))?")


def in_fire_panel(scene: bpy.types.Scene, text: str) -> str:
    """Return a text in which the spec's fields have the labels of the Fire panel: "fire.radius" is "Radius"."""
    cells = _label(scene.gof.fire, "resolution")
    return _with_labels(scene, text.replace("domain.resolution", cells))


def in_benchmark_panel(scene: bpy.types.Scene, text: str) -> str:
    """Return the same for the Benchmark panel, whose preset sets some fields. Those of a spec file keep their names."""
    return text if scene.gof.benchmark.background == "file" else _with_labels(scene, text)


def _with_labels(scene: bpy.types.Scene, text: str) -> str:
    return FIELD.sub(lambda found: _name(scene, *found.groups(default="")) or found[0], text)


def _name(scene: bpy.types.Scene, room: str, name: str, more: str) -> str:
    """Return the panels' name of the field `room.name.more`, "" where they have none."""
    field, rest, settings = f"{room}.{name}", f".{more}" if more else "", scene.gof
    if room == "effects" and name in effect_groups.GROUPS:
        group = getattr(settings.fire.effects, name)
        known = more in group.bl_rna.properties if more else False
        return f"{_label(group, 'use')}: {_label(group, more)}" if known else _label(group, "use") + rest
    if field in OF_PRESET:
        return OF_PRESET[field] + rest
    if field in OF_FIRE:
        return _label(settings.fire, OF_FIRE[field]) + rest
    if field in OF_BENCHMARK:
        return _label(settings.benchmark, OF_BENCHMARK[field]) + rest
    on_panel = OF_CAMERAS.get(field, name if room == "cameras" else "")
    cameras = settings.fire.cameras
    return _label(cameras, on_panel) + rest if on_panel and on_panel in cameras.bl_rna.properties else ""


def _label(owner: bpy.types.PropertyGroup, name: str) -> str:
    """Return a property's label without its unit."""
    return owner.bl_rna.properties[name].name.partition(" (")[0]
