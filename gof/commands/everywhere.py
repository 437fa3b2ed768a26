"""Options that every command understands: --json FILE, --quiet, --verbose and --overwrite, before or after its name.

Defined once. `cli.main` takes them out of the command line; a command that is called by itself (`main(argv)` of its
module) takes out its own. Commands ask here where their figures go, and whether a file may be replaced.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from gof.core.errors import GofError
from gof.core.files import as_json, holds_content, read_json, write_json
from gof.host.terminal import QUIET_VARIABLE

DEBUG_VARIABLE, FAULTS = "GOF_DEBUG", "faults"  # with this value for faults of ours alone, as tests have it

OPTIONS = {  # as help shows them
    "--json FILE": "also write the command's figures to this file",
    "--quiet": "print errors and warnings only",
    "--verbose": f"also print the traceback of an error, as {DEBUG_VARIABLE}=1 does",
    "--overwrite": "replace existing output that cannot be resumed",
}


@dataclass(frozen=True)
class Everywhere:
    """The four options as given."""

    json: Path | None = None
    quiet: bool = False
    verbose: bool = False
    overwrite: bool = False


_of_main: Everywhere | None = None  # of the `gof` command that is running
_given = Everywhere()  # of the command that is running
_written = False  # whether it has written its figures


def split(argv: list[str]) -> tuple[list[str], Everywhere]:
    """Return the other words, and what these options say. Raises GofError: --json without a file."""
    words, given = iter(argv), Everywhere()
    rest: list[str] = []
    for word in words:
        if word == "--":
            return [*rest, word, *words], given
        if word == "--json" or word.startswith("--json="):
            equals, file = word.partition("=")[1:]
            file = file if equals else next(words, "")
            if not file or (not equals and file.startswith("--")):
                raise GofError("--json: name the file to write the figures to")
            given = replace(given, json=Path(file))
        elif word in ("--quiet", "--verbose", "--overwrite"):
            switch: dict[str, Any] = {word[2:]: True}
            given = replace(given, **switch)
        else:
            rest.append(word)
    return rest, given


@contextlib.contextmanager
def of_main(given: Everywhere) -> Iterator[None]:
    """Work under these options until the block ends: they hold for every part of the command, and its children."""
    global _of_main, _given, _written
    _of_main, _given, _written = given, given, False
    try:
        with contextlib.ExitStack() as stack:
            if given.quiet:
                stack.enter_context(_variable(QUIET_VARIABLE))
                stack.enter_context(contextlib.redirect_stdout(stack.enter_context(open(os.devnull, "w"))))
            if given.verbose:
                stack.enter_context(_variable(DEBUG_VARIABLE))
            yield
    finally:
        _of_main, _given = None, Everywhere()


def taken_from(argv: list[str]) -> list[str]:
    """Return the words without these options, which hold from now on."""
    global _given, _written
    rest, own = split(argv)
    if _of_main is None:
        _given, _written = own, False
    elif own != Everywhere():
        _given = replace(_of_main, **{k: v for k, v in vars(own).items() if v})
    return rest


def require_figures_replaceable(schemas: Iterable[str]) -> None:
    """Make sure, before any work, that the file of --json can be written, and that only older figures go with it.

    Args:
        schemas: of the records that this command writes as its figures; a file of one of them is replaced.
    Raises:
        GofError: it is a folder, lies in what is none, or holds anything but figures and --overwrite was not given.
    """
    if (file := _given.json) is None:
        return
    require_folder(file.absolute().parent, "--json")
    if file.is_dir():
        raise GofError(f"--json {file}: is a folder; name a file in it")
    if holds_content(file) and not _given.overwrite and not _holds_figures(file, schemas):
        raise GofError(
            f"--json {file}: is there already and holds no figures of this command; name the file to write them to "
            "behind --json, or replace this one with --overwrite"
        )


def require_folder(folder: Path, option: str = "--out") -> None:
    """Make sure, before any work, that a folder is one or can become one.

    Raises:
        GofError: it is a file, or lies in one (names the file and the option).
    """
    for place in (folder, *folder.parents):
        if place.is_dir():
            return
        if place.exists():
            raise GofError(f"{option}: {place} is a file, where a folder is needed; name another place")


def _holds_figures(file: Path, schemas: Iterable[str]) -> bool:
    """Return whether a file is JSON as `write_json` writes it, without a schema or with one of these.

    Files that people write by hand are laid out in another way.
    """
    with file.open("rb") as stream:
        if stream.read(1) not in (b"{", b"["):  # films may have gigabytes
            return False
    try:
        content = read_json(file)
        as_written = file.read_bytes() == as_json(content).encode()
    except GofError:
        return False
    schema = content.get("schema") if isinstance(content, dict) else None
    return as_written and (schema is None or schema in schemas)


def write_figures(figures: Any) -> None:
    """Write a command's figures, a record or what JSON can hold, to the file of --json; nothing without that option."""
    if (file := figures_file()) is None:
        return
    from gof.core.records import write_record

    if hasattr(figures, "SCHEMA"):
        write_record(file, figures)
    else:
        write_json(file, figures)


def figures_file() -> Path | None:
    """Return the file of --json, for a command that writes its figures itself."""
    global _written
    _written = True
    return _given.json


def figures_left_out() -> Path | None:
    """Return the file of --json, where the command has written no figures to it."""
    return None if _written else _given.json


def may_overwrite() -> bool:
    """Return whether --overwrite was given."""
    return _given.overwrite


def require_free(*paths: Path) -> None:
    """Make sure that files which a user has named are not there yet, or may be replaced; a device or a pipe always may.

    Raises:
        GofError: one is there, and --overwrite was not given (says so).
    """
    for path in paths:
        if holds_content(path) and not _given.overwrite:
            raise GofError(f"{path}: is there already; give --out another name, or replace it with --overwrite")


def beside(source: Path, name: str) -> Path:
    """Return a file or folder of that name beside a file, or inside a folder: where a command writes without --out.

    Raises:
        GofError: nothing can be written there.
    """
    folder = source if source.is_dir() else source.absolute().parent
    return require_writable(folder) / name


def next_to(dataset: Path, suffix: str) -> Path:
    """Return a folder beside that of a dataset, NAME + suffix: for what is made of the dataset. Raises as `beside`."""
    place = dataset.absolute()
    return require_writable(place.parent) / f"{place.name}{suffix}"


def require_writable(folder: Path) -> Path:
    """Return the folder. Raises GofError: nothing can be written there."""
    if folder.is_dir() and not os.access(folder, os.W_OK):
        raise GofError(f"{folder}: cannot be written to; name another place with --out")
    return folder


@contextlib.contextmanager
def _variable(name: str) -> Iterator[None]:
    """Set an environment variable to 1, for child processes too."""
    before = os.environ.get(name)
    os.environ[name] = "1"
    try:
        yield
    finally:
        if before is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = before
