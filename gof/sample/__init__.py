"""A small fire that comes with the package: sample.zip, which tools/make_sample.py writes."""

from __future__ import annotations

import os
import zipfile
from importlib import resources
from pathlib import Path

from gof.core.errors import DataFormatError
from gof.core.files import atomic_path, path_in

CHANGED_NS = 315532800 * 10**9  # 1980: a result knows its dataset by the times of change, too
CONTENTS = {
    "fire": "dataset with ground-truth velocity",
    "result": "a finished reconstruction of it",
    "submission": "another method's result, scored",
    "clip": "three films of a fire, with the LED board",
}


def unpack_sample(out: Path) -> tuple[int, int]:
    """Unpack the sample into a folder.

    An interrupted call is finished by the next one: files that are there with the right bytes are kept.

    Args:
        out: folder; made if it is not there.
    Returns:
        How many files the sample has, and their bytes together.
    Raises:
        DataFormatError: a file of the sample's name is there with other bytes; nothing has been written then.
    """
    with resources.as_file(resources.files(__name__) / "sample.zip") as path, zipfile.ZipFile(path) as archive:
        entries = archive.infolist()
        missing = [entry for entry in entries if not _is_there(archive, entry, path_in(out, entry.filename))]
        for entry in missing:
            with atomic_path(path_in(out, entry.filename)) as draft:
                draft.write_bytes(archive.read(entry))
                os.utime(draft, ns=(CHANGED_NS, CHANGED_NS))
    return len(entries), sum(entry.file_size for entry in entries)


def _is_there(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, path: Path) -> bool:
    """Return whether the file is there. Raises DataFormatError: with other bytes."""
    if not path.exists():
        return False
    if path.stat().st_size != entry.file_size or path.read_bytes() != archive.read(entry):
        raise DataFormatError(f"{path}: is there already, and is not the sample's; give another folder")
    return True
