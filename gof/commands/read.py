"""Arguments of a command: old names replaced, help shown, options that every command understands taken out, the rest
parsed by tyro."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import tyro

from gof.commands import everywhere, screens
from gof.commands.renamed import renamed

C = TypeVar("C")


def read_options(config: type[C], command: str, argv: Sequence[str]) -> C:
    """The options of a command, as an object of its config class.

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
    """The arguments, where an option that stands alone has the value that it means then."""
    found = []
    for here, after in zip(argv, [*argv[1:], "--"], strict=True):
        found += [here, word] if here == option and after.startswith("--") else [here]
    return found
