"""The vertices of a binary PLY file as a numpy table, without reading more of the file than is asked for."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from . import FileFormatError

LONGEST_HEADER = 1 << 16  # bytes; splat files have 60 to 130 lines
TYPES = {
    "char": "i1",
    "int8": "i1",
    "uchar": "u1",
    "uint8": "u1",
    "short": "i2",
    "int16": "i2",
    "ushort": "u2",
    "uint16": "u2",
    "int": "i4",
    "int32": "i4",
    "uint": "u4",
    "uint32": "u4",
    "float": "f4",
    "float32": "f4",
    "double": "f8",
    "float64": "f8",
}
ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">"}


class PlyVertices:
    """The vertex element, which must be the first of the file, and the header's comments.

    Raises:
        FileFormatError: not a PLY, an ASCII one, a broken header, or fewer bytes than the header promises.
    """

    def __init__(self, path: Path):
        self.path = path
        with path.open("rb") as file:
            head, end, _ = file.read(LONGEST_HEADER).partition(b"end_header\n")
        try:
            lines = [line.split() for line in head.decode("ascii").splitlines()]
        except UnicodeDecodeError:
            lines = []
        if not end or not lines or lines[0] != ["ply"]:
            raise FileFormatError(f"{path}: not a PLY file (no complete header)")
        self.comments = [" ".join(line[1:]) for line in lines if line[:1] == ["comment"]]
        self.count, self._dtype = _vertex_layout(lines, path)
        self._offset = len(head) + len(end)
        left = path.stat().st_size - self._offset
        if left < self.count * self._dtype.itemsize:
            raise FileFormatError(
                f"{path}: truncated: {self.count} points need {self.count * self._dtype.itemsize} bytes, "
                f"{left} are left after the header; copy or export the file again"
            )

    def has(self, *names: str) -> bool:
        """Whether all these properties exist."""
        return set(names) <= set(self._dtype.names or ())

    def rows(self, step: int = 1) -> np.ndarray:
        """Every step-th vertex, a structured array."""
        if not self.count:
            return np.empty(0, self._dtype)
        return np.array(np.memmap(self.path, self._dtype, "r", self._offset, (self.count,))[::step])


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


def _vertex_layout(lines: list[list[str]], path: Path) -> tuple[int, np.dtype]:
    """Number of vertices and their record, from the header's lines."""
    orders = [ORDERS.get(line[1]) for line in lines if line[:1] == ["format"] and len(line) > 1]
    if orders not in (["<"], [">"]):
        raise FileFormatError(f"{path}: not a binary PLY; convert it to binary_little_endian")
    elements = [line for line in lines if line[:1] in (["element"], ["property"])]
    if not elements or elements[0][:2] != ["element", "vertex"] or not elements[0][-1].isdigit():
        raise FileFormatError(f"{path}: the first element of the PLY is not 'vertex' with a count")
    names = []
    for line in elements[1:]:
        if line[0] == "element":
            break
        if len(line) != 3 or line[1] not in TYPES:
            raise FileFormatError(f"{path}: vertex property '{' '.join(line[1:])}' is not a plain number")
        names.append((line[2], orders[0] + TYPES[line[1]]))
    try:
        return int(elements[0][2]), np.dtype(names)
    except ValueError as error:
        raise FileFormatError(f"{path}: vertex properties are broken ({error})") from None
