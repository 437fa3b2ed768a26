"""The `gof` command: names the commands, loads only the one that is asked for, prints errors people can act on."""

from __future__ import annotations

import errno
import importlib
import sys
from functools import cache
from importlib.metadata import entry_points

from gof import __version__
from gof.commands import COMMANDS, Command
from gof.errors import GofError

ALIASES = {"static": "ingest"}  # old name -> new name, for one version

# What a user's disk can do to a run.
DISK = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EACCES, errno.EPERM)

HELP = """\
gof {version} - Gaussians on Fire: three videos of a flame to transient 3D Gaussians with real velocities.

usage: gof COMMAND [OPTIONS]        gof COMMAND --help explains one command

{commands}

the whole loop, step by step:
  gof generate demo --out data/fire                 a dataset: pictures, cameras, velocity in m/s
  gof reconstruct data/fire --out out/fire          out/fire/result.ply and result.npz
  gof evaluate out/fire/result.npz --truth data/fire --out out/fire
  gof import out/fire/result.npz --dataset data/fire --blend out/fire/result.blend
  gof report out/fire --dataset data/fire           out/fire/report.html

Every command resumes what it finds half done, and writes its figures with --json FILE.
"""


@cache
def commands() -> dict[str, Command]:
    """Every command by name, in the order of the work: gof's own, and those of installed packages (`gof.commands`)."""
    found = dict(COMMANDS)
    for table in entry_points(group="gof.commands"):
        found |= table.load()
    return dict(sorted(found.items(), key=lambda item: item[1].place))


def main(argv: list[str] | None = None) -> int:
    """Run one command. Returns the exit status: 0 done, 1 a named error, 2 wrong usage, 130 Ctrl-C."""
    argv = sys.argv[1:] if argv is None else argv
    if not argv or argv[0] in ("-h", "--help", "help"):
        lines = "\n".join(f"  {name:<12} {command.help}" for name, command in commands().items())
        print(HELP.format(version=__version__, commands=lines))
        return 0
    if argv[0] == "--version":
        print(f"gof {__version__}")
        return 0
    name, *rest = argv
    if name in ALIASES:
        print(f"gof {name} is now called gof {ALIASES[name]}; the old name goes with the next version", file=sys.stderr)
        name = ALIASES[name]
    if name not in commands():
        print(f"gof: no command '{name}'; commands: {', '.join(commands())}", file=sys.stderr)
        return 2
    return run(name, rest)


def run(name: str, argv: list[str]) -> int:
    """Run a command with its own arguments, and say what stopped it in words that help."""
    try:
        return importlib.import_module(commands()[name].module).main(argv) or 0
    except GofError as e:
        print(f"gof {name}: {e}", file=sys.stderr)
        return 1
    except OSError as e:
        if e.errno not in DISK:
            raise
        print(
            f"gof {name}: {e.filename or 'a file'}: {e.strerror}; finished work is kept: make room, or choose another "
            "folder, and run the same command again",
            file=sys.stderr,
        )
        return 1
    except KeyboardInterrupt:
        print(f"\ngof {name}: stopped; finished work is kept, the same command resumes", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
