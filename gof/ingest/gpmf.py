"""GPMF: what GoPro cameras write beside the pictures, once a second, in a track of the MP4 file.

Layout: the `gpmd` track's samples by the tables of ISO/IEC 14496-12; in each, nested entries of a name of four letters,
a letter for the type, the size of one value and their number, padded to four bytes (github.com/gopro/gpmf-parser).
"""

from __future__ import annotations

import itertools
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np

from gof.core.errors import DataFormatError
from gof.footage.containers import boxes, inside, read_header

Stream = dict[str, "np.ndarray | str"]  # the entries of one sensor by name: (N, size) numbers, or text

MOST_SAMPLE = 1 << 24  # bytes of a sample, which is one second
MOST_SAMPLES = 100_000
MOST_LEVELS = 8  # of entries in entries; cameras write two
NUMBERS = {"b": "i1", "B": "u1", "s": ">i2", "S": ">u2", "l": ">i4", "L": ">u4", "f": ">f4", "d": ">f8"}


def streams(path: Path) -> Iterator[Stream]:
    """Every sensor's entries of every sample of the video's GPMF track, in the file's order; none without such a track.

    Raises:
        DataFormatError: the track's tables or samples are damaged (the message does not name the file).
    """
    if not path.is_file():
        return
    try:
        with path.open("rb") as file:
            for sample in _samples(file):
                yield from _streams(sample)
    except (struct.error, IndexError, ValueError, OverflowError) as e:
        raise DataFormatError(f"its track of sensor data (GPMF) is damaged ({e})") from e


# ---- MP4: where the samples are --------------------------------------------------------------------------------------


def _samples(file: BinaryIO) -> Iterator[bytes]:
    """Each sample of the first `gpmd` track."""
    header = read_header(file)
    for start, end in boxes(header, 0, len(header), b"trak"):
        table = inside(header, start, end, b"mdia", b"minf", b"stbl")
        described = table and inside(header, *table, b"stsd")
        if described and header[described[0] + 12 : described[0] + 16] == b"gpmd":
            places = list(_places(header, *table))
            if sum(size for _, size in places) > file.seek(0, 2):
                raise ValueError("its samples claim more than the file holds")
            for offset, size in places:
                file.seek(offset)
                sample = file.read(size)
                if len(sample) < size:
                    raise ValueError("a sample lies behind the file's end")
                yield sample
            return


def _places(data: bytes, start: int, end: int) -> Iterator[tuple[int, int]]:
    """Offset in the file and size of each sample, from a track's tables: samples lie one after the other in chunks."""

    def table(kind: bytes, entry: str, skipped: int = 4) -> list[tuple]:
        found = inside(data, start, end, kind)
        if found is None:
            return []
        count = struct.unpack_from(">I", data, found[0] + skipped)[0]
        first, size = found[0] + skipped + 4, struct.calcsize(entry)
        if count > MOST_SAMPLES or first + count * size > found[1]:
            raise ValueError(f"its table '{kind.decode()}' claims {count} entries")
        return list(struct.iter_unpack(entry, data[first : first + count * size]))

    found = inside(data, start, end, b"stsz")
    if found is None:
        return
    same = struct.unpack_from(">I", data, found[0] + 4)[0]
    number = struct.unpack_from(">I", data, found[0] + 8)[0]
    if number > MOST_SAMPLES:
        raise ValueError(f"it claims {number} samples")
    sizes = [same] * number if same else [size for (size,) in table(b"stsz", ">I", 8)]
    if max(sizes, default=0) > MOST_SAMPLE:
        raise ValueError(f"a sample claims {max(sizes)} bytes")
    chunks = [offset for (offset,) in table(b"stco", ">I") or table(b"co64", ">Q")]
    runs = table(b"stsc", ">III")  # first chunk, samples in each, description
    if any(b <= a for (a, *_), (b, *_) in itertools.pairwise(runs)):
        raise ValueError("its table 'stsc' does not grow")
    k, run = 0, -1
    for chunk, offset in enumerate(chunks, 1):
        while run + 1 < len(runs) and runs[run + 1][0] <= chunk:
            run += 1
        for _ in range(runs[run][1] if run >= 0 else 1):
            if k == len(sizes):
                return
            yield offset, sizes[k]
            offset += sizes[k]
            k += 1


# ---- GPMF: what is in a sample ---------------------------------------------------------------------------------------


def _streams(sample: bytes, level: int = 1) -> Iterator[Stream]:
    """The sensors (`STRM`) of every device (`DEVC`) in a sample."""
    if level > MOST_LEVELS:
        raise ValueError(f"its entries lie in each other, more than {MOST_LEVELS} deep")
    for name, kind, data, _ in _entries(sample):
        if name == "STRM":
            yield {n: _value(k, d, s) for n, k, d, s in _entries(data) if k in NUMBERS or k == "c"}
        elif kind == "\0":
            yield from _streams(data, level + 1)


def _entries(data: bytes) -> Iterator[tuple[str, str, bytes, int]]:
    """Name, type, bytes and size in bytes of one value of each entry."""
    at = 0
    while at + 8 <= len(data):
        name, kind, size, count = struct.unpack_from(">4scBH", data, at)
        end = at + 8 + size * count
        if end > len(data):
            raise ValueError(f"its entry {name!r} claims {size * count} bytes")
        yield name.decode("latin-1"), kind.decode("latin-1"), data[at + 8 : end], size
        at += 8 + (size * count + 3) // 4 * 4


def _value(kind: str, data: bytes, size: int) -> np.ndarray | str:
    if kind == "c":
        return data.decode("latin-1").rstrip("\0")
    numbers = np.frombuffer(data, NUMBERS[kind]).astype(np.float64)
    return numbers.reshape(-1, max(1, size // np.dtype(NUMBERS[kind]).itemsize))
