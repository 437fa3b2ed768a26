"""Records: what crosses a room, a process or the disk as JSON is one frozen dataclass with one reader and one writer.

A record is a frozen dataclass with class variables `SCHEMA` and `VERSION`; its file is a JSON object of its fields
beside `"schema"` and `"version"`. A field named like a Python keyword has a trailing underscore that its key in the
file has not (`import_`, "import"). Fields are checked against their types on reading, so that a wrong file fails at the
door, and by name.
"""

from __future__ import annotations

from dataclasses import asdict, fields, is_dataclass
from keyword import iskeyword
from pathlib import Path
from typing import Any, ClassVar, Protocol, TypeVar, get_args, get_type_hints

import msgspec

from .errors import DataFormatError, GofError
from .files import read_json, write_json


class Record(Protocol):
    SCHEMA: ClassVar[str]
    VERSION: ClassVar[int]


R = TypeVar("R", bound=Record)
T = TypeVar("T")


def to_json(record: Record) -> dict[str, Any]:
    """The JSON form of a record: its fields under its schema and version; tuples become lists."""
    content = {name.removesuffix("_"): value for name, value in asdict(record).items()}
    return {"schema": record.SCHEMA, "version": record.VERSION} | msgspec.to_builtins(content)


def from_json(kind: type[R], data: Any, source: str | Path) -> R:
    """Build a record from its JSON form; fields this version does not know are left aside.

    Args:
        source: what to name in errors, usually the file.
    Raises:
        DataFormatError: another schema or version, a missing field, a field of the wrong type (names it).
    """
    if not isinstance(data, dict) or data.get("schema") != kind.SCHEMA or data.get("version") != kind.VERSION:
        raise DataFormatError(f"{source}: not schema '{kind.SCHEMA}' version {kind.VERSION}")
    return _converted(kind, data, source)


def convert_json(kind: type[T], data: Any, source: str | Path) -> T:
    """Build a dataclass from the JSON of a file that people write by hand, without schema and version.

    Raises:
        DataFormatError: not an object, a field there is not, a missing one, or one of the wrong type (names it).
    """
    refuse_unknown(kind, data, source)
    return _converted(kind, data, source)


def refuse_unknown(kind: Any, data: Any, source: str | Path, at: str = "") -> None:
    """Raises DataFormatError: JSON by hand has a field that a dataclass, or one inside it, has not (names it)."""
    if is_dataclass(kind) and isinstance(data, dict):
        hints = {name.removesuffix("_"): hint for name, hint in get_type_hints(kind).items()}
        known = [field.name.removesuffix("_") for field in fields(kind)]
        unknown = sorted(set(data) - set(known) - ({"schema", "version"} if not at else set()))
        if unknown:
            raise DataFormatError(
                f"{source}: '{at}{unknown[0][:80]}' is no field that is read here; there are {', '.join(known)}"
            )
        for name in known:
            refuse_unknown(hints[name], data.get(name), source, f"{at}{name}.")
        return
    for inner in get_args(kind):
        for part in data if isinstance(data, list) else data.values() if isinstance(data, dict) else ():
            refuse_unknown(inner, part, source, at)


def _converted(kind: type[T], data: Any, source: str | Path) -> T:
    if not isinstance(data, dict):
        raise DataFormatError(f"{source}: not a JSON object")
    try:
        return msgspec.convert({f"{key}_" if iskeyword(key) else key: value for key, value in data.items()}, kind)
    except (msgspec.ValidationError, GofError) as e:  # of a field; of the record's own checks
        raise DataFormatError(f"{source}: {e}") from e


def read_record(kind: type[R], path: Path) -> R:
    """Read a record's file. Raises DataFormatError as `from_json`, or when the file is absent or not JSON."""
    return from_json(kind, read_json(path), path)


def write_record(path: Path, record: Record) -> None:
    """Write a record's file atomically; NaN and Inf are refused (None says "undefined")."""
    write_json(path, to_json(record))


def claim(path: Path, record: Record, made: Path) -> None:
    """Write what something is made with beside it, or make sure that it is made with the same.

    Args:
        path: of the record.   made: the file that tells that it is finished.
    Raises:
        GofError: it was made with other settings (named), or by an older version that did not write them down.
    """
    if not path.exists() and not made.exists():
        write_record(path, record)
        return
    try:
        before = asdict(read_record(type(record), path))
    except DataFormatError as e:
        raise GofError(
            f"{e}; what is in {path.parent} was made by an older version: choose another --out or remove the folder"
        ) from e
    changed = sorted(name for name, value in asdict(record).items() if value != before[name])
    if changed:
        raise GofError(
            f"{path.parent}: {made.name} there is made with other settings ({', '.join(changed)} differ); "
            "choose another --out or remove the folder"
        )
