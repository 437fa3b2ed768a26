"""Count the options of all commands: python tools/count_options.py

Options of a command's parts count with the part; those that every command understands count once, positional words do
not. `gof baseline` hands its words on, and has four options of its own.
"""

from __future__ import annotations

from gof.commands import everywhere
from gof.commands.completion import leaves
from gof.commands.declared import config_of, options_of


def main() -> int:
    """Print a line for each command, and the sum."""
    total, names = len(everywhere.OPTIONS), set()
    for name, module in leaves().items():
        options = [option.name for option in options_of(config_of(module)) if not option.positional]
        print(f"{len(options):3}  {name:<20} {' '.join(options)}")
        total += len(options)
        names.update(options)
    print(
        f"{len(everywhere.OPTIONS):3}  {'every command':<20} {' '.join(word.split()[0] for word in everywhere.OPTIONS)}"
    )
    print(f"{total} options of {len(leaves())} commands, {len(names)} different names")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
