"""The `gof` command: names the commands, loads only the one that is asked for, prints errors people can act on."""

from __future__ import annotations

import errno
import importlib
import os
import re
import sys
from functools import cache
from importlib.metadata import entry_points

from gof import __version__
from gof.commands import COMMANDS, Command
from gof.errors import GofError, printable
from gof.files import follow_links_of

ALIASES = {"static": "ingest"}  # old name -> new name, for one version

# What a user's disk can do to a run.
DISK = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EACCES, errno.EPERM)

# Libraries say it in their own ways where Python's MemoryError does not come through.
NO_MEMORY = re.compile(
    r"out of memory|not enough memory|can(not|'t) allocate memory|failed to (map segment|allocate)|bad_alloc", re.I
)

HELP = """\
gof {version} - Gaussians on Fire: three videos of a flame to transient 3D Gaussians with real velocities.

usage: gof COMMAND [OPTIONS]        gof COMMAND --help explains one command

{commands}

start without Blender: gof sample unpacks a fire with its truth, a result, a submission and three films.

the whole loop, step by step:
  gof generate demo --out data/fire                 a dataset: pictures, cameras, velocity in m/s
  gof reconstruct data/fire --out out/fire          out/fire/result.ply and result.npz
  gof evaluate out/fire/result.npz --truth data/fire    L2 and CosSim, and out/fire/scores.json
  gof import out/fire/result.npz --dataset data/fire --blend out/fire/result.blend
  gof report out/fire --dataset data/fire           out/fire/report.html

Every command resumes what it finds half done, and all but view and baseline write their figures with --json FILE.
Pages that texts name as docs/NAME.md are in the folder docs of the source, which packages do not hold.
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
    try:
        return _main(argv)
    except BrokenPipeError:  # who reads our output has seen enough; Python would complain when it empties its buffers
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1


def _main(argv: list[str] | None) -> int:
    argv = sys.argv[1:] if argv is None else argv
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")  # a terminal that cannot show a letter ends no run
    odd = next((word for word in (*argv, os.getcwd()) if not word.isascii() and _is_not_utf8(word)), None)
    if odd is not None:
        print(
            f"gof: {printable(odd)!r} is not UTF-8; rename that file or folder, or set LC_ALL=C.UTF-8", file=sys.stderr
        )
        return 2
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
    follow_links_of(rest)
    return run(name, rest)


def _is_not_utf8(word: str) -> bool:
    """Bytes that are no text come as halves of characters."""
    return any("\ud800" <= c <= "\udfff" for c in word)


def run(name: str, argv: list[str]) -> int:
    """Run a command with its own arguments, and say what stopped it in words that help."""
    try:
        return importlib.import_module(commands()[name].module).main(argv) or 0
    except GofError as e:
        print(f"gof {name}: {e}", file=sys.stderr)
        return 1
    except MemoryError as e:
        print(
            f"gof {name}: not enough memory ({e or 'it does not say for what'}); smaller pictures or fewer Gaussians "
            "need less, see --help",
            file=sys.stderr,
        )
        return 1
    except (ImportError, RuntimeError) as e:
        if not NO_MEMORY.search(str(e)):
            raise
        print(f"gof {name}: not enough memory ({printable(str(e))[:200]}); close other programs", file=sys.stderr)
        return 1
    except BrokenPipeError:
        raise
    except OSError as e:
        remedy = "make room, or choose another folder, and" if e.errno in DISK else "when that is mended,"
        place = printable(str(e.filename or "a file"))
        print(
            f"gof {name}: {place}: {e.strerror or e}; finished work is kept: {remedy} run the same command again",
            file=sys.stderr,
        )
        return 1
    except KeyboardInterrupt:
        print(f"\ngof {name}: stopped; finished work is kept, the same command resumes", file=sys.stderr)
        return 130


if __name__ == "__main__":
    sys.exit(main())
