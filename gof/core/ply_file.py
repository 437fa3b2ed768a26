"""PLY files: the vertices of any PLY as a numpy structured array, and binary ones written.

Read are ascii and both binary forms, elements and properties in any order. Lists (the faces of a mesh) are stepped
over: no splat has any. A header is believed only as far as the file's size allows, so memory follows the file.
"""

from __future__ import annotations

import io
import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Literal

import numpy as np

from .errors import DataFormatError

LONGEST_HEADER = 65536
ENDS = ("\r\n", "\n", "\r")
TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"},
    **{"float": "f4", "double": "f8", "float32": "f4", "float64": "f8"},
}
NAMES = {"f4": "float", "u1": "uchar"}  # what is written
Order = Literal["=", "<", ">"]
FORMATS: dict[str, Order] = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True)
class Property:
    """A number of every row, or (`count` is the type of their number) a list of numbers; types as numpy's."""

    name: str
    type: str
    count: str | None = None


@dataclass
class Element:
    """Rows of one kind."""

    name: str
    rows: int
    properties: list[Property] = field(default_factory=list)

    @property
    def has_lists(self) -> bool:
        return any(p.count for p in self.properties)

    def row(self, order: str) -> np.dtype:
        """Return a row in a byte order; of a list its first number, which says how many follow."""
        return np.dtype([(p.name, order + (p.count or p.type)) for p in self.properties])

    def numbers(self) -> np.dtype:
        """Return the type of a row's numbers that are kept."""
        return np.dtype([(p.name, p.type) for p in self.properties if not p.count])


@dataclass
class Header:
    """The header of a PLY, in `lines` lines and `size` bytes, ended by `end`."""

    format: str = ""
    elements: list[Element] = field(default_factory=list)
    comments: list[str] = field(default_factory=list)
    lines: int = 0
    size: int = 0
    end: str = "\n"


# ---------------------------------------------------------------- reading


def read_vertices(path: Path, step: int = 1) -> tuple[np.ndarray, list[str]]:
    """Return the scalar properties of element "vertex", (N,) structured, and the header's comments.

    Args:
        step: read every step-th vertex only; of a binary file without lists the others take no memory.
    Raises:
        DataFormatError: not a PLY with vertices, cut off, or not as its header says; names the line of text or the row.
    """
    with open(path, "rb") as file:
        header, vertex = _vertex_header(file, path)
        file.seek(header.size)
        before = header.elements[: header.elements.index(vertex)]
        if header.format == "ascii":
            skipped = sum(e.rows for e in before)
            return _read_text(file, vertex, header, skipped, path)[::step], header.comments
        order = FORMATS[header.format]
        for element in before:
            if element.has_lists:
                _walk(file, element, order, path)
            else:
                file.seek(element.rows * element.row(order).itemsize, os.SEEK_CUR)
        if vertex.has_lists:
            return _walk(file, vertex, order, path)[::step], header.comments
        kind, begin = vertex.row(order), file.tell()
        whole = max(0, os.fstat(file.fileno()).st_size - begin) // max(kind.itemsize, 1)
        if whole < vertex.rows:
            raise DataFormatError(f"{path}: {whole} of {vertex.rows} vertices; truncated? Copy or export it again")
        if step == 1 or not vertex.rows:
            return np.fromfile(file, kind, vertex.rows), header.comments
        return np.array(np.memmap(path, kind, "r", begin, (vertex.rows,))[::step]), header.comments


def count_vertices(path: Path) -> int:
    """Return number of vertices that a PLY announces, and has room for. Raises DataFormatError as `read_vertices`."""
    with open(path, "rb") as file:
        return _vertex_header(file, path)[1].rows


def _vertex_header(file: IO[bytes], path: Path) -> tuple[Header, Element]:
    header = read_header(file, path)
    vertex = next((e for e in header.elements if e.name == "vertex"), None)
    if vertex is None:
        raise DataFormatError(f"{path}: not a PLY file with a 'vertex' element")
    _require_size(header, os.fstat(file.fileno()).st_size, path)
    return header, vertex


def read_header(file: IO[bytes], path: Path) -> Header:
    """Read the header of a PLY. Raises DataFormatError: it is none; names the line."""
    start = file.read(LONGEST_HEADER)
    if start[:3] != b"ply" or start[3:4] not in (b"\r", b"\n"):
        raise DataFormatError(f"{path}: not a PLY file with a 'vertex' element (it does not begin with the line 'ply')")
    end = next(e for e in ENDS if start[3:].startswith(e.encode()))
    header = Header(end=end)
    for number, line in enumerate(start.split(end.encode()), 1):
        header.lines, header.size = number, header.size + len(line) + len(end)
        words = line.decode("utf-8", "replace").split()
        if words == ["end_header"] and header.size <= len(start):
            if not header.format:
                raise DataFormatError(f"{path}: the header has no line 'format'; export the file again")
            return header
        try:
            if number > 1 and words:
                _header_line(header, words, line.decode("utf-8", "replace"))
        except ValueError as e:
            raise DataFormatError(f"{path}: line {number}: {e}; export the file again") from e
    raise DataFormatError(
        f"{path}: not a PLY file with a 'vertex' element: no line 'end_header' in its first {LONGEST_HEADER} bytes; "
        "truncated?"
    )


def _header_line(header: Header, words: list[str], line: str) -> None:
    """Raise ValueError: says what is wrong with the line."""
    match words:
        case ["comment" | "obj_info", *_]:
            if words[0] == "comment":
                header.comments.append(line.partition("comment")[2].strip())
        case ["format", name, "1.0"] if name in FORMATS and not header.format:
            header.format = name
        case ["element", name, rows] if rows.isascii() and rows.isdigit() and len(rows) <= 30:
            if any(e.name == name for e in header.elements):
                raise ValueError(f"a second element '{name}'")
            header.elements.append(Element(name, int(rows)))
        case ["property", "list", count, kind, name]:
            if TYPES.get(count, "f")[0] == "f":
                raise ValueError(f"'{count[:40]}' cannot count the numbers of a list")
            _add(header, Property(name, _type(kind), TYPES[count]))
        case ["property", kind, name]:
            _add(header, Property(name, _type(kind)))
        case _:
            raise ValueError(f"'{' '.join(words)[:80]}' is no line of a PLY header")


def _type(name: str) -> str:
    if name not in TYPES:
        raise ValueError(f"no type '{name[:40]}'; there are {', '.join(TYPES)}")
    return TYPES[name]


def _add(header: Header, new: Property) -> None:
    if not header.elements:
        raise ValueError(f"property '{new.name[:40]}' stands before any element")
    properties = header.elements[-1].properties
    if any(p.name == new.name for p in properties):
        raise ValueError(f"a second property '{new.name[:40]}'")
    properties.append(new)


def _require_size(header: Header, size: int, path: Path) -> None:
    """Refuse a header that announces more than the file can hold, before anything is allocated."""
    needed = 0
    for e in header.elements:
        # A number of text has a digit and a space; a row without properties still counts, or it could be for ever.
        row = 2 * len(e.properties) if header.format == "ascii" else e.row("=").itemsize
        needed += e.rows * max(row, 1)
        if needed - (header.format == "ascii") > size - header.size:
            raise DataFormatError(
                f"{path}: header announces {e.rows} points with {len(e.properties)} properties in '{e.name}', the file "
                f"has {size} bytes; truncated? Copy or export it again"
            )


def _walk(file: IO[bytes], element: Element, order: Order, path: Path) -> np.ndarray:
    """Return row after row of a binary element with lists: they lie between its numbers, so rows differ in length."""
    data, place, numbers = file.read(), 0, bytearray()
    kinds = [(p, np.dtype(p.count or p.type).itemsize, np.dtype(p.type).itemsize) for p in element.properties]
    for row in range(element.rows):
        for p, size, each in kinds:
            value = data[place : place + size]
            place += size
            if p.count:
                count = int.from_bytes(value, "big" if order == ">" else "little", signed=p.count[0] == "i")
                place += count * each if count >= 0 else len(data) + 1
            else:
                numbers += value
            if place > len(data):
                raise DataFormatError(
                    f"{path}: row {row} of '{element.name}' continues beyond the end of the file with '{p.name}'; "
                    "truncated? Copy or export it again"
                )
    file.seek(place - len(data), os.SEEK_CUR)
    kind = element.numbers().newbyteorder(order)
    return np.frombuffer(bytes(numbers), kind) if numbers else np.zeros(element.rows, kind)


def _read_text(file: IO[bytes], vertex: Element, header: Header, skipped: int, path: Path) -> np.ndarray:
    """Return the vertices of an ascii file; `skipped` rows of other elements come before them."""
    kind = vertex.numbers()
    out, row, number = np.empty(vertex.rows, kind), -skipped, header.lines
    text = io.TextIOWrapper(file, "ascii", "replace")  # it knows every kind of line end
    for number, line in enumerate(text, header.lines + 1):
        if row == vertex.rows:
            break
        if words := line.split():
            if row >= 0:
                try:
                    out[row] = _numbers(words, vertex)
                except ValueError as e:
                    raise DataFormatError(f"{path}: line {number}: {e}; export the file again") from e
            row += 1
    if row < vertex.rows:
        raise DataFormatError(
            f"{path}: ends in line {number} with {max(row, 0)} of {vertex.rows} vertices; truncated? Copy or export it "
            "again"
        )
    return out


def _numbers(words: list[str], element: Element) -> tuple:
    """Return the numbers of a row of text. Raises ValueError: says what is wrong with it."""
    found, place = [], 0
    for p in element.properties:
        if place >= len(words):
            raise ValueError(f"no value for '{p.name}'")
        value = _number(words[place], p.count or p.type)
        place += 1 + (int(value) if p.count else 0)
        if p.count and value < 0:
            raise ValueError(f"a list of {value} numbers ('{p.name}')")
        if not p.count:
            found.append(value)
    if place != len(words):
        raise ValueError(f"{len(words)} values, but the header announces {place}")
    return tuple(found)


def _number(word: str, kind: str) -> float:
    if "_" in word:  # Python's own way to write thousands
        raise ValueError(f"'{word[:40]}' is no number")
    if kind[0] == "f":
        return float(word)
    value, limits = int(word), np.iinfo(kind)
    if not limits.min <= value <= limits.max:
        raise ValueError(f"{word[:40]} is not in {limits.min}..{limits.max}")
    return value


# ---------------------------------------------------------------- writing


def write_vertices(path: Path, vertex: np.ndarray, comments: list[str]) -> None:
    """Write vertices of type <f4 and u1 as a binary little-endian PLY.

    Raises:
        ValueError: a comment has a line end or is not ASCII, or a property has another type.
    """
    for comment in comments:
        if not comment.isascii() or "\n" in comment or "\r" in comment:
            raise ValueError(f"{comment!r} cannot be a comment in a PLY: one line of ASCII")
    kinds = [(name, vertex.dtype[name].str.lstrip("<|")) for name in vertex.dtype.names]
    lines = [
        "ply",
        "format binary_little_endian 1.0",
        *(f"comment {comment}" for comment in comments),
        f"element vertex {len(vertex)}",
        *(f"property {NAMES[kind]} {name}" for name, kind in kinds),
        "end_header\n",
    ]
    with open(path, "wb") as file:
        file.write("\n".join(lines).encode("ascii"))
        file.write(vertex.view(np.uint8).data)  # numpy's own `tofile` would not say why a disk refuses
