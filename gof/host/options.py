"""Ranges of the numbers of a command line. One function refuses, in one form, before any work."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable
from dataclasses import MISSING, fields
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from gof.core.errors import GofError


def require_number(
    flag: str, value: float | None, least: float = -math.inf, most: float = math.inf, above: float = -math.inf
) -> None:
    """Make sure that an option, where it is given, is a finite number of a range.

    Args:
        least, most: it may be these.   above: it must be more than this.
    Raises:
        GofError: it is not (names the option and its range).
    """
    if value is None or (math.isfinite(value) and least <= value <= most and value > above):
        return
    bounds = [f"above {above:g}"] if above > -math.inf else []
    bounds += [f"{least:g} or more"] if least > -math.inf else []
    bounds += [f"at most {most:g}"] if most < math.inf else []
    raise GofError(f"{flag} {value:g}: must be {' and '.join(bounds) or 'a finite number'}")


def require_whole(flag: str, value: object, least: int) -> None:
    """Require an integer of at least `least`, as files of settings can hold. Raises GofError: it is not (names it)."""
    if not isinstance(value, int) or isinstance(value, bool):
        raise GofError(f"{flag} {value!r}: must be a whole number")
    if value < least:
        raise GofError(f"{flag} {value}: must be {least} or more")


def require_choice(flag: str, value: object, choices: Iterable[object]) -> None:
    """Require one of the choices. Raises GofError: it is none (names them)."""
    if value not in (known := list(choices)):
        raise GofError(f"{flag} {value}: there are {', '.join(map(str, known))}")


def require_choices(record: Any, called: Callable[[str], str]) -> None:
    """Require in every field of a dataclass whose type is a Literal one of its choices, or None where that is allowed.

    Args:
        called: the option of a field's name.
    Raises:
        GofError: a field has another value (names the choices).
    """
    for name, hint in get_type_hints(type(record)).items():
        parts = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
        choices = [choice for part in parts if get_origin(part) is Literal for choice in get_args(part)]
        value = getattr(record, name)
        if choices and not (value is None and type(None) in parts):
            require_choice(called(name), value, choices)


def require_not_given(config: Any, idle: Collection[str], why: str) -> None:
    """Make sure that options which would change nothing are not given: who gives one believes that it counts.

    Args:
        config: dataclass of options.   idle: names of those fields.   why: they would change nothing, in words.
    Raises:
        GofError: one has another value than its default (names all of them).
    """
    usual = {f.name: f.default if f.default_factory is MISSING else f.default_factory() for f in fields(config)}
    given = [name for name in idle if getattr(config, name) != usual[name]]
    given = [f"--{'no-' if usual[name] is True else ''}{name.replace('_', '-')}" for name in given]
    if given:
        raise GofError(f"{', '.join(given)}: {why}; leave out {' and '.join(given)}")


def require_positive(flag: str, value: float | None) -> None:
    """Require a finite number above 0, where it is given. Raises GofError."""
    require_number(flag, value, above=0)


def require_all_positive(flag: str, values: Iterable[float] | None) -> None:
    """Require each of them to be above 0, where they are given. Raises GofError."""
    for value in values or ():
        require_positive(flag, value)
