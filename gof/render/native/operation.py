"""The native kernels as a Dr.Jit operation: projected Gaussians in, planes out, and the gradients back.

Dr.Jit packs the records, the kernels read and write Dr.Jit's memory (aligned to cache lines, which halves their time,
and reused from step to step).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import drjit as dr
import numpy as np

from gof.core.errors import DataFormatError
from gof.render.backend import Float, UInt, scattered
from gof.render.bins import BLOCK, as_bands, ellipses
from gof.render.blend import GEOMETRY, as_plane, hand_back
from gof.render.native import blending, lists
from gof.render.native.threads import even_parts, run, thread_count

CHUNKS = 16  # parts of the picture for each thread; a free thread takes the next
REPEATABLE_CHUNKS = 64  # in deterministic mode, however many threads there are
REPEATABLE_PARTS = 4  # sums of gradients in deterministic mode, however many threads there are
MOST_BLOCKS = 0xFFFF  # along a side: two of these share a word


@dataclass
class _Band:
    """Inputs from which a band of block rows is drawn."""

    first_row: int
    start: np.ndarray  # (blocks + 1,) first pair of each block
    gaussians: np.ndarray  # (pairs,) by block, front to back

    @property
    def pairs(self) -> int:
        return int(self.start[-1])

    def chunks(self, count: int) -> np.ndarray:
        """(C, 2) int64: [begin, end) of blocks, about equally much work."""
        work = self.start + 4 * np.arange(len(self.start), dtype=np.int64)  # an empty block still is written
        ends = np.searchsorted(work, np.linspace(0, work[-1], count + 1)).tolist()
        return np.array([(a, b) for a, b in pairwise(ends) if a < b], np.int64).reshape(-1, 2)


class NativeBlend(dr.CustomOp):
    """See `gof.render.rasterizer.blend`."""

    def eval(self, geometry, channels, projected, canvas, trace, deterministic, pair_budget, max_alpha, absgrad):
        self.trace, self.deterministic = trace, deterministic
        self.max_alpha, self.absgrad = np.float32(max_alpha), absgrad
        self.n, self.n_channels = len(geometry[0]), len(channels)
        self._prepare(geometry + channels, projected, canvas)
        bands = self._plan(pair_budget)
        planes = [dr.empty(Float, self.rows * self.columns * BLOCK * BLOCK) for _ in range(self.n_channels + 1)]
        # Views now: of an array that something else refers to Dr.Jit hands out a copy.
        self.planes = tuple(plane.numpy() for plane in planes)
        for rows in bands:
            band = self._bin(*rows)
            self._run_forward(band)
            trace.pairs += band.pairs
        trace.bands = len(bands)
        self.bands = [band] if len(bands) == 1 else bands  # several: binned again in the backward pass
        return planes

    def _prepare(self, columns, projected, canvas) -> None:
        """Make the records, the shapes, and the list of drawn Gaussians by depth."""
        self.columns, self.rows = canvas.columns, canvas.rows
        if max(self.columns, self.rows) > MOST_BLOCKS:
            many = f"{canvas.pictures} pictures" if canvas.pictures > 1 else "a picture"
            size = f"{canvas.width}x{canvas.height}"
            raise DataFormatError(f"{many} of {size} is too large: {MOST_BLOCKS * BLOCK} pixels a side")
        ellipse = ellipses(projected, canvas)
        spans = UInt(ellipse.first_row) | (UInt(ellipse.end_row) << 16)
        shape = [ellipse.slope, ellipse.shrink, ellipse.half_width2, dr.reinterpret_array(Float, spans)]
        depth = dr.reinterpret_array(UInt, projected.depth)
        self.memory = [
            scattered([dr.detach(Float(c)) for c in columns], lists.RECORD),
            scattered(shape, lists.SHAPE),
            ellipse.width,
            depth,
        ]
        dr.eval(self.memory)
        self.records, self.shapes, self.widths, depth = (array.numpy() for array in self.memory)
        self.bits = self.shapes.view(np.uint32)
        work = [_integers(self.n) for _ in range(4)]
        drawn = lists.sort_by_depth(depth, self.bits, *work)
        self.order = work[2][:drawn]

    def _plan(self, budget: int) -> list[tuple[int, int]]:
        return as_bands(lists.pairs_by_row(self.bits, self.widths, self.rows), budget)

    def _bin(self, first_row: int, end_row: int) -> _Band:
        """Make the lists of block rows [first_row, end_row)."""
        columns, rows = self.columns, end_row - first_row
        parts = even_parts(self.n, thread_count())
        first_span = _integers(self.n + 1)
        spans = _integers(lists.count_spans(self.bits, first_row, end_row, first_span))
        change = np.zeros((len(parts), rows * (columns + 1)), np.int32)

        def find(part, begin, end):
            where = (first_row, end_row, first_span, columns, spans, change[part])
            lists.find_spans(begin, end, self.records, self.shapes, self.bits, *where)

        run(find, [(k, *part) for k, part in enumerate(parts)])
        start = np.empty(rows * columns + 1, np.uint32)
        lists.begin_lists(change, rows, columns, start)
        band, cursor = _Band(first_row, start, _integers(start[-1])), start[:-1].copy()

        def fill(begin, end):
            rows = (first_row, first_row + begin, first_row + end, end_row)
            lists.fill_lists(self.order, self.bits, first_span, spans, *rows, columns, cursor, band.gaussians)

        ends = np.searchsorted(start[::columns], np.linspace(0, band.pairs, thread_count() + 1)).tolist()
        ends[-1] = rows
        run(fill, [(a, b) for a, b in pairwise(ends) if a < b])
        return band

    def _run_forward(self, band: _Band) -> None:
        chunks, taken = band.chunks(CHUNKS * thread_count()), _none_taken()

        def draw():
            where = (chunks, taken, self.columns, band.first_row)
            blending.forward(self.records, band.gaussians, band.start, *where, self.planes, self.max_alpha)

        run(draw, [()] * thread_count())

    def backward(self):
        given = self.grad_out()
        dr.schedule(given)  # one kernel for all of them: what they share is computed once
        upstream = [as_plane(g, len(self.planes[0])) for g in given]
        grads = tuple(plane.numpy() for plane in upstream)
        parts = REPEATABLE_PARTS if self.deterministic else thread_count()
        memory = dr.empty(Float, parts * self.n * lists.RECORD)
        sums = memory.numpy().reshape(parts, -1)
        pieces = even_parts(self.n, thread_count())
        run(lambda p, begin, end: blending.clear(begin, end, self.bits, sums[p]), _pairs(range(parts), pieces))
        for band in self.bands:
            self._run_backward(band if isinstance(band, _Band) else self._bin(*band), grads, sums)
        columns = [dr.empty(Float, self.n) for _ in range(GEOMETRY + self.n_channels + 2 * self.absgrad)]
        views = tuple(column.numpy() for column in columns)
        out = self.bits, self.records, sums, views[:GEOMETRY], views[GEOMETRY:]
        run(lambda begin, end: blending.gradients(begin, end, *out), pieces)
        hand_back(self, columns)

    def _run_backward(self, band: _Band, grads: tuple, sums: np.ndarray) -> None:
        chunks = band.chunks(REPEATABLE_CHUNKS if self.deterministic else CHUNKS * thread_count())
        parts, taken = len(sums), _none_taken()

        def work(p):
            # A free thread takes the next chunk; repeatable is only what is given out beforehand.
            own = (np.ascontiguousarray(chunks[p::parts]), _none_taken()) if self.deterministic else (chunks, taken)
            args = (self.records, band.gaussians, band.start, *own, self.columns, band.first_row, self.planes, grads)
            blending.backward(*args, self.max_alpha, True if self.absgrad else None, sums[p])

        run(work, [(p,) for p in range(parts)])

    def name(self):
        return "native blend"


def _none_taken() -> np.ndarray:
    return np.zeros(1, np.int64)


def _integers(n: int) -> np.ndarray:
    """(n,) uint32, not set, in Dr.Jit's memory; at least one, as Dr.Jit has no empty memory."""
    return dr.empty(UInt, max(int(n), 1)).numpy()[: int(n)]


def _pairs(xs, pieces) -> list[tuple]:
    return [(x, *piece) for x in xs for piece in pieces]
