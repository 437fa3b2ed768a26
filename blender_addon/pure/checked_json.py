"""Frozen dataclasses from JSON objects, checked field by field. Never imports bpy."""

from __future__ import annotations

import dataclasses
import math
import types
import typing
from typing import Any, Literal


class SpecError(ValueError):
    """A scene spec that cannot be built; the message names the field and what it should be."""


def require(condition: bool, name: str, rule: str, value: Any) -> None:
    """Raise SpecError("<name> must be <rule>, got <value>") unless the condition holds."""
    if not condition:
        raise SpecError(f"{name} must be {rule}, got {value!r}")


def from_dict(cls: type, data: Any, prefix: str) -> Any:
    """Build dataclass ``cls`` from a JSON object; ``prefix`` ("fire.") names its fields in errors. Raises SpecError."""
    require(isinstance(data, dict), prefix.rstrip(".") or "spec", "an object", data)
    hints = typing.get_type_hints(cls)
    unknown = sorted(set(data) - set(hints))
    if unknown:
        raise SpecError(f"{prefix}{unknown[0]} is not a field; known: {', '.join(sorted(hints))}")
    for item in dataclasses.fields(cls):
        optional = item.default is not dataclasses.MISSING or item.default_factory is not dataclasses.MISSING
        if item.name not in data and not optional:
            raise SpecError(f"{prefix}{item.name} is missing")
    return cls(**{name: _value(hints[name], value, prefix + name) for name, value in data.items()})


def _value(hint: Any, value: Any, name: str) -> Any:
    if hint is Any or (value is None and type(None) in typing.get_args(hint)):
        return value  # effects, which are built already; optional fields
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        hint = next(item for item in typing.get_args(hint) if item is not type(None))
    if dataclasses.is_dataclass(hint):
        return from_dict(hint, value, name + ".")
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    if origin is Literal:
        require(value in args and type(value) in map(type, args), name, f"one of {list(args)}", value)
        return value
    if origin is tuple:
        if args[-1] is Ellipsis:
            require(isinstance(value, (list, tuple)), name, "a list", value)
            return tuple(_value(args[0], item, f"{name}[{i}]") for i, item in enumerate(value))
        require(isinstance(value, (list, tuple)) and len(value) == len(args), name, f"{len(args)} numbers", value)
        return tuple(_value(arg, item, f"{name}[{i}]") for i, (arg, item) in enumerate(zip(args, value, strict=True)))
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if hint is float:
        require(number and math.isfinite(value), name, "a finite number", value)
        return float(value)
    if hint is int:
        require(
            number and value == int(value) if number and math.isfinite(value) else False, name, "a whole number", value
        )
        return int(value)
    require(isinstance(value, hint), name, f"a {hint.__name__}", value)
    return value
