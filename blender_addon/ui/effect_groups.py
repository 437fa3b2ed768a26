"""Property groups of the effects, made from their settings dataclasses: a new effect needs no line here."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import itertools
import typing

import bpy

from ..pure import effects
from ..scene.effects import changes_scene
from .panel import number, vector

SUFFIXES = {  # longest first
    "ev_per_s": "EV/s",
    "m_s": "m/s",
    "deg": "°",
    "us": "µs",
    "mm": "mm",
    "px": "px",
    "ev": "EV",
    "s": "s",
    "m": "m",
}
WORDS = {
    "metres": "m",
    "seconds": "s",
    "electrons": "e⁻",
    "stops": "EV",
    "metre": "1/m",
    "cells": "cells",
    "percent": "%",
    "m/s": "m/s",
}


def unit_in(name: str) -> tuple[str, str]:
    """Return a field's name without the unit at its end, and this; "" where there is none."""
    for suffix, unit in SUFFIXES.items():
        if name.endswith(f"_{suffix}"):
            return name.removesuffix(f"_{suffix}"), unit
    return name, ""


def unit_of(name: str, note: str) -> str:
    """Return the unit of a field with a description; "" for a pure number."""
    words = note.replace(",", " ").replace(".", " ").split()
    return unit_in(name)[1] or next((WORDS[word] for word in reversed(words) if word in WORDS), "")


DEFAULT = ("vorticity",)  # without it the solver's own diffusion makes a flame like candle wax


def _descriptions(settings: type) -> dict[str, str]:
    """Return first lines of the strings that follow a dataclass's fields in its source."""
    body = ast.parse(inspect.getsource(settings)).body[0].body
    return {
        field.target.id: note.value.value.strip().split("\n")[0].rstrip(".")
        for field, note in itertools.pairwise(body)
        if isinstance(field, ast.AnnAssign) and isinstance(note, ast.Expr) and isinstance(note.value, ast.Constant)
    }


def label(name: str, note: str) -> str:
    """Return a field's name on a panel, with its unit in brackets."""
    unit = unit_of(name, note)
    return unit_in(name)[0].replace("_", " ").capitalize() + (f" ({unit})" if unit else "")


def _properties(settings: type) -> dict:
    """Blender properties of the fields that are a number, a place or a choice; the others keep their defaults."""
    kinds, notes, found = typing.get_type_hints(settings), _descriptions(settings), {}
    for field in dataclasses.fields(settings):
        note = notes.get(field.name, "")
        common = {"name": label(field.name, note), "description": note}
        kind = kinds[field.name]
        precision = 6 if common["name"].endswith("(s)") else 3  # a shutter of 1/8000 s
        if kind is float:
            found[field.name] = bpy.props.FloatProperty(**common, default=field.default, precision=precision)
        elif kind == tuple[float, float, float]:
            found[field.name] = bpy.props.FloatVectorProperty(**common, default=field.default, precision=precision)
        elif kind is int:
            found[field.name] = bpy.props.IntProperty(**common, default=field.default)
        elif typing.get_origin(kind) is typing.Literal:
            items = [(value, value, "") for value in typing.get_args(kind)]
            found[field.name] = bpy.props.EnumProperty(**common, items=items, default=field.default)
    return found


def _group(name: str) -> type:
    module = effects.module(name)
    summary = module.__doc__.split("\n")[0].rstrip(".")
    use = bpy.props.BoolProperty(name=name.replace("_", " ").capitalize(), description=summary, default=name in DEFAULT)
    fields = {"use": use, **_properties(module.Settings)}
    return type(f"GOF_PG_effect_{name}", (bpy.types.PropertyGroup,), {"__annotations__": fields, "__doc__": summary})


GROUPS = {name: _group(name) for name in effects.names()}


class GOF_PG_effects(bpy.types.PropertyGroup):
    """``scene.gof.fire.effects``: one group per effect, with ``use`` and the effect's settings."""

    __annotations__ = {name: bpy.props.PointerProperty(type=group) for name, group in GROUPS.items()}


def chosen(groups: GOF_PG_effects) -> tuple:
    """Return settings of the effects that are in use. Raises SpecError for a value out of range."""
    used = [(effects.module(name).Settings, getattr(groups, name)) for name in GROUPS if getattr(groups, name).use]
    return tuple(
        settings(**{name: exact(getattr(group, name)) for name in group.__annotations__ if name != "use"})
        for settings, group in used
    )


def in_scene(name: str) -> bool:
    """Return whether an effect is something in the scene, not in the camera."""
    return changes_scene(effects.module(name).Settings())


def exact(value):
    """Return a property's value as it was typed: Blender keeps single precision, 0.13 reads as 0.12999999523."""
    if isinstance(value, bpy.types.bpy_prop_array):
        return tuple(map(exact, value))
    return float(f"{value:.7g}") if isinstance(value, float) else value


def draw(layout, groups: GOF_PG_effects) -> None:
    """Draw a checklist; the settings of those chosen open below them."""
    for title, wanted in (("In the scene", True), ("In the cameras", False)):
        box = layout.box()
        box.label(text=title)
        for name in (name for name in GROUPS if in_scene(name) == wanted):
            group = getattr(groups, name)
            box.prop(group, "use")
            if group.use:
                settings = box.column(align=True)
                settings.use_property_split = True
                for field in group.__annotations__:
                    if field != "use":
                        _draw_field(settings, group, field)


def _draw_field(layout, group, field: str) -> None:
    kind = group.bl_rna.properties[field]
    if kind.type == "ENUM":
        layout.prop(group, field)
    elif kind.is_array:
        vector(layout, group, field)
    else:
        number(layout, group, field)
