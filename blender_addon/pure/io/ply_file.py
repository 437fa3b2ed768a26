"""The vertices of a PLY file as a numpy table; of a binary one no more is read than is asked for.

`gof.core.ply_file` reads the same without this package; tests/io/test_dialects.py holds both to one list.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from . import FileFormatError

LONGEST_HEADER = 1 << 16  # bytes; splat files have 60 to 130 lines
ENDS = (b"\r\n", b"\n", b"\r")
TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"},
    **{"float": "f4", "double": "f8", "float32": "f4", "float64": "f8"},
}
ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}


class PlyVertices:
    """The element "vertex" of a PLY, and the header's comments.

    Attributes:
        count: vertices.   comments: what the header's lines "comment" say, any text.

    Raises:
        FileFormatError: not a PLY with vertices, lists of numbers in or before them, a broken header, or fewer bytes or
            lines than the header promises.
    """

    def __init__(self, path: Path):
        self.path = path
        with path.open("rb") as file:
            start = file.read(LONGEST_HEADER)
        lines, self._offset, self._end = _header(start, path)
        self.comments = [line.partition("comment")[2].strip() for line in lines if line.split()[:1] == ["comment"]]
        formats = [line.split()[1:2] for line in lines if line.split()[:1] == ["format"]]
        if len(formats) != 1 or not formats[0] or formats[0][0] not in ORDERS:
            raise FileFormatError(f"{path}: its header has no line 'format' of a PLY; export the file again")
        self._is_text = formats[0] == ["ascii"]
        before, self.count, self._dtype = _vertex_layout(lines, ORDERS[formats[0][0]], path)
        if self._is_text:
            self._skipped = sum(count for count, _ in before)
            needed = 2 * self.count * len(self._dtype.names or ())  # a digit and a blank
        else:
            self._offset += sum(count * dtype.itemsize for count, dtype in before)
            needed = self.count * self._dtype.itemsize
        left = path.stat().st_size - self._offset
        if left + self._is_text < needed:
            raise FileFormatError(
                f"{path}: truncated: {self.count} points need {needed} bytes, {max(left, 0)} are left after the "
                "header; copy or export the file again"
            )

    @property
    def names(self) -> tuple[str, ...]:
        """The properties' names, in order."""
        return self._dtype.names or ()

    def has(self, *names: str) -> bool:
        """Whether all these properties exist."""
        return set(names) <= set(self.names)

    def rows(self, step: int = 1) -> np.ndarray:
        """Every step-th vertex, a structured array. Raises FileFormatError: a line of text is no vertex (names it)."""
        if not self.count:
            return np.empty(0, self._dtype)
        if self._is_text:
            return self._text_rows()[::step]
        return np.array(np.memmap(self.path, self._dtype, "r", self._offset, (self.count,))[::step])

    def _text_rows(self) -> np.ndarray:
        with self.path.open("rb") as file:
            head = file.read(self._offset).count(self._end)
            text = file.read().decode("ascii", "replace").replace("\r\n", "\n").replace("\r", "\n")
        lines = [(number, line.split()) for number, line in enumerate(text.split("\n"), head + 1) if line.strip()]
        lines = lines[self._skipped : self._skipped + self.count]
        if len(lines) < self.count:
            raise FileFormatError(
                f"{self.path}: truncated: {len(lines)} of {self.count} points; copy or export the file again"
            )
        rows = np.empty(self.count, self._dtype)
        for k, (number, words) in enumerate(lines):
            try:
                if len(words) != len(self.names):
                    raise ValueError(f"{len(words)} values where the header asks for {len(self.names)}")
                rows[k] = tuple(map(_number, words, [self._dtype[name] for name in self.names]))
            except (ValueError, OverflowError) as error:
                raise FileFormatError(f"{self.path}: line {number}: {error}; export the file again") from None
        return rows


def columns(rows: np.ndarray, *names: str) -> np.ndarray:
    """Properties side by side, (N, len(names)) float32; values beyond its range become infinite.

    Raises:
        KeyError: its first argument lists the properties that are missing.
    """
    missing = [name for name in names if name not in rows.dtype.names]
    if missing:
        raise KeyError(missing)
    out = np.empty((len(rows), len(names)), np.float32)
    with np.errstate(over="ignore"):
        for k, name in enumerate(names):
            out[:, k] = rows[name]
    return out


def _header(start: bytes, path: Path) -> tuple[list[str], int, bytes]:
    """Its lines, the bytes that they are, and what ends them; comments may be in any encoding."""
    end = next((end for end in ENDS if start.startswith(b"ply" + end)), None)
    lines, size = [], 0
    for line in start.split(end) if end else ():
        lines.append(line.decode("utf-8", "replace"))
        size += len(line) + len(end)
        if line.split() == [b"end_header"] and size <= len(start):
            return lines, size, end
    raise FileFormatError(f"{path}: not a PLY file (no complete header)")


def _vertex_layout(lines: list[str], order: str, path: Path) -> tuple[list[tuple[int, np.dtype]], int, np.dtype]:
    """Number and record of the elements before the vertices, then those of the vertices."""
    elements: list[tuple[str, int, list[tuple[str, str]]]] = []
    for number, line in enumerate(lines, 1):
        words = line.split()
        if words[:1] == ["element"]:
            if len(words) != 3 or not (words[2].isascii() and words[2].isdigit() and len(words[2]) <= 18):
                raise FileFormatError(f"{path}: line {number}: '{line[:80].strip()}' is no element with a count")
            elements.append((words[1], int(words[2]), []))
        elif words[:1] == ["property"]:
            if not elements:
                raise FileFormatError(f"{path}: line {number}: a property stands before any element")
            if len(words) == 3 and words[1] in TYPES:
                elements[-1][2].append((words[2], order + TYPES[words[1]]))
            elif not any(name == "vertex" for name, _, _ in elements[:-1]):  # what follows the vertices is not read
                raise FileFormatError(
                    f"{path}: line {number}: property '{' '.join(words[1:])[:80]}' is not a plain number"
                )
    found = [name for name, _, _ in elements]
    if "vertex" not in found:
        raise FileFormatError(f"{path}: not a PLY file with an element 'vertex'")
    try:
        layouts = [(count, np.dtype(properties)) for _, count, properties in elements[: found.index("vertex") + 1]]
    except ValueError as error:
        raise FileFormatError(f"{path}: properties are broken ({error})") from None
    return layouts[:-1], *layouts[-1]


def _number(word: str, kind: np.dtype) -> float | int:
    if "_" in word:  # Python's own way to write thousands
        raise ValueError(f"'{word[:40]}' is no number")
    if kind.kind == "f":
        return float(word)
    value, limits = int(word), np.iinfo(kind)
    if not limits.min <= value <= limits.max:
        raise ValueError(f"{word[:40]} is not in {limits.min}..{limits.max}")
    return value
