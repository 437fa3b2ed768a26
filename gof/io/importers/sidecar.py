"""RESULT.gof.json: what a result's files do not say about themselves, written down once beside it and read by all."""

from __future__ import annotations

import os
from collections.abc import Collection
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import ClassVar

from gof.core.files import without_place
from gof.core.records import read_record, write_record
from gof.io.importers.source import ImportOptions, WorldBy

ENDING = ".gof.json"


@dataclass(frozen=True)
class ImportSidecar:
    """The file of a result; fields as of `ImportOptions`. `world` counts from its folder."""

    SCHEMA: ClassVar[str] = "gof-import"
    VERSION: ClassVar[int] = 1

    time_unit_s: float | None = None
    time_zero_s: float = 0.0
    frame_time_s: float | None = None
    world: str | None = None
    world_by: WorldBy | None = None
    code_date: str | None = None
    flame_only: bool = False
    emissive: bool = False


FIELDS = tuple(field.name for field in fields(ImportSidecar))


def file_of(result: Path) -> Path:
    """Return the file beside a result's file or folder."""
    result = result.absolute()
    return result.with_name(result.name + ENDING)


def write_sidecar(result: Path, options: ImportOptions) -> Path:
    """Write the file of a result, and return its path; an older one is replaced."""
    path = file_of(result)
    world = None if options.world is None else without_place(options.world, path.parent)
    write_record(
        path, ImportSidecar(**{name: getattr(options, name) for name in FIELDS if name != "world"}, world=world)
    )
    return path


def with_sidecar(
    result: Path, options: ImportOptions, given: Collection[str] = ()
) -> tuple[ImportOptions, Path | None]:
    """Return options of a result: what the caller does not give is as its file says; and that file, where it has a
    part.

    Args:
        given: fields that the caller gives, whatever their value.
    Raises:
        DataFormatError: the file is damaged.   GofError: see `ImportOptions`.
    """
    path = file_of(result)
    if not path.is_file():
        return options, None
    record = read_record(ImportSidecar, path)
    values = {name: getattr(record, name) for name in FIELDS}
    if record.world is not None:
        values["world"] = Path(os.path.normpath(path.parent / record.world))
    asked = {name for name in values if getattr(options, name)}.union(given)
    missing = {name: value for name, value in values.items() if value and name not in asked}
    return (replace(options, **missing), path) if missing else (options, None)


def in_words(path: Path, options: ImportOptions) -> str:
    """Return a note for people: what was taken from the file."""
    values = {name: getattr(options, name) for name in FIELDS}
    return f"as {path.name} says: " + ", ".join(
        f"{name.removesuffix('_s').replace('_', ' ')} {value:g} s"
        if name.endswith("_s")
        else f"{name.replace('_', ' ')} {value}"
        if value is not True
        else name.replace("_", " ")
        for name, value in values.items()
        if value
    )
