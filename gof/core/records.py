"""Records: what crosses a room, a process or the disk as JSON is one frozen dataclass with one reader and one writer.

A record is a frozen dataclass with class variables `SCHEMA` and `VERSION`; its file is a JSON object of its fields
beside `"schema"` and `"version"`. A field named like a Python keyword has a trailing underscore that its key in the
file has not (`import_`, "import"). Fields are checked against their types on reading, so that a wrong file fails by
name, when it is read.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any, ClassVar, Protocol, TypeVar

from .checked_json import from_dict
from .errors import DataFormatError, GofError
from .files import read_json, write_json


class Record(Protocol):
    SCHEMA: ClassVar[str]
    VERSION: ClassVar[int]
    __dataclass_fields__: ClassVar[dict[str, Any]]


R = TypeVar("R", bound=Record)
T = TypeVar("T")


def to_json(record: Record) -> dict[str, Any]:
    """Return the JSON form of a record: its fields under its schema and version; tuples become lists."""
    content = {name.removesuffix("_"): _plain(value) for name, value in asdict(record).items()}
    return {"schema": record.SCHEMA, "version": record.VERSION} | content


def _plain(value: Any) -> Any:
    """Return a value as JSON gives it back."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, (list, tuple)) else value


def from_json(kind: type[R], data: Any, source: str | Path, ignore_unknown: bool = True) -> R:
    """Build a record from its JSON form.

    Args:
        source: what to name in errors, usually the file.
        ignore_unknown: leave fields aside that this version does not know, as those of newer writers.
    Raises:
        DataFormatError: another schema or version, an unknown or a missing field, one of the wrong type (names it).
    """
    if not isinstance(data, dict) or data.get("schema") != kind.SCHEMA or data.get("version") != kind.VERSION:
        raise DataFormatError(f"{source}: not schema '{kind.SCHEMA}' version {kind.VERSION}")
    return convert_json(kind, data, source, ignore_unknown)


def convert_json(kind: type[T], data: Any, source: str | Path, ignore_unknown: bool = False) -> T:
    """Build a dataclass from the JSON of a file that people write by hand, with or without schema and version.

    Raises:
        DataFormatError: not an object, an unknown or a missing field, one of the wrong type (names it).
    """
    if not isinstance(data, dict):
        raise DataFormatError(f"{source}: not a JSON object")
    try:
        return from_dict(kind, {k: v for k, v in data.items() if k not in ("schema", "version")}, "", ignore_unknown)
    except GofError as e:  # of a field; of the record's own checks
        raise DataFormatError(f"{source}: {e}") from e


def read_record(kind: type[R], path: Path) -> R:
    """Read a record's file. Raises DataFormatError as `from_json`, or when the file is absent or not JSON."""
    return from_json(kind, read_json(path), path)


def write_record(path: Path, record: Record) -> None:
    """Write a record's file atomically; NaN and Inf are refused (None says "undefined")."""
    write_json(path, to_json(record))


def claim(path: Path, record: Record, made: Path, called: Callable[[str], str] = str) -> None:
    """Write what something is made with beside it, or make sure that it is made with the same.

    Args:
        path: of the record.   made: the file whose presence means that the folder is finished.
        called: the option of a field's name, for people.
    Raises:
        GofError: it was made with other settings (named), or by an older version that did not write them down.
    """
    if (other := other_settings(path, record, made, called)) is not None:
        raise GofError(f"{other}; choose another --out or remove the folder")
    if not path.exists():
        write_record(path, record)


def is_replaced(path: Path, record: Record, made: Path, overwrite: bool, called: Callable[[str], str] = str) -> bool:
    """Return whether what stands in a folder was made with other settings, and is to be replaced: as `claim`, but
    nothing is written, and a folder that the record's own command has written to can be taken over.

    Raises:
        GofError: it was made with other settings, and `overwrite` is not set or another command's files are there.
    """
    if (other := other_settings(path, record, made, called)) is None:
        return False
    if _is_of(type(record), path):
        if overwrite:
            return True
        raise GofError(f"{other}; choose another --out, or replace it with --overwrite")
    raise GofError(f"{other}; choose another --out or remove the folder")


def other_settings(path: Path, record: Record, made: Path, called: Callable[[str], str]) -> str | None:
    """Return, in words, with which other settings a folder was begun or made; None where there are no others."""
    if not path.exists() and not made.exists():
        return None
    try:
        before = asdict(read_record(type(record), path))
    except DataFormatError as e:
        return f"{e}; what is in {path.parent} was made by an older version"
    changed = [called(name) for name, value in asdict(record).items() if value != before[name]]
    if not changed:
        return None
    begun = f"{made.name} there is made" if made.exists() else "a run that was stopped there was begun"
    return f"{path.parent}: {begun} with other settings ({', '.join(sorted(changed))} differ)"


def _is_of(kind: type[Record], path: Path) -> bool:
    """Return whether a file is a record of this kind, of whatever version."""
    try:
        content = read_json(path)
    except DataFormatError:
        return False
    return isinstance(content, dict) and content.get("schema") == kind.SCHEMA
