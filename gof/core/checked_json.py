"""Frozen dataclasses from JSON objects, checked field by field."""

from __future__ import annotations

import dataclasses
import functools
import math
import types
import typing
from typing import Any, Literal

from .errors import GofError

KINDS = {bool: "true or false", str: "a text", dict: "an object"}  # of JSON, in errors


class SpecError(GofError, ValueError):
    """A scene spec or another object that cannot be built; the message names the field and what it should be."""


def require(condition: bool, name: str, rule: str, value: Any) -> None:
    """Raise SpecError("<name> must be <rule>, got <value>") unless the condition holds."""
    if not condition:
        raise SpecError(f"{name} must be {rule}, got {_shown(value)}")


def _shown(value: Any) -> str:
    """Return a value in an error, at most 80 characters of it."""
    try:
        text = repr(value)
    except ValueError:  # an integer of thousands of digits
        text = f"a number of about {int(value.bit_length() * math.log10(2))} digits"
    return text if len(text) <= 80 else text[:77] + "..."


def from_dict(cls: type, data: Any, prefix: str, ignore_unknown: bool = False) -> Any:
    """Build dataclass ``cls`` from a JSON object.

    A field named like a Python keyword has a trailing underscore that its key has not (`import_`, "import"). A class
    with fields that had other names in an older version lists these: FORMER = {old name: name}.

    Args:
        prefix: what names its fields in errors, such as "fire.".
        ignore_unknown: leave fields aside that the class does not have, as newer writers may add some.

    Raises:
        SpecError: a field is unknown, missing, of the wrong type, or refused by the class.
    """
    require(isinstance(data, dict), prefix.rstrip(".") or "it", "an object", data)
    if former := getattr(cls, "FORMER", None):
        data = {former.get(key, key): value for key, value in data.items()}
    fields, required = _fields(cls)
    unknown = sorted(data.keys() - fields.keys())
    if unknown and not ignore_unknown:
        raise SpecError(f"{prefix}{unknown[0][:80]} is not a field; known: {', '.join(sorted(fields))}")
    for key in required:
        if key not in data:
            raise SpecError(f"{prefix}{key} is missing")
    values = {}
    for key, value in data.items():
        if key in fields:
            name, hint = fields[key]
            values[name] = _value(hint, value, prefix + key, ignore_unknown)
    return cls(**values)


@functools.cache
def _fields(cls: type) -> tuple[dict[str, tuple[str, Any]], list[str]]:
    """Return, for a dataclass, key in JSON -> name and type of its field; and the keys that must be there."""
    hints, all_fields = typing.get_type_hints(cls), dataclasses.fields(cls)
    known = {item.name.removesuffix("_"): (item.name, hints[item.name]) for item in all_fields if item.init}
    return known, [item.name.removesuffix("_") for item in all_fields if item.init and not _is_optional(item)]


def _is_optional(item: dataclasses.Field) -> bool:
    return item.default is not dataclasses.MISSING or item.default_factory is not dataclasses.MISSING


def _value(hint: Any, value: Any, name: str, ignore_unknown: bool) -> Any:
    """Return a field's value of the annotated type; ``name`` is what errors call it."""
    optional, hints = _options(hint)
    if value is None and optional:
        return value
    hint = hints[0] if len(hints) == 1 else _chosen(hints, value)
    if hint is Any or (hint is float and type(value) is float and math.isfinite(value)):
        return value  # effects, which are built already; most of what files hold
    if hint in (int, float):
        return _number(hint, value, name)
    if isinstance(hint, type) and dataclasses.is_dataclass(hint):
        return from_dict(hint, value, name + ".", ignore_unknown)
    origin, args = typing.get_origin(hint), typing.get_args(hint)
    if origin is Literal:
        require(value in args and type(value) in map(type, args), name, f"one of {list(args)}", value)
        return value
    if origin is tuple:
        return _tuple(args, value, name, ignore_unknown)
    kind = origin or hint
    require(isinstance(value, kind), name, KINDS[kind], value)
    if origin is dict:
        return {key: _value(args[1], item, f"{name}.{key[:80]}", ignore_unknown) for key, item in value.items()}
    return value


@functools.cache
def _options(hint: Any) -> tuple[bool, tuple[Any, ...]]:
    """Return whether a type allows None, and what else it allows."""
    several = typing.get_origin(hint) in (typing.Union, types.UnionType)
    options = typing.get_args(hint) if several else (hint,)
    return type(None) in options, tuple(item for item in options if item is not type(None))


def _chosen(hints: tuple[Any, ...], value: Any) -> Any:
    """Return the first of several dataclasses whose required fields are all there, otherwise the last."""
    for hint in hints[:-1]:
        if isinstance(value, dict) and set(_fields(hint)[1]) <= set(value):
            return hint
    return hints[-1]


def _tuple(args: tuple, value: Any, name: str, ignore_unknown: bool) -> tuple:
    if args[-1] is Ellipsis:
        require(isinstance(value, (list, tuple)), name, "a list", value)
        args = args[:1] * len(value)
    rule = f"{len(args)} numbers" if set(args) <= {int, float} else f"a list of {len(args)}"
    require(isinstance(value, (list, tuple)) and len(value) == len(args), name, rule, value)
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
