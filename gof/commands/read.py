"""Arguments of a command: old names replaced, help shown, options that every command understands taken out, the rest
parsed by tyro."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, TypeVar

import tyro

from gof.commands import everywhere, screens
from gof.commands.renamed import renamed
from gof.core.errors import GofError
from gof.core.ladder import METAVAR

C = TypeVar("C")


def read_options(config: type[C], command: str, argv: Sequence[str]) -> C:
    """Return the options of a command, as an object of its config class.

    Args:
        command: the words after `gof`, as "capture sync".
        argv: the words after these.
    Raises:
        SystemExit: help was asked for (0), or an option is wrong (2).
        GofError: an option is gone (names the one that replaces it).
    """
    if screens.asked_for(argv):
        print(screens.of_command(config, command, whole=screens.WHOLE in argv))
        raise SystemExit(0)
    argv = everywhere.taken_from(renamed(command, list(argv)))
    for option, word in getattr(config, "BARE", {}).items():
        argv = _with_value(argv, option, word)
    return tyro.cli(config, prog=f"gof {command}", args=argv)


def _with_value(argv: list[str], option: str, word: str) -> list[str]:
    """Return the arguments, where an option that stands alone has the value that it means then."""
    found = []
    for here, after in zip(argv, [*argv[1:], "--"], strict=True):
        found += [here, word] if here == option and after.startswith("--") else [here]
    return found


# ----------------------------------------------------------------
# Numbers of a command line with their units, which help shows in place of the value.

Seconds = Annotated[float, tyro.conf.arg(metavar="SECONDS")]
Microseconds = Annotated[float, tyro.conf.arg(metavar="US")]
Rate = Annotated[float, tyro.conf.arg(metavar="FPS")]
Metres = Annotated[float, tyro.conf.arg(metavar="M")]
Millimetres = Annotated[float, tyro.conf.arg(metavar="MM")]
Inches = Annotated[float, tyro.conf.arg(metavar="IN")]
Degrees = Annotated[float, tyro.conf.arg(metavar="DEG")]
Megabytes = Annotated[float, tyro.conf.arg(metavar="MB")]
Pixels = Annotated[int, tyro.conf.arg(metavar="PX")]
Preset = Annotated[str, tyro.conf.arg(metavar=METAVAR)]


# ----------------------------------------------------------------
# Several results on a command line: RESULT, or NAME=RESULT.

Results = tyro.conf.Positional[Annotated[tuple[str, ...], tyro.conf.arg(metavar="[NAME=]RESULT ...")]]


def named(words: Sequence[str]) -> list[tuple[str | None, Path]]:
    """Return the given name of each result, None for that of its folder or file, and its path.

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
