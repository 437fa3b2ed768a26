"""Reader of a dataset's true velocity (`velocity.zarr`), with numpy, json and gzip only.

`velocity_store` states the layout.
"""

from __future__ import annotations

import json
import zlib
from itertools import product
from pathlib import Path

import numpy as np

from ..description import DatasetDescription
from . import FileFormatError

LARGEST, LARGEST_CHUNK = 4096, 256  # cells a side that are believed
CODECS = ({"bytes"}, {"bytes", "gzip"})


def of_dataset(dataset: Path) -> TrueVelocity:
    """The true velocity of a dataset folder. Raises: FileFormatError where there is none, or no dataset."""
    name = DatasetDescription.read(dataset).velocity
    if not name:
        raise FileFormatError(f"{dataset}: the dataset has no true velocity (a real capture?); choose a generated one")
    return TrueVelocity(dataset / name)


class TrueVelocity:
    """Velocity in m/s on a grid over time; chunks are read when points ask for them.

    Attributes:
        time_s: (T,) seconds on the dataset clock.

    Raises:
        FileFormatError: not a velocity store, or one compressed in another way.
    """

    def __init__(self, path: Path):
        self.path = path
        try:
            description = json.loads((path / "zarr.json").read_bytes())
            attributes, self._shape = description["attributes"], tuple(description["shape"])
            codecs = {codec["name"] for codec in description["codecs"]}
            self._chunk = tuple(description["chunk_grid"]["configuration"]["chunk_shape"][1:4])
            self._dtype = np.dtype(description["data_type"]).newbyteorder("<")
            self.time_s = np.array(attributes["time_s"], float)
            self._to_index = np.linalg.inv(np.array(attributes["index_to_world"], float).reshape(4, 4))
            plain = all(type(n) is int and 0 < n <= LARGEST for n in (*self._shape, *self._chunk))
            plain &= self._dtype.kind == "f" and len(self._chunk) == 3 and max(self._chunk) <= LARGEST_CHUNK
            if not plain or not np.isfinite(self.time_s).all() or not np.isfinite(self._to_index).all():
                raise ValueError(
                    f"{self._dtype}, shape {self._shape} in chunks of {self._chunk}, or times that are not finite"
                )
        except FileNotFoundError:
            raise FileFormatError(
                f"{path}: no zarr.json inside, so no velocity store; generate the dataset again"
            ) from None
        except (OSError, ValueError, KeyError, TypeError, RecursionError, np.linalg.LinAlgError) as error:
            raise FileFormatError(f"{path}/zarr.json: not a velocity store ({type(error).__name__}: {error})") from None
        if attributes.get("schema") != "gof-velocity" or attributes.get("units") != "m/s":
            raise FileFormatError(
                f"{path}: schema '{attributes.get('schema')}' in {attributes.get('units')}; "
                "expected 'gof-velocity' in m/s"
            )
        if codecs not in CODECS or len(self._shape) != 5 or self.time_s.shape != self._shape[:1]:
            raise FileFormatError(
                f"{path}: codecs {codecs}, shape {self._shape}; only gzip stores (T, X, Y, Z, 3) as "
                "`gof generate` writes them can be read here"
            )
        self._gzip = "gzip" in codecs

    def sample(self, points: np.ndarray, time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Velocity (N, 3) float32 at world points (N, 3) and times (N,), and whether the points lie in the domain (N,).

        Linear in time between stored frames (the first or last one's outside of them), tri-linear between cell
        centres; in the outer half cell the nearest centre's; 0 outside the domain.
        """
        index = np.asarray(points, float) @ self._to_index[:3, :3].T + self._to_index[:3, 3]
        inside = ((index >= 0) & (index <= self._shape[1:4])).all(1)
        frame = np.interp(time_s, self.time_s, np.arange(len(self.time_s)))
        before = np.minimum(frame.astype(int), max(len(self.time_s) - 2, 0))
        later = frame - before  # 0 where a single frame is all there is
        out = np.zeros((len(index), 3), np.float32)
        for number in np.unique(np.concatenate([before[inside], before[inside & (later > 0)] + 1])):
            for rows, share in ((before == number, 1 - later), (before + 1 == number, later)):
                rows = np.flatnonzero(rows & inside & (share > 0))
                if len(rows):
                    out[rows] += share[rows, None].astype(np.float32) * self._trilinear(number, index[rows] - 0.5)
        return out, inside

    def _trilinear(self, number: int, coordinate: np.ndarray) -> np.ndarray:
        size = np.array(self._shape[1:4])
        coordinate = np.clip(coordinate, 0, size - 1)
        low = np.minimum(coordinate.astype(int), np.maximum(size - 2, 0))
        start, stop = low.min(0), np.minimum(low.max(0) + 2, size)
        cells = self._cells(number, start, stop)
        fraction = (coordinate - low).astype(np.float32)
        out = np.zeros((len(low), 3), np.float32)
        for corner in product((0, 1), repeat=3):
            weight = np.prod(np.where(corner, fraction, 1 - fraction), axis=1)
            place = np.minimum(low + corner, size - 1) - start  # a one-cell axis has no neighbour to blend with
            out += weight[:, None] * cells[tuple(place.T)]
        return out

    def _cells(self, number: int, start: np.ndarray, stop: np.ndarray) -> np.ndarray:
        """Cells [start, stop) of a frame, (x, y, z, 3) float32."""
        out = np.zeros((*(stop - start), 3), np.float32)
        for chunk in product(*(range(a // n, -(-b // n)) for a, b, n in zip(start, stop, self._chunk, strict=True))):
            file = self.path.joinpath("c", str(number), *map(str, chunk), "0")
            if not file.exists():
                continue  # all zero
            values = self._decode(file)
            corner = np.array(chunk) * self._chunk
            low, high = np.maximum(start, corner), np.minimum(stop, corner + self._chunk)
            out[tuple(map(slice, low - start, high - start))] = values[tuple(map(slice, low - corner, high - corner))]
        return out

    def _decode(self, file: Path) -> np.ndarray:
        try:
            data, size = file.read_bytes(), 3 * int(np.prod(self._chunk)) * self._dtype.itemsize
            if self._gzip:  # never more than the chunk has room for, whatever the file would unpack to
                stream = zlib.decompressobj(wbits=31)
                data = stream.decompress(data, size + 1)
                if not stream.eof:
                    raise ValueError("cut off, or larger than a chunk")
            values = np.frombuffer(data, self._dtype).reshape(*self._chunk, 3)
        except (OSError, EOFError, zlib.error, ValueError) as error:
            raise FileFormatError(
                f"{file}: cannot be decoded ({error}); truncated? Generate the dataset again"
            ) from None
        if not np.isfinite(values).all():
            raise FileFormatError(f"{file}: holds NaN or Inf; generate the dataset again")
        return values
