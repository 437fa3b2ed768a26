"""Grids over time in chunked stores (schemas gof-velocity and gof-grid), and the velocity field of one time."""

from __future__ import annotations

import math
from collections.abc import Iterable
from copy import copy
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TypeVar

import numpy as np

from .datum import Datum
from .errors import DataFormatError
from .zarr_array import EVERY_FRAME, ZarrArray

SCHEMA, GRID, VERSION = "gof-velocity", "gof-grid", 1  # of velocity; of any other quantity
CHUNK = 64  # cells a side: 1.5 MB of float16, small enough to read a flame out of a large domain
S = TypeVar("S", bound="GridSequence")
SAME_PLACE = 0.01  # of a voxel, by which the corners of one grid may differ
SAME_TIME_S = 1e-6  # a stored frame this near to a time is the frame of that time
LARGEST, LARGEST_CHUNK = 4096, 256  # cells a side; a file that claims more is refused: twice what a scene may ask for
LARGEST_CHUNK_BYTES = 2**29
AXES = ("time", "x", "y", "z", "component")  # as dimension_names of a zarr.json call them, where it does
LARGEST_M = 1e30  # of a grid's place or cell; squares of it stay finite


@dataclass(frozen=True)
class VelocityField:
    """Velocity at one time on a regular grid.

    Args:
        velocity: (X, Y, Z, 3) m/s in world axes, float16/32/64; the value of a cell is at its centre.
        index_to_world: (4, 4) float64 affine map from continuous index (cell i spans [i, i+1]) to world metres.
        time_s: time on the dataset clock.
    """

    velocity: np.ndarray
    index_to_world: np.ndarray
    time_s: float = 0.0

    def __post_init__(self):
        object.__setattr__(self, "index_to_world", np.asarray(self.index_to_world, np.float64))
        if self.velocity.ndim != 4 or self.velocity.shape[-1] != 3 or 0 in self.velocity.shape:
            raise DataFormatError(f"velocity has shape {self.velocity.shape}, expected (X, Y, Z, 3) with no empty axis")
        if self.index_to_world.shape != (4, 4) or not abs(np.linalg.det(self.index_to_world)) > 1e-30:
            raise DataFormatError("index_to_world must be an invertible (4, 4) matrix")

    @classmethod
    def from_array(cls, velocity: np.ndarray, origin, voxel_size: float, time_s: float = 0.0) -> VelocityField:
        """Return an axis-aligned field: velocity (X, Y, Z, 3) m/s; origin (3,) m, min corner of cell (0,0,0);
        voxel_size m."""
        if not voxel_size > 0:
            raise DataFormatError(f"voxel_size must be positive, got {voxel_size}")
        index_to_world = np.diag([voxel_size, voxel_size, voxel_size, 1.0])
        index_to_world[:3, 3] = origin
        return cls(np.asarray(velocity), index_to_world, time_s)

    @property
    def resolution(self) -> tuple[int, int, int]:
        x, y, z, _ = self.velocity.shape
        return x, y, z

    @property
    def voxel_size(self) -> float:
        """Edge length of a cell in metres (cube root of its volume)."""
        return float(np.cbrt(abs(np.linalg.det(self.index_to_world[:3, :3]))))

    def to_index(self, points: np.ndarray) -> np.ndarray:
        """Convert world points (N, 3) m to continuous cell index (N, 3): the centre of cell i has index i + 0.5."""
        inverse = self._world_to_index
        return np.asarray(points, np.float64) @ inverse[:3, :3].T + inverse[:3, 3]

    @cached_property
    def _world_to_index(self) -> np.ndarray:
        return np.linalg.inv(self.index_to_world)

    def cell_centers(self) -> np.ndarray:
        """Return (X, Y, Z, 3) world position of every cell centre, m."""
        index = np.stack(np.meshgrid(*(np.arange(n) + 0.5 for n in self.resolution), indexing="ij"), -1)
        return index @ self.index_to_world[:3, :3].T + self.index_to_world[:3, 3]

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Return (N,) bool: inside the domain box (all cells, including their outer halves). NaN points are outside."""
        index = self.to_index(points)
        return ((index >= 0) & (index <= self.resolution)).all(-1)

    def chunk(self, number: tuple[int, int, int]) -> np.ndarray | None:
        """Return cells [CHUNK i, CHUNK (i + 1)) per axis, (<=64, <=64, <=64, 3), clipped to the grid; None if all are
        zero."""
        cells = self.velocity[tuple(slice(CHUNK * i, CHUNK * (i + 1)) for i in number)]
        return cells if cells.any() else None

    def sample(self, points: np.ndarray) -> np.ndarray:
        """Tri-linear interpolation between cell centres.

        Args:
            points: (N, 3) world metres.
        Returns:
            (N, 3) float32 m/s; in the outer half cell the nearest centre's value; 0 outside the domain box.
        """
        index = self.to_index(points)
        inside = ((index >= 0) & (index <= self.resolution)).all(-1)
        out = np.zeros((len(index), 3), np.float32)
        out[inside] = trilinear(self.velocity, index[inside] - 0.5)
        return out


def trilinear(grid: np.ndarray, coordinate: np.ndarray) -> np.ndarray:
    """Return values between cell centres; outside of them that of the nearest.

    Args:
        grid: (X, Y, Z, C).   coordinate: (N, 3) in cells, 0 at the centre of the first one.
    Returns:
        (N, C) float64.
    """
    size = np.array(grid.shape[:3])
    at = np.clip(coordinate, 0, size - 1)
    low = np.minimum(at.astype(int), np.maximum(size - 2, 0))
    part = at - low
    sides = ((1 - part).T, part.T)
    along = np.array([size[1] * size[2], size[2], 1])
    first, step = low @ along, along * (size > 1)  # a one-cell axis has no neighbour to blend with
    cells = grid.reshape(-1, grid.shape[3])
    value = np.zeros((len(at), grid.shape[3]))
    for corner in np.ndindex(2, 2, 2):
        weight = sides[corner[0]][0] * sides[corner[1]][1] * sides[corner[2]][2]
        value += weight[:, None] * cells[first + step @ corner]
    return value


class GridSequence:
    """A quantity on a cell-centred grid over time in a chunked zarr store; cells are read when needed.

    Args:
        array: as `open_array` gives it.
        quantity: what it must hold: "velocity" (schema gof-velocity), or the `quantity` of a gof-grid; None: any grid.
        components: (3,) of vectors, () of scalars; None for either.

    Attributes:
        path: of the store.
        attributes: of the store.
        times_s: (T,) float64 seconds on the dataset clock, strictly increasing.
        index_to_world: (4, 4), see `VelocityField`.
        quantity, units: what the numbers are.
        dark: frames without a chunk, of light or heat in a foreign or older store; not those before the first chunk.

    Raises:
        DataFormatError: another schema, version or quantity, a missing attribute, times that do not increase, or frames
            whose chunks are lost.
    """

    def __init__(self, array: ZarrArray, quantity: str | None = None, components: tuple[int, ...] | None = None):
        self._array, self.path, self.attributes = array, array.path, array.attributes
        attributes, path = array.attributes, array.path
        schema = SCHEMA if quantity == "velocity" else GRID
        if (attributes.get("schema"), attributes.get("version")) != (schema, VERSION):
            raise DataFormatError(
                f"{path}: schema '{attributes.get('schema')}' version {attributes.get('version')}; "
                f"this version reads '{schema}' version {VERSION}"
            )
        try:
            self.times_s = np.asarray(attributes["time_s"], np.float64)
            self.index_to_world = np.asarray(attributes["index_to_world"], np.float64)
            self.units = str(attributes["units"] if schema == SCHEMA else attributes.get("units", ""))
            self.quantity = "velocity" if schema == SCHEMA else str(attributes["quantity"])
        except KeyError as e:
            raise DataFormatError(f"{path}: attribute {e} is missing from zarr.json") from e
        except (TypeError, ValueError) as e:
            raise DataFormatError(f"{path}: time_s or index_to_world in zarr.json do not hold numbers ({e})") from e
        if quantity not in (None, self.quantity):
            raise DataFormatError(f"{path}: holds '{self.quantity[:40]}', not '{quantity}'")
        layout = attributes.get("layout", "cell_centred" if quantity != "velocity" else None)
        if layout != "cell_centred" or (quantity == "velocity" and self.units != "m/s"):
            expected = "'m/s', 'cell_centred'" if quantity == "velocity" else "'cell_centred'"
            raise DataFormatError(f"{path}: units '{self.units}', layout '{layout}'; expected {expected}")
        self._require_shape(components)
        self.dark = self._require_chunks()

    def _require_shape(self, components: tuple[int, ...] | None) -> None:
        shape, path = self._array.shape, self.path
        known = [(), (3,)] if components is None else [components]
        if len(shape) < 4 or shape[4:] not in known or 0 in shape or self.times_s.shape != shape[:1]:
            parts = ", ".join(["T, X, Y, Z", *map(str, known[-1])])
            raise DataFormatError(f"{path}: shape {shape} and {self.times_s.shape} times do not fit ({parts})")
        if not np.isfinite(self.times_s).all() or not (np.diff(self.times_s) > 0).all():
            raise DataFormatError(f"{path}: time_s must be finite, strictly increasing and not empty")
        if not is_affine(self.index_to_world):
            raise DataFormatError(f"{path}: index_to_world must be a finite, invertible 4x4 matrix")

    def _require_chunks(self) -> tuple[int, ...]:
        """Return `dark`. Chunks that are all zero need not be stored, so that a frame without any may be a lost one.

        Our stores say that every frame has one. In others, gas that has moved is never again at rest in every cell; but
        before a fire is lit there is no light, and it may go out.
        """
        stored = self._array.stored_frames()
        first = int(stored.argmax())
        lost = np.flatnonzero(~stored)
        whole = self.attributes.get(EVERY_FRAME) is True
        if not whole and stored.any():
            lost = lost[lost > first]
        if len(lost) and (whole or self.quantity == "velocity"):
            raise DataFormatError(
                f"{self.path}: frame {lost[0]} has none of its chunks ({len(lost)} of {len(stored)} frames have none): "
                "lost where the store was copied; copy it again, unpack it again or make it again"
            )
        return tuple(lost.tolist())

    def measured_from(self: S, datum: Datum) -> S:
        """Return the same store in a world and on a clock whose zeros are the datum's."""
        moved = copy(self)
        moved.times_s = self.times_s - datum.time_s
        moved.index_to_world = self.index_to_world.copy()
        moved.index_to_world[:3, 3] -= datum.position
        return moved

    def __len__(self) -> int:
        return len(self.times_s)

    @property
    def resolution(self) -> tuple[int, int, int]:
        x, y, z = self._array.shape[1:4]
        return x, y, z

    @property
    def dtype(self) -> np.dtype:
        return self._array.dtype.newbyteorder("=")

    def cells(self, index: int, *box: slice) -> np.ndarray:
        """Return the cells of stored frame `index`, (X, Y, Z) or (X, Y, Z, 3) of `dtype`; of a box only, a slice per
        axis.

        Raises:
            DataFormatError: a chunk is damaged, or holds NaN or Inf.
        """
        values = self._array[(index, *box)]
        if not _all_finite(values):
            raise DataFormatError(f"{self.path}: frame {index} holds NaN or Inf; the store is damaged, make it again")
        return values

    def cells_at(self, time_s: float) -> np.ndarray:
        """Return `cells` at a time, float32: a stored frame within 1 us, otherwise linear between the two around it.

        Raises:
            DataFormatError: the time lies outside the stored clock.
        """
        parts = self.bracket(time_s)
        if len(parts) == 1:
            return self.cells(parts[0][0]).astype(np.float32)
        first, last = (np.float32(weight) * self.cells(index).astype(np.float32) for index, weight in parts)
        return first + last

    def bracket(self, time_s: float) -> list[tuple[int, float]]:
        """Return (stored frame, weight) pairs of a time: one frame within 1 us, otherwise the two around it, linearly.

        Raises:
            DataFormatError: the time lies outside the stored clock.
        """
        nearest = int(np.abs(self.times_s - time_s).argmin())
        if abs(self.times_s[nearest] - time_s) <= SAME_TIME_S:
            return [(nearest, 1.0)]
        if not self.times_s[0] < time_s < self.times_s[-1]:
            raise DataFormatError(
                f"{self.path}: time {time_s} s is outside the stored clock "
                f"{self.times_s[0]}..{self.times_s[-1]} s; do both use the same clock and unit?"
            )
        after = int(np.searchsorted(self.times_s, time_s))
        f = float((time_s - self.times_s[after - 1]) / (self.times_s[after] - self.times_s[after - 1]))
        return [(after - 1, 1 - f), (after, f)]


class VelocitySequence(GridSequence):
    """A velocity field over time in a chunked zarr store."""

    def __init__(self, array: ZarrArray):
        super().__init__(array, "velocity", (3,))
        self._cached: tuple[int, VelocityField] | None = None

    @classmethod
    def open(cls, path: str | Path) -> VelocitySequence:
        """Open a store for reading.

        Raises:
            DataFormatError: not a zarr array, wrong schema or version, missing attribute, times not increasing.
        """
        return cls(open_array(path))

    def measured_from(self, datum: Datum) -> VelocitySequence:
        """Return the same store in a world and on a clock whose zeros are the datum's."""
        moved = super().measured_from(datum)
        moved._cached = None
        return moved

    @classmethod
    def create(cls, path: str | Path, fields: Iterable[VelocityField], dtype: str = "float32") -> VelocitySequence:
        """Write fields of one grid, in time order, as a new store; refuses to replace an existing one.

        Raises:
            DataFormatError: the store exists, there are no fields, or their grids differ.
        """
        fields = list(fields)
        if not fields:
            raise DataFormatError(f"{path}: no fields to write")
        first = fields[0]
        corners = np.array([[0, 0, 0, 1], [*first.resolution, 1]]).T
        apart = max(np.abs((f.index_to_world - first.index_to_world) @ corners).max() for f in fields)
        if apart > SAME_PLACE * first.voxel_size or any(f.resolution != first.resolution for f in fields):
            raise DataFormatError(f"{path}: all fields of a sequence must share one grid")
        attributes = {
            "schema": SCHEMA,
            "version": VERSION,
            "units": "m/s",
            "frame": "world",
            "layout": "cell_centred",
            "index_to_world": first.index_to_world.tolist(),
            "voxel_size": first.voxel_size,
            "time_s": [float(f.time_s) for f in fields],
        }
        shape, chunks = (len(fields), *first.resolution, 3), (1, CHUNK, CHUNK, CHUNK, 3)
        array = ZarrArray.create(path, shape, chunks, dtype, attributes)
        for i, f in enumerate(fields):
            array.write(i, f.velocity)
        return cls(array)

    def chunk(self, index: int, number: tuple[int, int, int]) -> np.ndarray | None:
        """Return the part of stored field `index` that `VelocityField.chunk` names, reading nothing else; None where it
        is not stored and so is at rest.

        Raises:
            DataFormatError: the chunk is truncated, or holds NaN or Inf.
        """
        rests = self._array.fill_value == 0 and self._array.chunks == (1, CHUNK, CHUNK, CHUNK, 3)
        if rests and not self._array.is_stored((index, *number, 0)):
            return None
        box = tuple(slice(CHUNK * i, CHUNK * (i + 1)) for i in number)
        cells = self._array[(index, *box)]
        if not _all_finite(cells):
            raise DataFormatError(
                f"{self.path}: frame {index}, chunk {number} holds NaN or Inf; the store is damaged, make it again"
            )
        return cells

    def frame(self, index: int) -> VelocityField:
        """Return the stored field number `index`."""
        if self._cached is None or self._cached[0] != index:
            self._cached = index, VelocityField(self.cells(index), self.index_to_world, float(self.times_s[index]))
        return self._cached[1]

    def at(self, time_s: float) -> VelocityField:
        """Return the field at a time: a stored frame within 1 us, otherwise linear interpolation between the two around
        it.

        Raises:
            DataFormatError: the time lies outside the stored clock.
        """
        parts = self.bracket(time_s)
        if len(parts) == 1:
            return self.frame(parts[0][0])
        first, last = (np.float32(weight) * self.frame(index).velocity.astype(np.float32) for index, weight in parts)
        return VelocityField(first + last, self.index_to_world, float(time_s))

    def sample(self, points: np.ndarray, time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return velocity (N, 3) float32 m/s at world points (N, 3) and times (N,), and which points lie in the domain
        (N,).

        Linear in time between stored frames (the first or last one's outside of them), tri-linear between cell
        centres; in the outer half cell the nearest centre's; 0 outside the domain. Reads only the cells around.
        """
        box = np.array(self.resolution)
        world_to_index = np.linalg.inv(self.index_to_world)
        index = np.asarray(points, np.float64) @ world_to_index[:3, :3].T + world_to_index[:3, 3]
        inside = ((index >= 0) & (index <= box)).all(1)
        frame = np.interp(time_s, self.times_s, np.arange(len(self)))
        out = np.zeros((len(index), 3), np.float32)
        for number in range(len(self)):
            weight = np.clip(1 - np.abs(frame - number), 0, 1)
            rows = np.flatnonzero(inside & (weight > 0))
            if len(rows):
                coordinate = np.clip(index[rows] - 0.5, 0, box - 1)
                low = np.minimum(coordinate.astype(int), np.maximum(box - 2, 0))
                start, stop = low.min(0), np.minimum(low.max(0) + 2, box)
                cells = self.cells(number, *map(slice, start, stop))
                out[rows] += weight[rows, None] * trilinear(cells, coordinate - start)
        return out, inside


def is_affine(matrix: np.ndarray) -> bool:
    """Return whether a matrix (4, 4) maps indices of a grid to places: below 1e30 m, with a last row 0 0 0 1,
    invertible."""
    if matrix.shape != (4, 4) or not (np.abs(matrix) < LARGEST_M).all() or (matrix[3] != [0, 0, 0, 1]).any():
        return False
    with np.errstate(under="ignore"):
        return bool(np.isfinite(np.linalg.det(matrix)) and np.linalg.det(matrix))


def open_array(path: str | Path) -> ZarrArray:
    """Return a zarr array of cells over time for reading.

    Raises:
        DataFormatError: not a zarr array, of other things than floats, too large for any simulation, or with other axes
            or in another frame than ours.
    """
    array = ZarrArray.open(path)
    if (
        max(array.shape[1:4], default=0) > LARGEST
        or max(array.chunks[1:4], default=0) > LARGEST_CHUNK
        or math.prod(array.chunks) * array.dtype.itemsize > LARGEST_CHUNK_BYTES
    ):
        raise DataFormatError(
            f"{path}: shape {array.shape} in chunks of {array.chunks}; expected at most {LARGEST} cells a side in "
            f"chunks of at most {LARGEST_CHUNK} and {LARGEST_CHUNK_BYTES >> 20} MB"
        )
    frame = array.attributes.get("frame", "world")
    axes = [name for name in array.axes if name is not None]
    if frame != "world" or axes not in ([], list(AXES[: len(axes)])):
        raise DataFormatError(
            f"{path}: axes {axes} in frame {str(frame)[:40]!r}; expected {', '.join(AXES)} in frame 'world'"
        )
    return array


def _all_finite(values: np.ndarray) -> bool:
    """Return no NaN or Inf. For float16, which numpy would convert one by one, it reads the exponent bits (8 times
    faster)."""
    if values.dtype == np.float16:
        return bool(((values.view(np.uint16) & 0x7C00) != 0x7C00).all())
    return bool(np.isfinite(values).all())
