"""Arguments of a command: old names replaced, help shown, options that every command understands taken out, the rest
parsed by tyro."""

from __future__ import annotations

import inspect
import itertools
import re
import shutil
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, TypeVar

import tyro

from gof.commands import everywhere
from gof.commands.declared import Option, first_of, options_of
from gof.commands.renamed import renamed
from gof.core.description import dataset_folder
from gof.core.errors import GofError
from gof.core.ladder import METAVAR

C = TypeVar("C")

# How the text of --out begins, where it is of a folder; else it is of files.
FOLDERS = ("Folder", "Dataset folder")


def read_options(config: type[C], command: str, argv: Sequence[str]) -> C:
    """Return the options of a command, as an object of its config class.

    Args:
        command: the words after `gof`, as "capture sync".
        argv: the words after these.
    Raises:
        SystemExit: after the help (0), or an option is wrong (2).
        GofError: an option is gone (names the one that replaces it), or one of several values is there twice; nothing
            is given to work on.
    """
    if asked_for(argv):
        print(of_command(config, command, whole=WHOLE in argv))
        raise SystemExit(0)
    argv = everywhere.taken_from(renamed(command, list(argv)))
    for option, word in getattr(config, "BARE", {}).items():
        argv = _with_value(argv, option, word)
    _require_once(config, argv)
    found = tyro.cli(config, prog=f"gof {command}", args=argv)
    _require_something(config, command, found)
    named = {field: _folders(vars(found)[field]) for field in {"dataset", "datasets"} & vars(found).keys()}
    found = replace(found, **named) if named else found  # type: ignore[type-var]  # configs are dataclasses
    _require_places(config, found)
    everywhere.require_figures_replaceable(kind.SCHEMA for kind in getattr(config, "FIGURES", ()))
    return found


def _require_once(config: type, argv: Sequence[str]) -> None:
    """Raise GofError where an option of several values stands twice: of the first one's values, none would count."""
    flags = [word.partition("=")[0].replace("_", "-") for word in argv]
    for option in options_of(config):
        if option.several and not option.positional and flags.count(option.name) > 1:
            raise GofError(f"{option.name}: stands there twice; name all of its values behind one {option.name}")


def _require_something(config: type, command: str, found: object) -> None:
    """Raise GofError where a command that takes one or more words got none: for tyro, no word is a list, too."""
    for option in options_of(config):
        if option.positional and option.required and option.several and not getattr(found, option.field):
            _, _, examples = parts_of_docstring(inspect.getdoc(config) or "")
            example = "; for example: " + re.split(r"\s{2,}", examples[0])[0] if examples else ""
            raise GofError(f"name {option.name}{example}")


def _folders(given: Any) -> Any:
    """Return the folder of a dataset, or of several, of which dataset.json may be named; what else is given, as it
    is."""
    if isinstance(given, (tuple, list)):
        return type(given)(map(_folders, given))
    return dataset_folder(given) if isinstance(given, Path) else given


def _require_places(config: type, found: object) -> None:
    """Raise GofError where the folder of --out, or of the files that it names, is a file: now, and not after the
    work."""
    for option in options_of(config):
        if option.field == "out" and (out := vars(found)["out"]):
            for path in [out] if isinstance(out, Path) else out:
                folder = path if option.text.startswith(FOLDERS) else path.absolute().parent
                everywhere.require_folder(folder, option.name)


def _with_value(argv: list[str], option: str, word: str) -> list[str]:
    """Return the arguments, where an option that stands alone has the value that it means then."""
    found = []
    for argument, after in itertools.zip_longest(argv, argv[1:], fillvalue="--"):
        found += [argument, word] if argument == option and after.startswith("--") else [argument]
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
    """Return the given name of each result, None for that of its folder or file, and its path."""
    found: list[tuple[str | None, Path]] = []
    for word in words:
        name, equals, path = word.partition("=")
        plain = not equals or not name or Path(word).exists()
        found.append((None, Path(word)) if plain else (name, Path(path)))
    return found


SHORT, WHOLE = ("-h", "--help"), "--help-all"
MOST = 8  # options on a first screen
EXAMPLES = "Examples:"  # the line of a config class' docstring that begins them
LEAST_COLUMNS, MOST_COLUMNS, BEGIN = 60, 110, 24


def asked_for(argv: Sequence[str]) -> bool:
    """Return whether a command line requests help."""
    return any(word in (*SHORT, WHOLE) for word in argv)


def of_command(config: type, command: str, whole: bool = False) -> str:
    """Return the help screen of a command.

    Args:
        whole: with all options and everything that the docstring says.
    """
    summary, more, examples = parts_of_docstring(inspect.getdoc(config) or "")
    options = options_of(config)
    arguments = [option for option in options if option.positional]
    named = [option for option in options if not option.positional]
    first = named if whole else first_of(config)
    words = [command, *(_shown(argument) for argument in arguments), *["[OPTIONS]"] * bool(named)]
    parts = [f"usage: gof {' '.join(words)}", _filled(summary)]
    if examples:
        parts.append("examples:\n" + "\n".join(f"  {line}" for line in examples))
    if whole and more:
        parts.append("\n\n".join(map(_filled, more)))
    if arguments:
        parts.append(_listed((argument.name, _help_of(argument)) for argument in arguments))
    if first:
        parts.append("options:\n" + _listed((_called(option), _help_of(option)) for option in first))
    for title, kind in getattr(config, "MORE", {}).items() if whole else ():
        keys = [
            (f"{option.field}{option.value and '=' + option.value}", _help_of(option)) for option in options_of(kind)
        ]
        parts.append(f"{title}:\n{_listed(keys)}")
    if whole:
        parts.append("for every command:\n" + _listed(everywhere.OPTIONS.items()))
    hidden = len(named) - len(first)
    end = f"{hidden} more option{'s' * (hidden > 1)}: gof {command} {WHOLE}. " if hidden else ""
    if not whole:
        end += f"Every command takes {', '.join(everywhere.OPTIONS)}."
    return "\n\n".join([*parts, *([_filled(end)] if end else [])])


def parts_of_docstring(text: str) -> tuple[str, list[str], list[str]]:
    """Return a docstring's first paragraph, the others, and its examples."""
    text, _, examples = text.partition(f"{EXAMPLES}\n")
    first, *more = [" ".join(part.split()) for part in text.strip().split("\n\n")]
    lines, _, after = examples.partition("\n\n")
    more += [" ".join(part.split()) for part in after.split("\n\n") if part.strip()]
    return first, more, [line.strip() for line in lines.splitlines() if line.strip()]


def _shown(argument: Option) -> str:
    return argument.name if argument.required else f"[{argument.name}]"


def _called(option: Option) -> str:
    return f"{option.name} {option.value}{' ...' if option.several else ''}".rstrip()


def _help_of(option: Option) -> str:
    end = " (required)" if option.required and not option.positional else ""
    end = f" (default: {option.default})" if option.default else end
    return f"{option.text}{end}"


def _columns() -> int:
    return min(max(shutil.get_terminal_size((100, 24)).columns, LEAST_COLUMNS), MOST_COLUMNS)


def _filled(text: str) -> str:
    return textwrap.fill(text, _columns(), break_on_hyphens=False)


def _listed(rows: Iterable[tuple[str, str]]) -> str:
    """Return two columns; a long name has a line of its own."""
    lines = []
    for name, text in rows:
        body = textwrap.wrap(text, _columns() - BEGIN, break_on_hyphens=False, break_long_words=False) or [""]
        if len(name) > BEGIN - 4:
            lines.append(f"  {name}")
        else:
            lines.append(f"  {name:<{BEGIN - 2}}{body.pop(0)}".rstrip())
        lines += [" " * BEGIN + line for line in body]
    return "\n".join(lines)
