"""A velocity grid as the quadrature reads it: only the 64^3 chunks that Gaussians touch, in a pool of bricks.

A brick repeats the first layer of its upper neighbours, so the eight cells around any point lie in one brick. Chunks of
zeros share one empty brick, which is what a plume leaves of a 640^3 grid.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gof.fields import CHUNK, VelocityField, VelocitySequence

EDGE = CHUNK + 1
POOL_BYTES = 1 << 30  # larger pools are worked through in parts
FAR = 1e6  # cells, exact in float32; what is farther out is put here, where no node of a sane Gaussian reaches the grid
FEW = 4  # chunks of a grid so small that finding out which are touched takes longer than reading them all
MARGIN = 2  # cells around what is asked for: the upper corners, and the stencil of `phase_spread`


@dataclass(frozen=True)
class StoredField:
    """A field of a chunked store at one time, with the interface of `VelocityField` but read chunk by chunk."""

    sequence: VelocitySequence
    time_s: float

    @cached_property
    def _parts(self) -> list[tuple[int, float]]:
        return self.sequence.bracket(self.time_s)

    @cached_property
    def _shape(self) -> VelocityField:
        """A field of the same grid whose values take no memory."""
        return VelocityField(np.broadcast_to(np.float32(0), (*self.sequence.resolution, 3)), self.sequence.index_to_world)

    @property
    def resolution(self) -> tuple[int, int, int]:
        return self.sequence.resolution

    @property
    def index_to_world(self) -> np.ndarray:
        return self.sequence.index_to_world

    @property
    def voxel_size(self) -> float:
        return self._shape.voxel_size

    @property
    def dtype(self) -> np.dtype:
        return self.sequence.dtype if len(self._parts) == 1 else np.dtype(np.float32)

    def to_index(self, points: np.ndarray) -> np.ndarray:
        return self._shape.to_index(points)

    def contains(self, points: np.ndarray) -> np.ndarray:
        return self._shape.contains(points)

    def chunk(self, number: tuple[int, int, int]) -> np.ndarray | None:
        """As `VelocityField.chunk`; linear between stored frames."""
        stored = [(self.sequence.chunk(index, number), weight) for index, weight in self._parts]
        stored = [(cells, weight) for cells, weight in stored if cells is not None]
        if len(self._parts) == 1 or not stored:
            return stored[0][0] if stored else None
        return sum(np.float32(weight) * cells.astype(np.float32) for cells, weight in stored)

    def sample(self, points: np.ndarray) -> np.ndarray:
        """As `VelocityField.sample`; reads the chunks around the points, all at once."""
        index = self.to_index(points)
        inside = ((index >= 0) & (index <= self.resolution)).all(-1)
        out = np.zeros((len(index), 3), np.float32)
        coordinate = np.clip(index[inside] - 0.5, 0, np.array(self.resolution) - 1)
        low = coordinate.astype(np.int64)
        fraction = (coordinate - low).astype(np.float32)
        pool = pool_of(self, touched_chunks(self, low, low))
        brick, local = np.divmod(low, CHUNK)
        slot = pool.table[tuple(brick.T)]
        step = (low + 1 < self.resolution).astype(np.int64)
        for corner in np.ndindex(2, 2, 2):
            weight = np.prod(np.where(corner, fraction, 1 - fraction), axis=1)
            at = local + np.array(corner) * step
            out[inside] += weight[:, None] * pool.cells[slot, at[:, 0], at[:, 1], at[:, 2], :3]
        return out


@dataclass
class Pool:
    """Bricks in memory: cells (slots, EDGE, EDGE, EDGE, 4) float16 or float32, the fourth component unused; slot 0 is empty."""

    cells: np.ndarray
    table: np.ndarray  # (bricks per axis) uint32: slot of each chunk
    held: np.ndarray  # bool, same shape: chunks the pool can answer for


def cell_ranges(field: VelocityField | StoredField, position: np.ndarray, scale: np.ndarray,
                outermost: float) -> tuple[np.ndarray, np.ndarray]:
    """First and last cell (M, 3) that nodes up to `outermost` standard deviations along each own axis can fall into.

    No node is farther from the centre along grid axis i than |row i of world_to_index| |scale| outermost.
    """
    to_index = np.linalg.inv(field.index_to_world)[:3, :3]
    cell = np.floor(np.clip(field.to_index(position) - 0.5, -FAR, FAR)).astype(np.int32)
    reach = np.linalg.norm(scale, axis=1)[:, None] * (outermost * np.linalg.norm(to_index, axis=1))
    reach = np.minimum(np.ceil(reach), FAR).astype(np.int32)
    return cell - reach, cell + reach


def touched_chunks(field: VelocityField | StoredField, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """(bricks per axis) bool: the chunks that any of the cell ranges low..high, (M, 3) whole numbers, reaches into."""
    size = np.array(field.resolution)
    bricks = -(-size // CHUNK)
    if bricks.prod() <= FEW:
        return np.ones(bricks, bool)
    meets = ((high + MARGIN >= 0) & (low - MARGIN < size)).all(1)
    first = np.clip(low[meets] - MARGIN, 0, size - 1).astype(np.int64) // CHUNK
    after = np.clip(high[meets] + MARGIN, 0, size - 1).astype(np.int64) // CHUNK + 1
    marks = np.zeros(bricks + 1, np.int64)  # +1 and -1 at the corners of every range; running sums fill the ranges
    for corner in np.ndindex(2, 2, 2):
        at = np.ravel_multi_index(tuple(np.where(corner, after, first).T), marks.shape)
        marks += (-1) ** sum(corner) * np.bincount(at, minlength=marks.size).reshape(marks.shape)
    return marks.cumsum(0).cumsum(1).cumsum(2)[:-1, :-1, :-1] > 0


def pool_bytes(field: VelocityField | StoredField, chunks: int) -> int:
    return chunks * EDGE**3 * 4 * np.dtype(_dtype(field)).itemsize


def pool_of(field: VelocityField | StoredField, needed: np.ndarray) -> Pool:
    """The pool for the chunks of `touched_chunks`; the last pool of a stored field is kept, since its frame is asked for twice."""
    kept = field.__dict__.get("_pool") if isinstance(field, StoredField) else None
    if kept is not None and not (needed & ~kept.held).any():
        return kept
    pool = _fill(field, needed)
    if isinstance(field, StoredField):
        field.__dict__["_pool"] = pool
    return pool


def _dtype(field) -> type:
    return np.float16 if (field.dtype if isinstance(field, StoredField) else field.velocity.dtype) == np.float16 else np.float32


def _aligned_zeros(shape: tuple[int, ...], dtype: type) -> np.ndarray:
    """Zeros on a 64-byte boundary; the system hands out the memory page by page, when it is written to."""
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    raw = np.zeros(size + 64, np.uint8)
    start = -raw.ctypes.data % 64
    return raw[start:start + size].view(dtype).reshape(shape)


def _fill(field: VelocityField | StoredField, needed: np.ndarray) -> Pool:
    numbers = [tuple(n) for n in np.argwhere(needed).tolist()]
    with ThreadPoolExecutor(os.cpu_count()) as threads:  # decompression runs without Python's lock
        batch = 4 * (os.cpu_count() or 1)
        cells = _aligned_zeros((1 + len(numbers), EDGE, EDGE, EDGE, 4), _dtype(field))
        full: dict[tuple[int, int, int], int] = {}
        for start in range(0, len(numbers), batch):
            part = numbers[start:start + batch]
            for number, chunk in zip(part, threads.map(field.chunk, part), strict=True):
                if chunk is not None:
                    full[number] = len(full) + 1
                    x, y, z = chunk.shape[:3]
                    cells[full[number], :x, :y, :z, :3] = chunk
    slots = dict(full)
    upper = [d for d in np.ndindex(2, 2, 2) if any(d)]
    for number in numbers:  # the last layer of a brick comes from its upper neighbours
        for d in upper:
            neighbour = tuple(a + b for a, b in zip(number, d, strict=True))
            if neighbour in full:
                own = slots.setdefault(number, len(slots) + 1)
                to = tuple(CHUNK if k else slice(CHUNK) for k in d)
                cells[(own, *to)] = cells[(full[neighbour], *(0 if k else slice(CHUNK) for k in d))]
    table = np.zeros(needed.shape, np.uint32)
    for number, slot in slots.items():
        table[number] = slot
    return Pool(cells[:len(slots) + 1], table, needed)
