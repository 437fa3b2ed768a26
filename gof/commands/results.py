"""Several results on a command line: RESULT, or NAME=RESULT."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import tyro

from gof.core.errors import GofError

Results = tyro.conf.Positional[Annotated[tuple[str, ...], tyro.conf.arg(metavar="[NAME=]RESULT ...")]]


def named(words: Sequence[str]) -> list[tuple[str | None, Path]]:
    """What people call each result, None for the name of its folder or file, and where it is.

    Raises:
        GofError: there is no result.
    """
    if not words:
        raise GofError("name a result: a folder of `gof reconstruct`, or a file of a method")
    found: list[tuple[str | None, Path]] = []
    for word in words:
        name, equals, path = word.partition("=")
        plain = not equals or not name or Path(word).exists()
        found.append((None, Path(word)) if plain else (name, Path(path)))
    return found
