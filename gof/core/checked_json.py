"""Frozen dataclasses from JSON objects, checked field by field."""

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
        raise SpecError(f"{name} must be {rule}, got {_shown(value)}")


def _shown(value: Any) -> str:
    """A value in an error, at most 80 characters of it."""
    try:
        text = repr(value)
    except ValueError:  # an integer of thousands of digits
        text = f"a number of about {int(value.bit_length() * math.log10(2))} digits"
    return text if len(text) <= 80 else text[:77] + "..."


def from_dict(cls: type, data: Any, prefix: str, ignore_unknown: bool = False) -> Any:
    """Build dataclass ``cls`` from a JSON object.

    Args:
        prefix: what names its fields in errors, such as "fire.".
        ignore_unknown: leave fields aside that the class does not have, as newer writers may add some.

    Raises:
        SpecError: a field is unknown, missing, of the wrong type, or refused by the class.
    """
    require(isinstance(data, dict), prefix.rstrip(".") or "it", "an object", data)
    hints, fields = typing.get_type_hints(cls), {item.name: item for item in dataclasses.fields(cls)}
    unknown = sorted(set(data) - set(fields))
    if unknown and not ignore_unknown:
        raise SpecError(f"{prefix}{unknown[0]} is not a field; known: {', '.join(sorted(fields))}")
    for name, item in fields.items():
        optional = item.default is not dataclasses.MISSING or item.default_factory is not dataclasses.MISSING
        if name not in data and not optional:
            raise SpecError(f"{prefix}{name} is missing")
    known = {name: value for name, value in data.items() if name in fields}
    return cls(**{name: _value(hints[name], value, prefix + name, ignore_unknown) for name, value in known.items()})


def _value(hint: Any, value: Any, name: str, ignore_unknown: bool) -> Any:
    """A field's value of the annotated type; ``name`` is what errors call it."""
    if hint is Any or (value is None and type(None) in typing.get_args(hint)):
        return value  # effects, which are built already; optional fields
    if typing.get_origin(hint) in (typing.Union, types.UnionType):
        hint = _chosen([item for item in typing.get_args(hint) if item is not type(None)], value)
    if dataclasses.is_dataclass(hint):
        return from_dict(hint, value, name + ".", ignore_unknown)
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    if origin is Literal:
        require(value in args and type(value) in map(type, args), name, f"one of {list(args)}", value)
        return value
    if origin is tuple:
        return _tuple(args, value, name, ignore_unknown)
    if hint in (int, float):
        return _number(hint, value, name)
    kind = origin or hint  # dict[str, Any] is checked as a dict
    require(isinstance(value, kind), name, f"a {kind.__name__}", value)
    return value


def _chosen(hints: list[Any], value: Any) -> Any:
    """Of several dataclasses the first whose required fields are all there, otherwise the last."""
    for hint in hints[:-1]:
        required = {
            item.name
            for item in dataclasses.fields(hint)
            if item.default is dataclasses.MISSING and item.default_factory is dataclasses.MISSING
        }
        if isinstance(value, dict) and required <= set(value):
            return hint
    return hints[-1]


def _tuple(args: tuple, value: Any, name: str, ignore_unknown: bool) -> tuple:
    if args[-1] is Ellipsis:
        require(isinstance(value, (list, tuple)), name, "a list", value)
        args = args[:1] * len(value)
    require(isinstance(value, (list, tuple)) and len(value) == len(args), name, f"{len(args)} numbers", value)
    return tuple(
        _value(arg, item, f"{name}[{index}]", ignore_unknown)
        for index, (arg, item) in enumerate(zip(args, value, strict=True))
    )


def _number(kind: type, value: Any, name: str) -> int | float:
    try:
        finite = isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
    except OverflowError:  # an integer that no float holds
        finite = False
    if kind is float:
        require(finite, name, "a finite number", value)
    else:
        require(finite and value == int(value), name, "a whole number", value)
    return kind(value)
