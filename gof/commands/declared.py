"""The options that a command declares: the fields of its config class, read without running the command.

Help, completion, the count of options and the tests read them here; the values themselves are parsed by tyro.
"""

from __future__ import annotations

import ast
import dataclasses
import importlib
import inspect
import itertools
import textwrap
import types
import typing
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import tyro

BY_TYPE = {int: "N", float: "NUMBER", str: "TEXT", Path: "PATH"}
SUFFIXES = ("Config", "Study")  # of the classes that `gof.commands.read.read_options` is given


@dataclass(frozen=True)
class Option:
    """An option, or a positional argument, of a command.

    Attributes:
        name: "--max-size", or the metavar of a positional argument.
        field: of the config class.
        value: what to give it, "PX" or "play|freeze|bullet"; "" for a switch.
        text: what it does.
        default: as people type it; "" for none.
        several: takes more than one word.
    """

    name: str
    field: str
    value: str
    text: str
    default: str = ""
    choices: tuple[str, ...] = ()
    positional: bool = False
    required: bool = False
    several: bool = False


def config_of(module: str) -> type:
    """Return the config class of a command's module. Raises ValueError: the module has none, or several."""
    found = [
        kind
        for name, kind in vars(importlib.import_module(module)).items()
        if name.endswith(SUFFIXES) and isinstance(kind, type) and dataclasses.is_dataclass(kind)
        if kind.__module__ == module
    ]
    if len(found) != 1:
        raise ValueError(f"{module}: {len(found)} classes named *Config or *Study, not one")
    return found[0]


def options_of(config: type) -> list[Option]:
    """Return the positional arguments and options of a config class, in their order."""
    texts, hints = texts_of(config), typing.get_type_hints(config, include_extras=True)
    return [option for field in dataclasses.fields(config) for option in _options(field, hints[field.name], texts)]


def first_of(config: type) -> list[Option]:
    """Return the options of a command's first help screen: those that FIRST names, or all."""
    options = [option for option in options_of(config) if not option.positional]
    first = getattr(config, "FIRST", None)
    if first is None:
        return options
    by_field = {option.field: option for option in options}
    return [by_field[name] for name in first]


def texts_of(config: type) -> dict[str, str]:
    """Return the strings under the fields of a class, and of those that it is made from, as one line each."""
    found: dict[str, str] = {}
    for kind in reversed(config.__mro__[:-1]):
        written = ast.parse(textwrap.dedent(inspect.getsource(kind))).body[0]
        for line, after in itertools.pairwise(written.body if isinstance(written, ast.ClassDef) else ()):
            text = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant) and after.value.value
            if isinstance(line, ast.AnnAssign) and isinstance(line.target, ast.Name) and isinstance(text, str):
                found[line.target.id] = " ".join(text.split())
    return found


def _options(field: dataclasses.Field, hint: Any, texts: dict[str, str]) -> Iterator[Option]:
    kind, marks = _bare(hint)
    if (
        any(mark is tyro.conf.OmitArgPrefixes for mark in marks)
        and isinstance(kind, type)
        and dataclasses.is_dataclass(kind)
    ):
        yield from options_of(kind)
        return
    positional = any(mark is tyro.conf.Positional for mark in marks)
    kinds, inner = _plain(kind)
    metavars = [mark.metavar for mark in (*marks, *inner) if getattr(mark, "metavar", None)]
    names = [mark.name for mark in marks if getattr(mark, "name", None)]
    choices = tuple(word for each in kinds for word in _choices(each))
    switch = kinds == [bool]
    default = _default(field)
    value = metavars[0] if metavars else "|".join([*choices, *(BY_TYPE[k] for k in kinds if k in BY_TYPE)])
    name = names[0] if names else field.name.replace("_", "-")
    yield Option(
        name=value if positional else f"--no-{name}" if switch and default is True else f"--{name}",
        field=field.name,
        value="" if switch else value,
        text=texts.get(field.name, ""),
        default="" if switch or default in (None, ()) else _typed(default),
        choices=choices,
        positional=positional,
        required=default is dataclasses.MISSING,
        several=_several(kind),
    )


def _default(field: dataclasses.Field) -> Any:
    if field.default_factory is not dataclasses.MISSING:
        return field.default_factory() or None
    return field.default


def _typed(value: Any) -> str:
    """Return a default in the form in which it is typed."""
    if value is dataclasses.MISSING:
        return ""
    if isinstance(value, (tuple, list)):
        return " ".join(map(_typed, value))
    return f"{value:g}" if isinstance(value, float) else str(value)


def _bare(hint: Any) -> tuple[Any, tuple]:
    """Return a type without its annotations, and these."""
    if typing.get_origin(hint) is typing.Annotated:
        kind, *marks = typing.get_args(hint)
        return kind, tuple(marks)
    return hint, ()


def _plain(hint: Any) -> tuple[list[Any], list[Any]]:
    """Return the single types in a union or a sequence, without None, and all their annotations."""
    kind, marks = _bare(hint)
    if kind in (type(None), Ellipsis):
        return [], []
    if typing.get_origin(kind) in (typing.Union, types.UnionType, tuple, list):
        parts = [_plain(part) for part in typing.get_args(kind)]
        kinds = list(dict.fromkeys(k for part, _ in parts for k in part))
        return kinds, [*marks, *(mark for _, found in parts for mark in found)]
    return [kind], list(marks)


def _choices(kind: Any) -> tuple[str, ...]:
    return tuple(map(str, typing.get_args(kind))) if typing.get_origin(kind) is Literal else ()


def _several(hint: Any) -> bool:
    kind, _ = _bare(hint)
    if typing.get_origin(kind) in (typing.Union, types.UnionType):
        return any(_several(part) for part in typing.get_args(kind))
    return typing.get_origin(kind) in (tuple, list)
