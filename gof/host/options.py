"""Ranges of the numbers of a command line. One function refuses, in one form, before any work."""

from __future__ import annotations

import math
from collections.abc import Iterable

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


def require_positive(flag: str, value: float | None) -> None:
    """Require a finite number above 0, where it is given. Raises GofError."""
    require_number(flag, value, above=0)


def require_all_positive(flag: str, values: Iterable[float] | None) -> None:
    """Require each of them to be above 0, where they are given. Raises GofError."""
    for value in values or ():
        require_positive(flag, value)
