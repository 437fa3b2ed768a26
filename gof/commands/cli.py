"""The `gof` command: lists the commands, loads only the command that is run, and prints errors that say what to do."""

from __future__ import annotations

import errno
import importlib
import io
import os
import re
import sys
import traceback
from functools import cache
from importlib.metadata import PackageNotFoundError, entry_points, metadata

from gof import __version__
from gof.commands import COMMANDS, GROUPS, HELP_WORDS, Command, everywhere, no_such, renamed
from gof.commands.everywhere import DEBUG_VARIABLE, FAULTS
from gof.core.errors import GofError, in_words, printable
from gof.core.files import follow_links_of

# Faults of a user's disk that can end a run.
DISK = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EROFS, errno.EACCES, errno.EPERM)

FAULT = 70  # the exit status is sysexits.h's of an internal fault

# Libraries say it in their own ways where Python's MemoryError does not come through.
NO_MEMORY = re.compile(
    r"out of memory|not enough memory|can(not|'t) allocate memory|failed to (map segment|allocate)|bad_alloc", re.I
)

HELP = """\
gof {version} - Gaussians on Fire: a flame from synchronised videos as moving 3D Gaussians with velocities in m/s.

usage: gof COMMAND [OPTIONS]        gof help COMMAND, or gof COMMAND --help, explains one command

the loop, step by step (start without Blender: gof sample unpacks a fire with its truth, a result and three films):
  gof generate demo --out data/fire                     a dataset: pictures, cameras, velocity in m/s
  gof reconstruct data/fire --out out/fire              out/fire/result.ply and result.npz
  gof evaluate out/fire --dataset data/fire             L2 and CosSim, and out/fire/scores.json
  gof import out/fire --dataset data/fire               out/fire/result.blend, and a rendered preview
  gof report out/fire --dataset data/fire               out/fire/report.html

commands:
{commands}

for every command, before or after its name:
{everywhere}

Run a stopped command again and it continues. A finished file is kept unless --overwrite.
Pages named docs/NAME.md are in the source's folder docs, which packages do not contain.
{ask}
"""
PROJECT = "gaussians-on-fire"


@cache
def commands() -> dict[str, Command]:
    """Return every command by name, by groups: gof's own, and those of installed packages (`gof.commands`)."""
    found = dict(COMMANDS)
    for table in entry_points(group="gof.commands"):
        found |= table.load()
    order = list(GROUPS)
    return dict(sorted(found.items(), key=lambda item: order.index(item[1].group)))


def where_to_ask() -> str:
    """Return a line with the address for questions; "" where the package names none."""
    try:
        urls = metadata(PROJECT).get_all("Project-URL") or []
    except PackageNotFoundError:
        return ""
    found = dict(url.split(", ", 1) for url in urls)
    return f"Questions and faults: {found['Issues']}" if "Issues" in found else ""


def overview() -> str:
    """`gof --help`."""
    lines = []
    for group, more in GROUPS.items():
        members = {name: command for name, command in commands().items() if command.group == group}
        lines += [f" {group}{more and ', ' + more}"]
        lines += [f"  {name:<12} {command.help}" for name, command in members.items()]
    options = "\n".join(f"  {option:<12} {text}" for option, text in everywhere.OPTIONS.items())
    return HELP.format(version=__version__, commands="\n".join(lines), everywhere=options, ask=where_to_ask()).rstrip()


def main(argv: list[str] | None = None) -> int:
    """Run one command. Returns the exit status: 0 done, 1 a named error, 2 wrong usage, 70 a fault of ours, 130 Ctrl-C.

    --verbose and $GOF_DEBUG show the traceback of an error, and raise a fault.
    """
    argv = sys.argv[1:] if argv is None else argv
    # Read when numpy is loaded. Commands work on frames side by side, and BLAS' own threads would keep cores from them.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        try:
            return _main(argv)
        except OSError as e:
            _require_output(e)
            raise
        finally:
            _say_now()  # here, where a failure has its words, and not when Python ends
    except BrokenPipeError:  # who reads our output has seen enough
        _say_no_more()
        return 1
    except OutputError as e:
        _say_no_more()
        print(f"gof: standard output: {e}; files that the command has written are there", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    except Exception as e:
        if os.environ.get(DEBUG_VARIABLE) or "--verbose" in argv:
            raise
        print(_fault(e, argv), file=sys.stderr)
        return FAULT


class OutputError(Exception):
    """Standard output takes no more, for another reason than that its reader has gone."""


def _say_now(more: bytes = b"") -> None:
    """Write what is in the buffer of standard output, and more. Raises OutputError: it cannot be written."""
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
            if more:
                os.write(sys.stdout.fileno(), more)
    except BrokenPipeError:
        raise
    except io.UnsupportedOperation:  # no file is behind it
        pass
    except (OSError, ValueError) as e:  # the second: somebody has closed it
        raise OutputError(getattr(e, "strerror", None) or e) from e


def _require_output(error: OSError) -> None:
    """Raise OutputError where an error that names no file is that of standard output, which then fails again.

    A failed write leaves the buffer empty, so an empty line is written.
    """
    if error.filename is None and not isinstance(error, BrokenPipeError):
        _say_now(b"\n")


def _say_no_more() -> None:
    """Python would complain when it empties its buffers at the end."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _fault(error: Exception, argv: list[str]) -> str:
    """Return one line on an unforeseen error, with what helps to find it."""
    frames = traceback.extract_tb(error.__traceback__)
    where = f"{os.path.basename(frames[-1].filename)}:{frames[-1].lineno}" if frames else "an unknown place"
    message = " ".join(printable(str(error)).split())[:200]
    return (
        f"gof {argv[0] if argv else ''}: an error in gof itself, not in your input: "
        f"{type(error).__name__} at {where}: {message}. "
        f"Please report it with what gof doctor prints, and with what the same command prints after {DEBUG_VARIABLE}=1"
    )


def _main(argv: list[str]) -> int:
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")  # a terminal that cannot show a letter ends no run
    try:
        folder = os.getcwd()
    except OSError:
        if argv and not {"-h", "--help", "--help-all", "help", "--version"} & set(argv):
            print("gof: the current folder has been deleted; cd to one that exists", file=sys.stderr)
            return 1
        folder = ""
    odd = next((word for word in (*argv, folder) if not word.isascii() and _is_not_utf8(word)), None)
    if odd is not None:
        print(
            f"gof: {printable(odd)!r} is not UTF-8; rename that file or folder, or set LC_ALL=C.UTF-8", file=sys.stderr
        )
        return 2
    try:
        argv, given = _without_everywhere(argv)
    except GofError as e:
        print(f"gof: {e}", file=sys.stderr)
        return 2
    if argv[:1] == ["help"] and argv[1:]:
        argv = [*argv[1:], "--help"]
    if not argv or argv[0] in HELP_WORDS:
        print(overview())
        return 0
    if argv[0] == "--version":
        print("\n".join(line for line in (f"gof {__version__}", where_to_ask()) if line))
        return 0
    name, *rest = argv
    if name in renamed.COMMANDS:
        new = renamed.COMMANDS[name]
        print(f"gof {name} is now gof {new}; the old name goes with the next version", file=sys.stderr)
        name = new
    if name not in commands():
        print(f"gof: {no_such('command', name, commands())}", file=sys.stderr)
        return 2
    if given.json is not None and not commands()[name].figures:
        print(f"gof {name}: writes no figures; leave out --json", file=sys.stderr)
        return 2
    follow_links_of([*rest, *([str(given.json)] if given.json else [])])
    with everywhere.of_main(given):
        status = run(name, rest)
        if status == 0 and (file := everywhere.figures_left_out()) is not None:
            print(f"gof {name}: has no figures to write to {file}", file=sys.stderr)
    return status


def _without_everywhere(argv: list[str]) -> tuple[list[str], everywhere.Everywhere]:
    """Return the command line without the options that every command understands, and these.

    Where a command passes words to another program, only those before that program's name are ours.
    """
    name = next((k for k, word in enumerate(argv) if word in commands() and commands()[word].foreign), len(argv))
    words, given = everywhere.split(argv[:name])
    return [*words, *argv[name:]], given


def _is_not_utf8(word: str) -> bool:
    """Return bytes that are no text come as halves of characters."""
    return any("\ud800" <= c <= "\udfff" for c in word)


def run(name: str, argv: list[str]) -> int:
    """Run a command with its own arguments, and say what stopped it in words that help."""
    try:
        return importlib.import_module(commands()[name].module).main(argv) or 0
    except GofError as e:
        if os.environ.get(DEBUG_VARIABLE, FAULTS) != FAULTS:
            traceback.print_exc()
        print(f"gof {name}: {in_words(e)}", file=sys.stderr)
        return 1
    except MemoryError as e:
        print(
            f"gof {name}: not enough memory ({e or 'it does not say for what'}); smaller pictures or fewer Gaussians "
            "need less, see --help",
            file=sys.stderr,
        )
        return 1
    except BrokenPipeError:
        raise
    except Exception as e:
        if shortage := _words_on_memory(e):
            print(f"gof {name}: not enough memory ({printable(shortage)[:200]}); close other programs", file=sys.stderr)
            return 1
        if not isinstance(e, OSError):
            raise
        _require_output(e)
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


def _words_on_memory(error: BaseException | None) -> str | None:
    """Return the words on memory of an error, or of one that it was raised on: a library that cannot be loaded breaks
    others."""
    while error is not None:
        library = isinstance(error, ImportError) and "temporarily unavailable" in str(error)  # as dlopen says it
        if library or NO_MEMORY.search(str(error)):
            return " ".join(str(error).split())
        error = error.__cause__ or error.__context__
    return None


if __name__ == "__main__":
    sys.exit(main())
