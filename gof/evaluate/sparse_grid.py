"""A velocity grid as the quadrature reads it: only the 64^3 chunks that Gaussians touch, in a pool of bricks.

A brick repeats the first layer of its upper neighbours, so the eight cells around any point lie in one brick. Chunks of
zeros share one empty brick, which is what a plume leaves of a 640^3 grid.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property, reduce
from threading import Lock
from typing import Any

import numpy as np

from gof.core.fields import CHUNK, VelocityField, VelocitySequence

EDGE = CHUNK + 1
POOL_BYTES = 1 << 30  # larger pools are worked through in parts
KEPT_BYTES = 1 << 28  # of the fields of other times
FAR = 1e6  # cells, exact in float32; what is farther out is put here, where no node of a sane Gaussian reaches the grid
FEW = 4  # chunks of a grid so small that finding out which are touched takes longer than reading them all
MARGIN = 2  # cells around the wanted ones: the upper corners


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
        """Return a field of the same grid whose values take no memory."""
        return VelocityField(
            np.broadcast_to(np.float32(0), (*self.sequence.resolution, 3)), self.sequence.index_to_world
        )

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

    @cached_property
    def bricks(self) -> Bricks:
        """Return what was read of it; kept, as each frame of a store is needed many times."""
        return Bricks(self)

    def chunk(self, number: tuple[int, int, int]) -> np.ndarray | None:
        """As `VelocityField.chunk`; linear between stored frames."""
        stored = [(self.sequence.chunk(index, number), weight) for index, weight in self._parts]
        known = [(cells, weight) for cells, weight in stored if cells is not None]
        if len(self._parts) == 1 or not known:
            return known[0][0] if known else None
        return reduce(np.add, (np.float32(weight) * cells.astype(np.float32) for cells, weight in known))

    def sample(self, points: np.ndarray) -> np.ndarray:
        """As `VelocityField.sample`; reads the chunks around the points, POOL_BYTES of them at a time."""
        index = self.to_index(points)
        inside = ((index >= 0) & (index <= self.resolution)).all(-1)
        values = np.zeros((int(inside.sum()), 3), np.float32)
        coordinate = np.clip(index[inside] - 0.5, 0, np.array(self.resolution) - 1)
        low = coordinate.astype(np.int64)
        fraction = (coordinate - low).astype(np.float32)
        brick, local = np.divmod(low, CHUNK)
        stride = (low + 1 < self.resolution) * np.array([EDGE * EDGE, EDGE, 1])
        for rows, needed in self.bricks.parts(low, low, np.arange(len(low))):
            pool = self.bricks.pool(needed)
            records = pool.cells.reshape(-1, 4)
            first = pool.table[tuple(brick[rows].T)].astype(np.int64) * EDGE**3 + local[rows] @ np.array(
                [EDGE * EDGE, EDGE, 1]
            )
            blend, to_next = [(1 - f, f) for f in fraction[rows].T], [(0, s) for s in stride[rows].T]
            total = np.zeros((len(rows), 3), np.float32)
            for i, j, k in np.ndindex(2, 2, 2):
                at = first + to_next[0][i] + to_next[1][j] + to_next[2][k]
                total += (blend[0][i] * blend[1][j] * blend[2][k])[:, None] * records.take(at, axis=0)[:, :3]
            values[rows] = total
            del records, pool  # before the next one is made
        out = np.zeros((len(index), 3), np.float32)
        out[inside] = values
        return out


class StoredFields:
    """The fields of a store by time, each with what was read of it for as long as all that fits into KEPT_BYTES.

    Every score of a clip goes through its frames, and asks for about the same chunks. Threads may ask at once.
    """

    def __init__(self, sequence: VelocitySequence):
        self.sequence = sequence
        self._kept: dict[float, StoredField] = {}
        self._one_at_a_time = Lock()

    @property
    def times_s(self) -> np.ndarray:
        return self.sequence.times_s

    def at(self, time_s: float) -> StoredField:
        """Return the field of a time. Raises DataFormatError, when it is read: outside of the stored clock."""
        with self._one_at_a_time:
            field = self._kept.pop(time_s, None) or StoredField(self.sequence, time_s)
            while self._kept and sum(other.bricks.read_bytes for other in self._kept.values()) > KEPT_BYTES:
                del self._kept[next(iter(self._kept))]  # the one that was longest not asked for
            self._kept[time_s] = field
        return field


def fields_of(truth: Any) -> Any:
    """Return what has `.times_s` and `.at(time_s)` as it is; of a store, its `StoredFields`."""
    return StoredFields(truth) if isinstance(truth, VelocitySequence) else truth


@dataclass
class Pool:
    """Bricks in memory: cells (slots, EDGE, EDGE, EDGE, 4) float16 or float32, the last one unused; slot 0 is empty."""

    cells: np.ndarray
    table: np.ndarray  # (bricks per axis) uint32: slot of each chunk
    held: np.ndarray  # bool, same shape: chunks the pool can answer for


class Bricks:
    """The bricks of a gridded field, with the pool of them that was read last, for as long as it answers.

    Args:
        field: in memory, or of a store.
    """

    def __init__(self, field: VelocityField | StoredField):
        self.field = field
        self._pool: Pool | None = None

    @property
    def dtype(self) -> type:
        field = self.field
        stored = field.dtype if isinstance(field, StoredField) else field.velocity.dtype
        return np.float16 if stored == np.float16 else np.float32

    @property
    def read_bytes(self) -> int:
        """How large what was read may be."""
        pool = self._pool  # which another thread may be replacing
        return 0 if pool is None else pool.cells.nbytes

    def cell_ranges(self, position: np.ndarray, scale: np.ndarray, outermost: float) -> tuple[np.ndarray, np.ndarray]:
        """Return first and last cell (M, 3) that nodes up to `outermost` standard deviations along each own axis can
        fall into.

        No node is farther from the centre along grid axis i than |row i of world_to_index| |scale| outermost.
        """
        to_index = np.linalg.inv(self.field.index_to_world)[:3, :3]
        cell = np.floor(np.clip(self.field.to_index(position) - 0.5, -FAR, FAR)).astype(np.int32)
        reach = np.linalg.norm(scale, axis=1)[:, None] * (outermost * np.linalg.norm(to_index, axis=1))
        reach = np.minimum(np.ceil(reach), FAR).astype(np.int32)
        return cell - reach, cell + reach

    def pools(self, position: np.ndarray, scale: np.ndarray, outermost: float) -> Iterator[tuple[np.ndarray, Pool]]:
        """Yield rows of Gaussians, (K,) numbers, with the pool that answers for all their nodes; arguments as in
        `cell_ranges`.

        Let go of a pool before taking the next one: both at once would be the peak of the
        memory.
        """
        if (whole := self._few()) is not None:
            yield np.arange(len(position)), self.pool(whole)
            return
        low, high = self.cell_ranges(position, scale, outermost)
        for rows, needed in self.parts(low, high, np.arange(len(position))):
            yield rows, self.pool(needed)

    def touched(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Return (bricks per axis) bool: the chunks that any of the cell ranges low..high, (M, 3) whole numbers,
        reaches into."""
        if (whole := self._few()) is not None:
            return whole
        size = np.array(self.field.resolution)
        bricks = -(-size // CHUNK)
        meets = ((high + MARGIN >= 0) & (low - MARGIN < size)).all(1)
        first = np.clip(low[meets] - MARGIN, 0, size - 1) // CHUNK
        after = np.clip(high[meets] + MARGIN, 0, size - 1) // CHUNK + 1
        # a million Gaussians share a few thousand ranges
        corners = np.prod(bricks + 1)
        pairs = np.unique(_flat(first, bricks + 1) * corners + _flat(after, bricks + 1))
        first, after = (np.stack(np.unravel_index(half, bricks + 1), 1) for half in np.divmod(pairs, corners))
        marks = np.zeros(bricks + 1, np.int64)  # +1 and -1 at the corners of every range; running sums fill the ranges
        for corner in np.ndindex(2, 2, 2):
            at = _flat(np.where(corner, after, first), marks.shape)
            marks += (-1) ** sum(corner) * np.bincount(at, minlength=marks.size).reshape(marks.shape)
        return marks.cumsum(0).cumsum(1).cumsum(2)[:-1, :-1, :-1] > 0

    def parts(self, low: np.ndarray, high: np.ndarray, rows: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield `rows` with the chunks they touch, halved along the longest side until each part's chunks fit into the
        pool."""
        needed = self.touched(low[rows], high[rows])
        if self._bytes(needed) > POOL_BYTES:
            middle = low[rows] + (high[rows] - low[rows]) // 2
            spread = np.ptp(middle, axis=0)
            if spread.max() >= CHUNK:  # below, halving cannot help
                for half in np.array_split(rows[np.argsort(middle[:, spread.argmax()], kind="stable")], 2):
                    yield from self.parts(low, high, half)
                return
        yield rows, needed

    def pool(self, needed: np.ndarray) -> Pool:
        """Return the pool for chunks of `touched`: the last one, read again with more where it does not hold them."""
        if self._pool is None or (needed & ~self._pool.held).any():
            held = np.zeros_like(needed) if self._pool is None else self._pool.held
            self._pool = None  # first: both at once would be the peak of the memory
            both = needed | held
            self._pool = _fill(self.field, self.dtype, both if self._bytes(both) <= POOL_BYTES else needed)
        return self._pool

    def _few(self) -> np.ndarray | None:
        """Return all chunks, as `touched` does, where they are FEW; else None."""
        bricks = -(-np.array(self.field.resolution) // CHUNK)
        return np.ones(bricks, bool) if bricks.prod() <= FEW else None

    def _bytes(self, needed: np.ndarray) -> int:
        return int(needed.sum()) * EDGE**3 * 4 * np.dtype(self.dtype).itemsize


def _flat(number: np.ndarray, shape) -> np.ndarray:
    """Return (M,) position of (M, 3) numbers in an array of this shape."""
    return np.ravel_multi_index(tuple(number.T), tuple(shape))


def _aligned_zeros(shape: tuple[int, ...], dtype: type) -> np.ndarray:
    """Zeros on a 64-byte boundary; the system hands out the memory page by page, when it is written to."""
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    raw = np.zeros(size + 64, np.uint8)
    start = -raw.ctypes.data % 64
    return raw[start : start + size].view(dtype).reshape(shape)


def _fill(field: VelocityField | StoredField, dtype: type, needed: np.ndarray) -> Pool:
    numbers = [tuple(n) for n in np.argwhere(needed).tolist()]
    cells = _aligned_zeros((1 + len(numbers), EDGE, EDGE, EDGE, 4), dtype)  # slots that stay empty take no memory

    def load(slot: int) -> bool:
        chunk = field.chunk(numbers[slot - 1])
        if chunk is not None:
            x, y, z = chunk.shape[:3]
            for k in range(3):  # three times as fast as all components at once
                cells[slot, :x, :y, :z, k] = chunk[..., k]
        return chunk is not None

    slots = range(1, len(numbers) + 1)
    if len(numbers) > 1:
        with ThreadPoolExecutor(os.cpu_count()) as threads:  # decompression and copying run without Python's lock
            full = list(threads.map(load, slots))
    else:  # threads would cost more than the chunk
        full = [load(slot) for slot in slots]
    slot_of = {number: slot for slot, number in enumerate(numbers, 1)}
    filled = {number for number, has_flow in zip(numbers, full, strict=True) if has_flow}
    table = np.zeros(needed.shape, np.uint32)
    upper = [d for d in np.ndindex(2, 2, 2) if any(d)]
    for number, slot in slot_of.items():  # the last layer of a brick comes from its upper neighbours
        neighbours = [(d, n) for d in upper if (n := tuple(a + b for a, b in zip(number, d, strict=True))) in filled]
        for d, neighbour in neighbours:
            to, source = (tuple(edge if k else slice(CHUNK) for k in d) for edge in (CHUNK, 0))
            cells[(slot, *to)] = cells[(slot_of[neighbour], *source)]
        if neighbours or number in filled:
            table[number] = slot
    return Pool(cells, table, needed)
