"""OpenUSD's binary form (a crate: .usdc, .usd, within a .usdz), looked over before OpenUSD's library opens it.

The library sets memory aside for as many entries as a file announces, before it reads them: a flipped bit in a file of
some kilobytes costs gigabytes and half a minute. Here every count is compared with the bytes that are there to hold it.
The layout is that of OpenUSD's `pxr/usd/sdf/crateFile.cpp`: numbers are
little-endian; a bootstrap of 88 bytes says where the table of contents is; six sections hold the structure; values lie
between, found by 64-bit references to them.
"""

from __future__ import annotations

import mmap
from collections.abc import Callable
from pathlib import Path

import numpy as np

from gof.core.errors import DataFormatError

MAGIC = b"PXR-USDC"
BOOTSTRAP_BYTES = 88
OLDEST = (0, 5)  # arrays before it say a rank too
LZ4_MOST = 255  # bytes that one byte of LZ4 can stand for
INTS_MOST = 4 * LZ4_MOST  # integers that one byte can: equal ones take two bits each, and then LZ4
LEAST_PACKED = 16  # arrays of fewer are stored as they are
# Types of a value by their numbers, with the bytes of one in the file.
INTEGERS, FLOATS = {3: 4, 4: 4, 5: 8, 6: 8}, {7: 2, 8: 4, 9: 8}
VECTORS = dict(zip(range(19, 31), (16, 8, 4, 8, 24, 12, 6, 12, 32, 16, 8, 16), strict=True))
WIDTHS = INTEGERS | FLOATS | VECTORS
WIDTHS |= {1: 1, 2: 1, 10: 4, 11: 4, 12: 4, 13: 32, 14: 72, 15: 128, 16: 32, 17: 16, 18: 8, 56: 8, 57: 4}
DICTIONARY, REFERENCES, SAMPLES, VALUE, PAYLOADS = 31, 35, 46, 52, 55
LISTS = {32: 4, 33: 4, 34: 4, REFERENCES: 32, 36: 4, 37: 8, 38: 4, 39: 8, 54: 16, PAYLOADS: 8}  # an item's least bytes
COUNTED = {40: 4, 41: 4, 45: 8, 48: 8, 49: 16, 50: 4, 58: 8, 59: 1}  # paths, tokens, times, offsets, ...
DEEPEST = 100  # dictionaries in dictionaries


def check(path: Path) -> None:
    """Raise DataFormatError where a binary OpenUSD file announces more than its bytes can hold. Other files pass."""
    with path.open("rb") as file:
        packed = file.read(2) == b"PK"  # a .usdz: files one after another, as they are
        if not packed and file.seek(0) == 0 and file.read(len(MAGIC)) != MAGIC:
            return
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            start = data.find(MAGIC)
            while start >= 0:
                _Crate(data, start).check()
                start = data.find(MAGIC, start + 1) if packed else -1


class _Crate:
    """Bytes of a crate from `start` on; places are counted from there."""

    def __init__(self, data: mmap.mmap, start: int) -> None:
        self.data, self.start, self.size = data, start, len(data) - start
        self.version = tuple(self.bytes(len(MAGIC), 2))
        self.count_bytes = 8 if self.version >= (0, 7) else 4
        self.seen: set[int] = set()

    def bytes(self, at: int, count: int) -> bytes:
        if not 0 <= at <= self.size - count:
            raise _damaged(f"points at byte {at + count:,} of {self.size:,}")
        return self.data[self.start + at : self.start + at + count]

    def number(self, at: int, width: int = 8) -> int:
        return int.from_bytes(self.bytes(at, width), "little")

    def entries(self, at: int, entry_bytes: int, what: str, width: int = 8) -> int:
        """Return where the entries end whose count stands at `at`, each of so many bytes at least."""
        count = self.number(at, width)
        self.room(what, count, (self.size - at - width) // entry_bytes)
        return at + width + count * entry_bytes

    def room(self, what: str, count: int, most: int) -> None:
        if count > most:
            raise _damaged(f"{what} announces {count:,} entries where there are bytes for {most:,}")

    def packed(self, at: int, count: int, what: str, least: int = 0) -> int:
        """Return where `count` packed integers end, whose size in bytes stands at `at`."""
        size = self.number(at)
        self.room(f"{what}, packed,", size, self.size - at - 8)
        self.room(what, count, max(INTS_MOST * size, least))
        return at + 8 + size

    def check(self) -> None:
        """Look at the sections in the order in which OpenUSD reads them, and then at every value."""
        if self.version < OLDEST:
            raise DataFormatError(
                f"is a binary OpenUSD file of version {self.version[0]}.{self.version[1]}, from before 2018, or "
                "damaged; write it anew: usdcat OLD -o NEW.usdc"
            )
        contents = self.number(16)
        self.entries(contents, 32, "its table of contents")
        sections: dict[str, int] = {}
        for k in range(self.number(contents)):
            row = contents + 8 + 32 * k
            name = self.bytes(row, 16).split(b"\0")[0].decode("latin-1")
            begin, size = self.number(row + 16), self.number(row + 24)
            if begin + size > self.size or begin < BOOTSTRAP_BYTES:
                raise _damaged(f"its section {name!r} ends at byte {begin + size:,} of {self.size:,}, it says")
            sections.setdefault(name, begin)
        for name, looks in SECTIONS.items():
            if name not in sections:
                raise _damaged(f"it has no section {name}")
            looks(self, sections[name])

    def tokens(self, at: int) -> None:
        count, unpacked, size = (self.number(at + 8 * k) for k in range(3))
        self.room("its section TOKENS, packed,", size, self.size - at - 24)
        self.room("its section TOKENS", unpacked, LZ4_MOST * size)
        self.room("its section TOKENS", count, unpacked)  # each ends in a zero

    def strings(self, at: int) -> None:
        self.entries(at, 4, "its section STRINGS")

    def field_sets(self, at: int) -> None:
        self.packed(at + 8, self.number(at), "its section FIELDSETS")

    def paths(self, at: int) -> None:
        self.number(at)
        end, encoded = at + 16, self.number(at + 8)
        for _ in range(3):
            end = self.packed(end, encoded, "its section PATHS")
        self.room("its section PATHS", self.number(at), encoded + 1)  # the empty path is not encoded

    def specs(self, at: int) -> None:
        count, end = self.number(at), at + 8
        for _ in range(3):
            end = self.packed(end, count, "its section SPECS")

    def fields(self, at: int) -> None:
        count = self.number(at)
        place = self.packed(at + 8, count, "its section FIELDS")
        size = self.number(place)
        self.room("its section FIELDS, packed,", size, self.size - place - 8)
        self.room("its section FIELDS", 8 * count, LZ4_MOST * size)
        packed = self.bytes(place + 8, size)
        if packed[:1] != b"\0":  # packed in several parts, of 2 GB each
            raise _damaged("its section FIELDS is packed as gof does not read it")
        for value in np.frombuffer(_unpack(packed[1:], 8 * count), "<u8"):
            self.value(int(value))

    def value(self, reference: int, depth: int = 0) -> None:
        """Look at what a reference stands for: flags in the highest bits, type, and the place in 48 bits."""
        array, inlined, packed = (bool(reference >> bit & 1) for bit in (63, 62, 61))
        kind, at = reference >> 48 & 0xFF, reference & (1 << 48) - 1
        if inlined or reference in self.seen or (array and not at):  # an empty array has no place
            return
        self.seen.add(reference)
        if depth > DEEPEST:
            raise _damaged("its dictionaries hold themselves")
        if array and kind in WIDTHS:
            self.array(at, kind, packed)
        elif kind in LISTS:
            self.entries(at + 1, LISTS[kind], "a list") if self.number(at, 1) & ~1 else None
        elif kind in COUNTED:
            self.entries(at, COUNTED[kind], "a list")
        elif kind == DICTIONARY:
            self.dictionary(at, depth)
        elif kind == SAMPLES:
            self.samples(at, depth)
        elif kind == VALUE:
            self.value(self.number(at + self.number(at)), depth + 1)

    def array(self, at: int, kind: int, packed: bool) -> None:
        what, count = f"an array at byte {at:,}", self.number(at, self.count_bytes)
        place = at + self.count_bytes
        if not packed or kind not in INTEGERS | FLOATS or count < LEAST_PACKED:
            self.entries(at, WIDTHS[kind], what, self.count_bytes)
            return
        if kind in FLOATS:  # whole numbers, or indices into a table
            code, place = self.bytes(place, 1), place + 1
            if code == b"t":
                place = self.entries(place, FLOATS[kind], what, 4)
            elif code != b"i":
                raise _damaged(f"{what} is packed in a way that is none")
        self.packed(place, count, what)

    def dictionary(self, at: int, depth: int) -> None:
        end = self.entries(at, 20, "a dictionary")  # each: its key, the way to its reference, its reference
        place = at + 8
        for _ in range((end - place) // 20):
            place += 4
            place += self.number(place)
            self.value(self.number(place), depth + 1)
            place += 8

    def samples(self, at: int, depth: int) -> None:
        place = at + self.number(at)
        self.value(self.number(place), depth + 1)  # the times
        place += 8
        place += self.number(place)
        end = self.entries(place, 8, "a list of time samples")
        for value in np.frombuffer(self.bytes(place + 8, end - place - 8), "<u8"):
            self.value(int(value), depth + 1)


SECTIONS: dict[str, Callable[[_Crate, int], None]] = {
    "TOKENS": _Crate.tokens,
    "STRINGS": _Crate.strings,
    "FIELDS": _Crate.fields,
    "FIELDSETS": _Crate.field_sets,
    "PATHS": _Crate.paths,
    "SPECS": _Crate.specs,
}


def _unpack(packed: bytes, size: int) -> bytes:
    """Return the `size` bytes of a block of LZ4. Raises DataFormatError: it holds others."""
    out, at = bytearray(), 0

    def length(start: int) -> int:
        nonlocal at
        while start >= 15:
            start, at = start + packed[at], at + 1
            if packed[at - 1] < 255:
                break
        return start

    try:
        while at < len(packed) and len(out) <= size:
            token, at = packed[at], at + 1
            count = length(token >> 4)
            out += packed[at : at + count]
            at += count
            if at >= len(packed):  # the last part has nothing to repeat
                break
            back, at = packed[at] + 256 * packed[at + 1], at + 2
            count = length(token & 15) + 4
            if not 0 < back <= len(out):
                raise IndexError
            part = out[-back:]
            out += (part * (count // back + 1))[:count]
    except IndexError:
        out.clear()
    if len(out) != size:
        raise _damaged("its section FIELDS cannot be unpacked")
    return bytes(out)


def _damaged(how: str) -> DataFormatError:
    return DataFormatError(f"is damaged: {how}; write or copy it again")
