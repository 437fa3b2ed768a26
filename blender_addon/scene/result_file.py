"""The file from which a cloud was imported. A .blend stores its name, and only folders below its own.

Who gets the .blend learns nothing of the disk of its author, and what is found is that very file: one of the same
name that holds something else is refused.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

import bpy

from ..core.errors import DataFormatError
from ..pure.io import cloud as clouds

FILE, SUM = "gof_source", "gof_source_sum"  # custom properties of a cloud
END = 2**16  # bytes at either end of a file that are looked at
_here: dict[str, Path] = {}  # where the files are that this process has imported, by their sums


def keep(object_: bpy.types.Object, source: list[Path]) -> None:
    """Note what a cloud was made of: a file, or the numbered files of one folder."""
    path = (source[0] if len(source) == 1 else source[0].parent).resolve()
    object_[SUM] = _sum(source)
    _here[object_[SUM]] = path
    home = _home()
    object_[FILE] = path.relative_to(home).as_posix() if home and path.is_relative_to(home) else path.name


def known(object_: bpy.types.Object) -> bool:
    """Return whether there is a file where a cloud's was; quick, for panels."""
    return any(path.exists() for path in _places(object_))


def find(object_: bpy.types.Object, chosen: str = "") -> Path:
    """Return the file, or the folder, that a cloud was imported from.

    Args:
        chosen: by the user; "" looks where it was imported from in this session, and from the .blend on.
    Raises:
        DataFormatError: it is not there, or another one is.
    """
    if FILE not in object_:
        raise DataFormatError(f"{object_.name}: not imported from a file; import the reconstruction again")
    places = [Path(bpy.path.abspath(chosen)).absolute()] if chosen else _places(object_)
    existing = [path for path in places if path.exists()]
    if not existing:
        where = places[0] if chosen else f"{Path(object_[FILE]).name}, which {object_.name} was imported from"
        raise DataFormatError(f"{where}: no such file here; choose it as Result in the panel Score")
    for path in existing:
        if SUM not in object_ or _sum(clouds.files_of(path)) == object_[SUM]:
            return path
    raise DataFormatError(
        f"{existing[0]}: has changed since {object_.name} was imported, or is another file; import it again, or choose "
        "the right one as Result"
    )


def _places(object_: bpy.types.Object) -> list[Path]:
    found = [_here[object_[SUM]]] if object_.get(SUM) in _here else []
    file = Path(object_.get(FILE, ""))
    if file.name and (_home() or file.is_absolute()):  # older versions of the add-on kept the whole path
        found.append((_home() or Path()) / file)
    return found


def _home() -> Path | None:
    """Return the folder of the .blend, once it has been saved."""
    return Path(bpy.data.filepath).resolve().parent if bpy.data.filepath else None


def _sum(files: list[Path]) -> str:
    """Return a digest of the sizes and both ends of files: a result that was written again differs everywhere."""
    found = hashlib.sha256()
    for path in files:
        size = path.stat().st_size
        with path.open("rb") as file:
            found.update(f"{size} ".encode() + file.read(END))
            file.seek(max(size - END, 0))
            found.update(file.read(END))
    return found.hexdigest()[:32]
