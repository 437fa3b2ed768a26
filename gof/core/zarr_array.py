"""Arrays in chunks on disk, in zarr's format 3: what datasets hold their grids in, read and written with numpy.

The zarr library needs Python 3.11, unpacks chunks to whatever size they say, and is slow to load; of its format this
reads what stores of grids use: regular chunks of plain numbers, unpacked, gzip or zstd, and never more bytes of a chunk
than the chunk has room for.
"""

from __future__ import annotations

import gzip
import io
import math
import os
import zlib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Literal

import numpy as np

from .errors import DataFormatError, MissingDependencyError
from .files import path_in, read_json, write_bytes, write_json

TYPES = ("float16", "float32", "float64")
ORDERS: dict[str, Literal["<", ">"]] = {"little": "<", "big": ">"}
PACKINGS = ("gzip", "zstd")
REMEDY = "write it with zarr.create_array(..., compressors=zarr.codecs.GzipCodec())"
MOST_CHUNKS = 2**15  # of an index of the first axis; each is looked for, stored or not
GZIP_LEVEL = 5  # as the add-on's writer
EVERY_FRAME = "every_frame_stored"  # attribute: each index of the first axis has a chunk, so one without has lost it
DAMAGE = (OSError, ValueError, EOFError, zlib.error)


@dataclass(frozen=True)
class ZarrArray:
    """An array in a folder.

    Attributes:
        path: the folder. shape, chunks: of the array, of a chunk. dtype: in the byte order of the file.
        fill_value: of chunks that are not stored. packing: "", "gzip" or "zstd". level: of gzip, when written.
        separator: between the numbers in a chunk's name. attributes: what its author says of it.
        axes: what its author calls them, () or a name or None each.
    """

    path: Path
    shape: tuple[int, ...]
    chunks: tuple[int, ...]
    dtype: np.dtype
    fill_value: float
    packing: str
    level: int
    separator: str
    attributes: dict
    axes: tuple[str | None, ...] = ()

    @classmethod
    def open(cls, path: str | Path) -> ZarrArray:
        """Open the folder of an array.
        DataFormatError: no array of format 3, or one of another kind than is read here.
        MissingDependencyError: it is packed with zstd, and this Python has no zstandard (Blender's has not).
        """
        path = Path(path)
        try:
            array = cls(path, *_described(read_json(path_in(path, "zarr.json"))))
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as e:
            raise DataFormatError(f"{path}: not a readable zarr array ({type(e).__name__}: {e}); {REMEDY}") from e
        if array.packing == "zstd":
            _require_zstandard(path)
        return array

    @classmethod
    def create(
        cls,
        path: str | Path,
        shape: tuple[int, ...],
        chunks: tuple[int, ...],
        dtype: str,
        attributes: dict,
        level: int = GZIP_LEVEL,
    ) -> ZarrArray:
        """Return a new array of zeros, packed with gzip; every frame is to be written. Raises DataFormatError: there is
        something at `path`."""
        path = Path(path)
        if path.exists():
            raise DataFormatError(f"{path}: exists already; remove it first or choose another name")
        write_json(path / "zarr.json", describe(shape, chunks, dtype, attributes | {EVERY_FRAME: True}, level))
        return cls.open(path)

    @property
    def ndim(self) -> int:
        return len(self.shape)

    def is_stored(self, number: tuple[int, ...]) -> bool:
        """Return whether there is a file of a chunk."""
        return self.file_of(number).exists()

    def stored_frames(self) -> np.ndarray:
        """Return for each index of the first axis whether a chunk of it is stored, (T,) bool."""
        if self.separator == ".":
            keys = (name.split(".") for name in os.listdir(self.path))
            found = {int(key[1]) for key in keys if key[0] == "c" and len(key) == self.ndim + 1 and key[1].isdigit()}
        else:
            found = {n for n in range(-(-self.shape[0] // self.chunks[0])) if _has_file(self.path / "c" / str(n))}
        return np.array([index // self.chunks[0] in found for index in range(self.shape[0])], bool)

    def mark(self, frame: int) -> None:
        """Store a chunk of zeros for a frame that has none: at rest or dark, not lost."""
        number = (frame, *(0 for _ in self.chunks[1:]))
        write_bytes(self.file_of(number), self.packed((slice(0, 0),), np.zeros(())))

    def __getitem__(self, where: tuple[int | slice, ...]) -> np.ndarray:
        """Return a box: an index or a slice per axis; axes that are not named are taken whole.

        Raises:
            DataFormatError: a chunk is damaged.   IndexError: an index is outside.
        """
        low, high = self._box(where)
        out = np.zeros([h - l for l, h in zip(low, high, strict=True)], self.dtype.newbyteorder("="))
        if self.fill_value:
            out[...] = self.fill_value

        def put(number: tuple[int, ...]) -> None:
            in_chunk, in_box = self._overlap(number, low, high)
            out[in_box] = self._chunk(number)[in_chunk]

        numbers = [number for number in self._numbers(low, high) if self.is_stored(number)]
        if len(numbers) == 1:
            put(numbers[0])
        elif numbers:
            with ThreadPoolExecutor(os.cpu_count()) as pool:  # zlib and zstd let go of the interpreter
                list(pool.map(put, numbers))
        return out[tuple(0 if isinstance(w, (int, np.integer)) else slice(None) for w in where)]

    def write(self, frame: int, values: np.ndarray) -> None:
        """Write `array[frame]`; of chunks of zeros one is stored, where there are no others. A chunk may hold one frame
        only.

        Raises:
            DataFormatError: a finite value is beyond what the array's type can hold.
        """
        low, high = self._box((frame,))
        values = np.asarray(values)[None]
        if self.chunks[0] != 1 or values.shape != tuple(h - l for l, h in zip(low, high, strict=True)):
            raise ValueError(f"{values.shape[1:]} is not a frame of {self.shape} in chunks of {self.chunks}")
        empty = True
        for number in self._numbers(low, high):
            in_chunk, in_box = self._overlap(number, low, high)
            with np.errstate(over="ignore"):
                part = values[in_box].astype(self.dtype)
            if (np.isfinite(values[in_box]) & ~np.isfinite(part)).any():
                raise DataFormatError(
                    f"{self.path}: frame {frame}: {np.abs(values).max():.3g} is beyond what {self.dtype.name} holds; "
                    "store float32"
                )
            if part.any():
                empty = False
                self.file_of(number).parent.mkdir(parents=True, exist_ok=True)
                self.file_of(number).write_bytes(self.packed(in_chunk, part))
            else:
                self.file_of(number).unlink(missing_ok=True)  # of what the frame was before
        if empty:
            self.mark(frame)

    def packed(self, filled: tuple[slice, ...], part: np.ndarray) -> bytes:
        """Return the bytes of a chunk's file that is zero but for the part `filled`."""
        whole = np.zeros(self.chunks, self.dtype)  # those at the upper border are of full size too
        whole[filled] = part
        return gzip.compress(whole.tobytes(), self.level, mtime=0)

    # ---------------------------------------------------------------- chunks

    def _box(self, where: tuple[int | slice, ...]) -> tuple[list[int], list[int]]:
        """Return first and last + 1 of the indices per axis."""
        low, high = [0] * self.ndim, list(self.shape)
        for axis, (part, size) in enumerate(zip(where, self.shape, strict=False)):
            if isinstance(part, slice):
                low[axis], high[axis], _ = part.indices(size)
                high[axis] = max(low[axis], high[axis])
            elif 0 <= part < size:
                low[axis], high[axis] = int(part), int(part) + 1
            else:
                raise IndexError(f"{self.path}: index {part} of axis {axis}, which has {size}")
        return low, high

    def _numbers(self, low: list[int], high: list[int]) -> Iterator[tuple[int, ...]]:
        """Return the chunks that a box touches."""
        return product(*(range(l // c, -(-h // c)) for l, h, c in zip(low, high, self.chunks, strict=True)))

    def _overlap(self, number: tuple[int, ...], low: list[int], high: list[int]) -> tuple[tuple, tuple]:
        """Return the part of a chunk in a box: slices of the chunk, and of the box."""
        in_chunk, in_box = [], []
        for n, c, l, h in zip(number, self.chunks, low, high, strict=True):
            first, last = max(n * c, l), min((n + 1) * c, h)
            in_chunk.append(slice(first - n * c, last - n * c))
            in_box.append(slice(first - l, last - l))
        return tuple(in_chunk), tuple(in_box)

    def file_of(self, number: tuple[int, ...]) -> Path:
        """Return where a chunk is stored, if it is."""
        return self.path / self.separator.join(["c", *map(str, number)])

    def _chunk(self, number: tuple[int, ...]) -> np.ndarray:
        file = path_in(self.path, self.file_of(number).relative_to(self.path).as_posix())  # no link to somewhere else
        try:
            data = _unpacked(file.read_bytes(), self.packing, math.prod(self.chunks) * self.dtype.itemsize)
            return np.frombuffer(data, self.dtype).reshape(self.chunks)
        except DAMAGE as e:
            raise DataFormatError(
                f"{self.path}: frame {number[0]}: {file.relative_to(self.path)} cannot be decoded "
                f"({type(e).__name__}: {e}); the chunk is truncated, make it again"
            ) from e


def describe(
    shape: tuple[int, ...],
    chunks: tuple[int, ...],
    dtype: str,
    attributes: dict,
    level: int = GZIP_LEVEL,
    axes: tuple[str, ...] = (),
) -> dict:
    """Return the zarr.json of an array packed with gzip, whose chunks that are not stored are zero."""
    return {
        "zarr_format": 3,
        "node_type": "array",
        "shape": list(shape),
        "data_type": dtype,
        "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": list(chunks)}},
        "chunk_key_encoding": {"name": "default", "configuration": {"separator": "/"}},
        "fill_value": 0.0,
        "codecs": [
            {"name": "bytes", "configuration": {"endian": "little"}},
            {"name": "gzip", "configuration": {"level": level}},
        ],
        **({"dimension_names": list(axes)} if axes else {}),
        "attributes": attributes,
    }


def _has_file(folder: Path) -> bool:
    """Return whether a file of a chunk lies in the folder of a frame, or is it."""
    if not folder.is_dir():
        return folder.is_file()
    return any(name.isdigit() for _, _, names in os.walk(folder) for name in names)


def _described(description: dict) -> tuple:
    """Return the fields of a `ZarrArray` as a zarr.json says them. Raises ValueError and its like: not read here."""
    if (description["zarr_format"], description["node_type"]) != (3, "array"):
        raise ValueError(f"format {description['zarr_format']}, {description['node_type']}; expected an array of 3")
    names = {"grid": description["chunk_grid"]["name"], "key": description["chunk_key_encoding"]["name"]}
    if names != {"grid": "regular", "key": "default"} or description.get("storage_transformers"):
        raise ValueError(f"chunks are named or laid out in another way ({names})")
    shape, chunks = tuple(description["shape"]), tuple(description["chunk_grid"]["configuration"]["chunk_shape"])
    sizes = all(type(n) is int and n >= 0 for n in shape) and all(type(n) is int and n > 0 for n in chunks)
    if not sizes or len(shape) != len(chunks) or not 0 < len(shape) <= 32:
        raise ValueError(f"shape {shape} in chunks of {chunks}")
    if math.prod(-(-n // c) for n, c in zip(shape[1:], chunks[1:], strict=True)) > MOST_CHUNKS:
        raise ValueError(
            f"shape {shape} in chunks of {chunks}: more than {MOST_CHUNKS} chunks a frame; write larger ones"
        )
    if description["data_type"] not in TYPES:
        raise ValueError(f"data type {description['data_type']!r}; expected one of {TYPES}")
    first, *packings = description["codecs"]
    if first["name"] != "bytes" or len(packings) > 1 or any(p["name"] not in PACKINGS for p in packings):
        raise ValueError(f"codecs {[c['name'] for c in description['codecs']]}; expected bytes, and gzip or zstd")
    order = ORDERS[first["configuration"]["endian"]]
    separator = description["chunk_key_encoding"].get("configuration", {}).get("separator", "/")
    if separator not in ("/", "."):
        raise ValueError(f"separator {separator!r}")
    return (
        shape,
        chunks,
        np.dtype(description["data_type"]).newbyteorder(order),
        float(description["fill_value"]),
        packings[0]["name"] if packings else "",
        int(packings[0]["configuration"]["level"]) if packings else 0,
        separator,
        dict(description.get("attributes", {})),
        tuple(description.get("dimension_names") or ()),
    )


def _require_zstandard(path: Path) -> None:
    try:
        import zstandard  # noqa: F401
    except ModuleNotFoundError as e:
        raise MissingDependencyError(
            f"{path}: its chunks are packed with zstd, which takes zstandard; install that, or {REMEDY}"
        ) from e


def _unpacked(data: bytes, packing: str, size: int) -> bytes:
    """Return the bytes of a chunk. Raises ValueError, zlib.error: it is damaged, or unpacks to another size."""
    if packing == "gzip":
        stream = zlib.decompressobj(wbits=31)
        data = stream.decompress(data, size + 1)
        if len(data) == size and not stream.eof:
            data += stream.decompress(stream.unconsumed_tail, 1)  # the checksum may still be to come
            if not stream.eof:
                raise ValueError("it ends too early")
    elif packing == "zstd":
        import zstandard

        try:
            data = zstandard.ZstdDecompressor().stream_reader(io.BytesIO(data)).read(size + 1)
        except zstandard.ZstdError as e:
            raise ValueError(e) from e
    if len(data) != size:
        raise ValueError(f"{'more than ' if len(data) > size else ''}{min(len(data), size)} bytes of {size}")
    return data
