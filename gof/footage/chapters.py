"""A camera's recording in several files, its chapters, known by their names.

GoPro cameras begin a new file every few minutes, as its "Camera File Naming Convention" has it: GX010042.MP4 goes on in
GX020042.MP4 (H: AVC, X: HEVC, then the chapter and the film's number), on cameras up to the HERO5 GOPR0042.MP4 in
GP010042.MP4. Looping videos (GHAA0001) are no chapters: the camera writes over the oldest.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path, PurePath

from gof.core.errors import DataFormatError

NEW = re.compile(r"(G[HXLS])(?!00)([0-9]{2})([0-9]{4})", re.I)
OLD = re.compile(r"(?:GOPR|GP(?!00)([0-9]{2}))([0-9]{4})", re.I)


@dataclass(frozen=True)
class Chapter:
    """A place in a recording, by a file's name.

    Attributes:
        recording: same for all of its chapters in a folder.
        number: from 1 on.
    """

    recording: str
    number: int


def chapter_named(name: str) -> Chapter | None:
    """Return which recording a file belongs to by its name, and which chapter of it it is; None for other names."""
    stem, suffix = PurePath(name).stem, PurePath(name).suffix.lower()
    if found := NEW.fullmatch(stem):
        kind, number, film = found.groups()
        return Chapter(f"{kind.upper()}{film}{suffix}", int(number))
    if found := OLD.fullmatch(stem):
        number, film = found.groups()
        return Chapter(f"GOPR{film}{suffix}", int(number or 0) + 1)
    return None


def following(name: str, names: Iterable[str]) -> list[str]:
    """Return the names of the chapters behind this one, in their order, of the names in its folder.

    Raises:
        DataFormatError: one is missing between two others, or is there twice.
    """
    own = chapter_named(name)
    if own is None:
        return []
    later: dict[int, str] = {}
    for other in sorted(names):
        chapter = chapter_named(other)
        if chapter is None or chapter.recording != own.recording or chapter.number <= own.number:
            continue
        if chapter.number in later:
            raise DataFormatError(
                f"{later[chapter.number]} and {other} are both chapter {chapter.number} of one recording by their "
                "names; keep one of them elsewhere"
            )
        later[chapter.number] = other
    for expected, number in enumerate(sorted(later), own.number + 1):
        if number != expected:
            raise DataFormatError(
                f"{name}: its recording goes on in {later[number]}, but {_name_of(name, expected)} before that is not "
                f"there; copy it from the camera too, or keep {later[number]} elsewhere to use what comes before"
            )
    return [later[number] for number in sorted(later)]


def _name_of(name: str, number: int) -> str:
    """Return the name that a camera gives to a later chapter of a file's recording."""
    stem, suffix = PurePath(name).stem, PurePath(name).suffix
    start = f"{stem[:2]}{number:02d}" if NEW.fullmatch(stem) else f"GP{number - 1:02d}"
    return f"{start}{stem[4:]}{suffix}"


def chapters_from(path: Path) -> list[Path]:
    """Return the files of a recording from this one on: itself, and the chapters behind it in its folder.

    A link is followed where nothing lies behind its own name. A path that is no file has none.

    Raises:
        DataFormatError: as `following`.
    """
    path = Path(path)
    if not path.is_file():
        return [path]
    for place in _places(path):
        if later := following(place.name, _names_beside(place)):
            return [path, *(place.with_name(name) for name in later)]
    return [path]


def chapters_before(path: Path) -> tuple[int, list[str]]:
    """Return which chapter of its recording a file is by its name, and names of earlier ones in its folder; 1 and none
    where its name does not say."""
    for place in _places(Path(path)):
        if own := chapter_named(place.name):
            found = [(chapter_named(name), name) for name in _names_beside(place)]
            earlier = [(c.number, name) for c, name in found if c and c.recording == own.recording]
            return own.number, [name for number, name in sorted(earlier) if number < own.number]
    return 1, []


def without_later(files: list[Path]) -> list[Path]:
    """Return the files of a folder without those that another one of them goes on in."""
    known = {chapter_named(file.name) for file in files}

    def goes_on(file: Path) -> bool:
        chapter = chapter_named(file.name)
        return chapter is not None and Chapter(chapter.recording, chapter.number - 1) in known

    return [file for file in files if not goes_on(file)]


def _places(path: Path) -> list[Path]:
    """Return where a file's chapters may lie: beside it, and beside what it links to."""
    return [path, path.resolve()] if path.is_symlink() else [path]


def _names_beside(path: Path) -> list[str]:
    """Return the names in a file's folder, folders aside; none where its own name is no chapter's."""
    if chapter_named(path.name) is None:
        return []
    return [file.name for file in path.parent.iterdir() if not file.is_dir()]
