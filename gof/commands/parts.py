"""Commands of several parts: `gof NAME PART` lists its parts and loads only the part that is run."""

from __future__ import annotations

import importlib
import sys

from gof.commands import HELP_WORDS, no_such

Parts = dict[str, tuple[str, str]]  # by name: the module with `main(argv) -> exit status`, and what it does in a line


def run_part(command: str, parts: Parts, text: str, argv: list[str]) -> int:
    """Run the part that the first word names, or print the help: where it is asked for, or no part is named.

    Args:
        text: the help, in which {parts} stands for a line of each part.
    Returns:
        the part's exit status; 2 where there is no such part.
    """
    if not argv or argv[0] in HELP_WORDS:
        width = max(map(len, parts)) + 1
        print(text.format(parts="\n".join(f"  {name:<{width}} {line}" for name, (_, line) in parts.items())))
        return 0
    if argv[0] not in parts:
        print(f"gof {command}: {no_such('part', argv[0], parts)}; gof {command} --help explains them", file=sys.stderr)
        return 2
    return importlib.import_module(parts[argv[0]][0]).main(argv[1:]) or 0
