"""Files that are a sequence: which file is which frame, by the numbers in their names.

The frame is the last number of a name that is no size or rate: `fire_v2.0012_512x512.vdb` is frame 12. All else in the
names is the same in every file of a sequence.
"""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterable
from pathlib import Path

from .errors import DataFormatError

SIZE = re.compile(r"[0-9]+x[0-9]+|[0-9]+(?:p|k|px|fps|hz|bits?)(?![a-z])", re.I)  # 512x512, 1080p, 24fps
NUMBER = re.compile(r"(?:(?<![^._ =])-)?[0-9]+")  # a minus after a separator is a sign, after a letter a separator
MOST_NAMED = 5  # missing stretches that a message lists


def number_files(paths: Iterable[Path]) -> list[tuple[int, Path]]:
    """Frame numbers and files, in the order of the numbers. Files whose names begin with a point are left out.

    A file that is alone needs no number; it is 0 then.

    Raises:
        DataFormatError: a name without a number; two files of one number; names that differ in more than the number;
            digits that may be decimals, as 0.25 and 0.5.
    """
    files = sorted(path for path in paths if not is_hidden(path))
    if len(files) == 1:
        return [((frame_of(files[0]) or ("", 0, ""))[1], files[0])]
    known: dict[int, Path] = {}
    names: dict[str, Path] = {}
    lengths: set[int] = set()  # of the digits
    for path in files:
        found = frame_of(path)
        if found is None:
            raise DataFormatError(
                f"{path}: its name has no frame number, as {files[0].parent / 'frame_0001'} "
                "would; rename it, or keep it elsewhere"
            )
        name, number, digits = found
        if number in known:
            raise DataFormatError(
                f"{path}: has the number {number}, and so has {_beside(known[number], path)}; keep one file for each "
                "frame"
            )
        known[number] = path
        names.setdefault(name, path)
        lengths.add(len(digits))
    if len(names) > 1:
        one, other = list(names.values())[:2]
        raise DataFormatError(
            f"{one} and {_beside(other, one)}: differ in more than the frame's number; keep one sequence in a folder, "
            "named as frame_0001, frame_0002, ..."
        )
    numbered = sorted(known.items())
    if any(re.search(r"[0-9]\.#", name) for name in names):
        _require_whole_numbers(numbered, lengths)
    return numbered


def is_hidden(path: Path) -> bool:
    """Return whether a system wrote it for itself, as macOS does with `._0001.jpg` and `.DS_Store`."""
    return path.name.startswith(".")


def frame_of(path: Path) -> tuple[str, int, str] | None:
    """Return a name without its frame's number and ending, that number, and its digits; None where it has none."""
    stem = path.stem
    sizes = SIZE.sub(lambda size: "*" * len(size[0]), stem)
    found = list(NUMBER.finditer(sizes))
    if not found:
        return None
    start, end = found[-1].span()
    return f"{stem[:start]}#{stem[end:]}".lower(), int(stem[start:end]), stem[start:end]


def missing_numbers(numbers: list[int]) -> tuple[int, str]:
    """Return the count of numbers of an even step missing between the first and the last, and which, in words.

    Args:
        numbers: increasing. Their step is the largest that all of them fit.
    """
    step = usual_step(numbers)
    gaps = [(a + step, b - step) for a, b in itertools.pairwise(numbers) if b - a > step]
    count = sum((last - first) // step + 1 for first, last in gaps)
    named = [f"{first}" if first == last else f"{first} to {last}" for first, last in gaps[:MOST_NAMED]]
    return count, ", ".join(named) + (", ..." if len(gaps) > MOST_NAMED else "")


def usual_step(numbers: list[int]) -> int:
    """Return the largest step that all of the increasing numbers fit; 1 for a single one."""
    return math.gcd(*(b - a for a, b in itertools.pairwise(numbers))) or 1


def _require_whole_numbers(found: list[tuple[int, Path]], lengths: set[int]) -> None:
    """Raise DataFormatError: digits behind a digit and a point that do not count up by one, as 0.25 and 0.5."""
    if len(lengths) > 1 or found[-1][0] - found[0][0] != len(found) - 1:
        raise DataFormatError(
            f"{found[0][1]} ... {found[-1][1].name}: are the digits behind the point a frame's number, or decimals? "
            "Name the files frame_0001, frame_0002, ..."
        )


def _beside(path: Path, other: Path) -> str:
    """Return a file's name, with its folder where that is another one than `other`'s."""
    return path.name if path.parent == other.parent else str(path)
