"""Reader of grids over time, zarr v3 stores of cells (gof-velocity and gof-grid), with numpy, json and zlib only.

`velocity_store` states the layout. Blender's Python has gzip and no zstd, which is what zarr's own library takes when
nobody says otherwise.
"""

from __future__ import annotations

import math
import zlib
from itertools import product
from pathlib import Path

import numpy as np

from . import FileFormatError
from .files import path_in, read_json

LARGEST, LARGEST_CHUNK = 4096, 256  # cells a side that are believed
AXES = ("time", "x", "y", "z", "component")  # as dimension_names of a zarr.json call them, where it does
MOST_CHUNKS = 2**15  # of a frame; each is asked for, stored or not
CODECS = ({"bytes"}, {"bytes", "gzip"})
SAME_TIME_S = 1e-6  # a stored frame this near to a time is the frame of that time
REMEDY = "make it again"


class StoredGrid:
    """A quantity on a grid over time; chunks are read when somebody asks for their cells.

    Args:
        path: the store's folder.
        quantity: what it must hold: "velocity", or the attribute `quantity` of a gof-grid store.
        units: the units it must have; None for any.
        components: (3,) for vectors, () for scalars.

    Attributes:
        time_s: (T,) seconds on the store's clock, increasing.
        grid: (X, Y, Z) cells.
        index_to_world: (4, 4) continuous cell index (cell i spans [i, i + 1]) to world metres.
        dtype: of the stored numbers.

    Raises:
        FileFormatError: not such a store, or one compressed in another way, or parts of it are links to elsewhere.
    """

    def __init__(self, path: Path, quantity: str, units: str | None = None, components: tuple[int, ...] = (3,)):
        self.path, self._components = path, components
        file = path_in(path, "zarr.json")
        if not file.is_file():
            raise FileFormatError(f"{path}: no zarr.json inside, so no {quantity} store; {REMEDY}")
        try:
            description = read_json(file)
            attributes, shape = description["attributes"], tuple(description["shape"])
            codecs = {codec["name"] for codec in description["codecs"]}
            chunks = tuple(description["chunk_grid"]["configuration"]["chunk_shape"])
            separator = description.get("chunk_key_encoding", {}).get("configuration", {}).get("separator", "/")
            self.dtype = np.dtype(description["data_type"]).newbyteorder("<")
            self.time_s = np.array(attributes["time_s"], float)
            self.index_to_world = np.array(attributes["index_to_world"], float).reshape(4, 4)
            self.world_to_index = np.linalg.inv(self.index_to_world)
            self._chunk = chunks[1:4]
            plain = all(type(n) is int and 0 < n <= LARGEST for n in (*shape, *self._chunk))
            plain &= self.dtype.kind == "f" and len(self._chunk) == 3 and max(self._chunk) <= LARGEST_CHUNK
            plain = plain and math.prod(-(-n // c) for n, c in zip(shape[1:4], self._chunk, strict=True)) <= MOST_CHUNKS
            if not plain or not np.isfinite(self.time_s).all() or not np.isfinite(self.world_to_index).all():
                raise ValueError(
                    f"{self.dtype}, shape {shape} in chunks of {chunks}: no floats, too many cells, more than "
                    f"{MOST_CHUNKS} chunks a frame, or times that are not finite"
                )
        except (ValueError, KeyError, TypeError, AttributeError, np.linalg.LinAlgError) as error:
            message = f"{path}/zarr.json: not a {quantity} store ({type(error).__name__}: {error})"
            raise FileFormatError(message) from None
        self._check_content(description, quantity, units)
        self._check_layout(description, shape, chunks, codecs, separator)
        self.grid = shape[1:4]
        self._gzip = "gzip" in codecs

    def cells(self, frame: int, start: np.ndarray, stop: np.ndarray) -> np.ndarray:
        """Cells [start, stop) of a stored frame, (x, y, z) or (x, y, z, 3) float32.

        Raises:
            FileFormatError: a chunk is damaged, or holds NaN or Inf.
        """
        out = np.zeros((*(stop - start), *self._components), np.float32)
        for chunk in product(*(range(a // n, -(-b // n)) for a, b, n in zip(start, stop, self._chunk, strict=True))):
            file = path_in(self.path, "/".join(["c", *map(str, (frame, *chunk)), *("0" for _ in self._components)]))
            if not file.exists():
                continue  # all zero
            values = self._decode(file)
            corner = np.array(chunk) * self._chunk
            low, high = np.maximum(start, corner), np.minimum(stop, corner + self._chunk)
            out[tuple(map(slice, low - start, high - start))] = values[tuple(map(slice, low - corner, high - corner))]
        return out

    def at(self, time_s: float) -> np.ndarray:
        """All cells at a time: a stored frame within 1 us, otherwise linear between the two around it.

        Raises:
            ValueError: the time lies outside the store's clock. FileFormatError: see `cells`.
        """
        nearest = int(np.abs(self.time_s - time_s).argmin())
        if abs(self.time_s[nearest] - time_s) <= SAME_TIME_S:
            return self._frame(nearest)
        if not self.time_s[0] < time_s < self.time_s[-1]:
            raise ValueError(f"{self.path}: {time_s:g} s lies outside {self.time_s[0]:g}..{self.time_s[-1]:g} s")
        after = int(np.searchsorted(self.time_s, time_s))
        later = (time_s - self.time_s[after - 1]) / (self.time_s[after] - self.time_s[after - 1])
        return np.float32(1 - later) * self._frame(after - 1) + np.float32(later) * self._frame(after)

    def _frame(self, frame: int) -> np.ndarray:
        return self.cells(frame, np.zeros(3, int), np.array(self.grid))

    def _check_content(self, description: dict, quantity: str, units: str | None) -> None:
        attributes = description["attributes"]
        schema = "gof-velocity" if quantity == "velocity" else "gof-grid"
        found = attributes.get("schema"), attributes.get("quantity", "velocity"), attributes.get("units")
        axes = [name for name in description.get("dimension_names") or () if name is not None]
        frame = attributes.get("frame", "world")
        if frame != "world" or axes != list(AXES[: len(axes)]):
            raise FileFormatError(
                f"{self.path}: axes {axes} in frame {str(frame)[:40]!r}; expected {', '.join(AXES)} in frame 'world'"
            )
        if found[:2] != (schema, quantity) or (units is not None and found[2] != units):
            raise FileFormatError(
                f"{self.path}: schema '{found[0]}', {found[1]} in {found[2]}; "
                f"expected '{schema}', {quantity} in {units or 'any unit'}"
            )

    def _check_layout(self, description: dict, shape: tuple, chunks: tuple, codecs: set[str], separator: str) -> None:
        whole_vectors = chunks[:1] == (1,) and chunks[4:] == self._components
        fits = shape[4:] == self._components and self.time_s.shape == shape[:1] and not description.get("fill_value")
        if codecs not in CODECS or not (whole_vectors and separator == "/" and fits):
            parts = ("T", "X", "Y", "Z", *map(str, self._components))
            raise FileFormatError(
                f"{self.path}: codecs {codecs}, shape {shape} in chunks of {chunks}; only gzip stores "
                f"({', '.join(parts)}) of one frame a chunk as `gof generate` writes them can be read here "
                "(zarr.create_array(..., compressors=zarr.codecs.GzipCodec()))"
            )

    def _decode(self, file: Path) -> np.ndarray:
        shape = (*self._chunk, *self._components)
        try:
            data, size = file.read_bytes(), int(np.prod(shape)) * self.dtype.itemsize
            if self._gzip:  # never more than the chunk has room for, whatever the file would unpack to
                stream = zlib.decompressobj(wbits=31)
                data = stream.decompress(data, size + 1)
                if not stream.eof:
                    raise ValueError("cut off, or larger than a chunk")
            values = np.frombuffer(data, self.dtype).reshape(shape)
        except (OSError, EOFError, zlib.error, ValueError) as error:
            raise FileFormatError(f"{file}: cannot be decoded ({error}); truncated? If so, {REMEDY}") from None
        if not np.isfinite(values).all():
            raise FileFormatError(f"{file}: holds NaN or Inf; {REMEDY}")
        return values
