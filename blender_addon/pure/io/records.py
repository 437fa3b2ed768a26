"""Records: what this add-on shares with others as JSON is one frozen dataclass, with one reader and one writer.

A record has the class variables `SCHEMA` and `VERSION`; its file is a JSON object of its fields beside `"schema"` and
`"version"`. `gof.core.records` is the library's own form of the same; this one needs nothing but the standard library.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any, ClassVar, Protocol, TypeVar

from ...core.checked_json import SpecError, from_dict
from . import FileFormatError
from .files import read_json, write_json


class Record(Protocol):
    SCHEMA: ClassVar[str]
    VERSION: ClassVar[int]


R = TypeVar("R", bound=Record)


def read_record(kind: type[R], path: Path) -> R:
    """Read a record's file; fields that this version does not know are left aside.

    Raises:
        FileFormatError: the file is absent or not JSON, of another schema or version, or a field is missing or of the
            wrong type (names file and field).
    """
    data = read_json(path)
    if not isinstance(data, dict) or data.get("schema") != kind.SCHEMA or data.get("version") != kind.VERSION:
        raise FileFormatError(f"{path}: not schema '{kind.SCHEMA}' version {kind.VERSION}")
    try:
        return from_dict(kind, data, "", ignore_unknown=True)
    except SpecError as error:
        raise FileFormatError(f"{path}: {error}") from None


def write_record(path: Path, record: Record) -> None:
    """Write a record's file, atomically."""
    write_json(path, to_json(record))


def to_json(record: Record) -> dict[str, Any]:
    """The JSON form of a record: its fields under its schema and version."""
    return {"schema": record.SCHEMA, "version": record.VERSION, **dataclasses.asdict(record)}
