"""Lists of the Gaussians that touch each 4x4 pixel block, front to back.

Everything is one flat data-parallel step (no per-Gaussian loop), so one Gaussian that covers the image costs the same
per block as a million small ones:

  Gaussians in depth order -> the block rows each touches -> the span of blocks in each row -> (block, Gaussian) pairs
  -> stable counting sort by block.

The sort is stable, so pairs of one block stay in depth order, and Gaussians of equal depth in index order. An image
that needs more pairs than a budget is binned in bands of block rows, one after another.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import drjit as dr
import numpy as np

from gof.render.backend import BACKEND, Array2u, Array4f, Float, Int, UInt, pack, pack_words
from gof.render.project import LOG2_E, Projected

BLOCK = 4  # pixels along one side of a block
LOG2_255 = 7.994353436858858  # alpha >= 1/255 is drawn
MARGIN = 1e-3  # in log2 units and pixels: the test keeps pairs that rounding might move
GROUP = 2048  # blocks that are drawn one after another by length, before the next such group
PAIR_BUDGET = 1 << 24  # pairs binned at a time; a pair takes about 40 bytes while binning
# Bits of a key that are sorted at a time. On a GPU Dr.Jit's counting sort keeps the order of equal keys only while
# each warp has counters of its own in shared memory; with more keys it takes atomics, and lists lose their depth order.
DIGIT_BITS = 8 if BACKEND == "cuda" else 32


class Canvas(NamedTuple):
    """Pictures of one size, px, that stand one below the other; each begins with a row of blocks of its own."""

    width: int
    height: int
    pictures: int = 1

    @property
    def columns(self) -> int:
        """Blocks in a row."""
        return -(-self.width // BLOCK)

    @property
    def picture_rows(self) -> int:
        """Rows of blocks of one picture."""
        return -(-self.height // BLOCK)

    @property
    def rows(self) -> int:
        return self.pictures * self.picture_rows


@dataclass
class Ellipses:
    """Bounds of the pixels whose centre may get alpha >= 1/255 (conservative), N entries each.

    In the pixel row at dy from its mean, a Gaussian reaches it in mean_x + slope dy +- sqrt(half_width2 - shrink dy^2).
    """

    slope: Float
    shrink: Float
    half_width2: Float
    first_row: Int  # seen in block rows [first_row, end_row)
    end_row: Int
    width: UInt  # blocks per row, at most


@dataclass
class Footprints:
    """Bounds of N Gaussians in the picture, as records of 8 words in depth order.

    A record is mean_x, mean_y, slope, shrink, half_width2 (floats), first_row, end_row (integers), Gaussian; see
    `Ellipses`.
    """

    records: Float
    first_row: Int  # (N,) by depth
    end_row: Int
    order: UInt  # (N,) Gaussians by depth
    bound: UInt  # (N,) blocks per row, at most, in the Gaussians' own order
    columns: int
    rows: int


@dataclass
class Lists:
    """Arrays of a band that the blend kernels read. Blocks are numbered from the band's first."""

    gaussian: UInt  # (M,) index of the Gaussian, by block, front to back; one unused entry when there is no pair
    start: UInt  # (B,) first pair of block b
    end: UInt  # (B,)
    order: UInt  # (B,) blocks from longest to shortest list within groups: neighbouring lanes do equal work
    first_row: UInt  # (1,) of the band


@dataclass
class Bins:
    """One band."""

    pairs: int  # M
    lists: Lists
    slot: UInt  # (M,) place of each pair in Gaussian-major order
    segment: UInt  # (N,) first Gaussian-major pair of each Gaussian, by depth rank
    segment_end: UInt


def ellipses(p: Projected, canvas: Canvas) -> Ellipses:
    """Arrays come in detached, and leave unevaluated."""
    reach = p.log2_opacity + (LOG2_255 + MARGIN)
    drawn = p.visible & (reach > 0)
    mahalanobis2 = dr.maximum(reach, 0.0) * (2.0 / LOG2_E)
    half_height = dr.sqrt(mahalanobis2 * p.cov_yy) + MARGIN
    half_width = dr.sqrt(mahalanobis2 * p.cov_xx) + MARGIN
    y = p.mean_y if p.top is None else p.mean_y - Float(BLOCK * p.top)
    first_row, end_row = _span(y - half_height, y + half_height, canvas.picture_rows)
    if p.top is not None:  # cut at its own picture's edges, it cannot reach into the next
        first_row, end_row = first_row + Int(p.top), end_row + Int(p.top)
    first_column, end_column = _span(p.mean_x - half_width, p.mean_x + half_width, canvas.columns)
    drawn &= end_column > first_column
    inverse = dr.rcp(p.cov_yy)
    shrink = p.det * inverse * inverse
    end_row = dr.select(drawn, end_row, first_row)
    width = UInt(end_column - first_column)
    return Ellipses(p.cov_xy * inverse, shrink, mahalanobis2 * p.cov_yy * shrink, first_row, end_row, width)


def footprints(p: Projected, canvas: Canvas) -> Footprints:
    """`ellipses` in order of depth; arrays come in detached."""
    e = ellipses(p, canvas)
    integers = [e.first_row, e.end_row, dr.arange(UInt, len(p.depth))]
    ellipse = [p.mean_x, p.mean_y, e.slope, e.shrink, e.half_width2]
    unsorted = pack(ellipse + [dr.reinterpret_array(Float, v) for v in integers], 8)
    # Depths are positive, so their bits sort like the numbers.
    order = dr.argsort(dr.select(p.visible, dr.reinterpret_array(UInt, p.depth), 0xFFFFFFFF))
    front, back = dr.gather(Array4f, unsorted, 2 * order), dr.gather(Array4f, unsorted, 2 * order + 1)
    first_row, end_row = (dr.reinterpret_array(Int, back[k]) for k in (1, 2))
    dr.schedule(first_row, end_row)
    out = Footprints(pack([*front, *back], 8), first_row, end_row, order, e.width, canvas.columns, canvas.rows)
    dr.eval(out)
    return out


def plan_bands(f: Footprints, budget: int = PAIR_BUDGET) -> list[tuple[int, int]]:
    """Bands [first block row, end) of at most `budget` pairs each by bounding boxes, or of one row."""
    bound = Float(dr.gather(UInt, f.bound, f.order))
    if float(dr.sum(Float(f.end_row - f.first_row) * bound)[0]) <= budget:
        return [(0, f.rows)]
    drawn = f.end_row > f.first_row
    change = dr.zeros(Float, f.rows + 1)
    dr.scatter_add(change, bound, UInt(f.first_row), drawn)
    dr.scatter_add(change, -bound, UInt(f.end_row), drawn)
    return as_bands(np.cumsum(change.numpy().astype(np.float64))[: f.rows], budget)


def as_bands(pairs: np.ndarray, budget: int) -> list[tuple[int, int]]:
    """Return rows with so many pairs each, as bands [first row, end) of at most `budget` pairs or of one row."""
    bands, first, total = [], 0, 0
    for row, n in enumerate(pairs.tolist()):
        if row > first and total + n > budget:
            bands.append((first, row))
            first, total = row, 0
        total += n
    return [*bands, (first, len(pairs))]


def bin_band(f: Footprints, first_row: int, end_row: int) -> Bins:
    """Pairs of the Gaussians with the blocks of rows [first_row, end_row)."""
    from_row, to_row = dr.opaque(Int, first_row), dr.opaque(Int, end_row)
    first = dr.maximum(f.first_row, from_row)
    owner, row_in_owner, owner_start, owner_end = expand(UInt(dr.maximum(dr.minimum(f.end_row, to_row) - first, 0)))
    if len(owner) == 0:
        return _empty(f, first_row, end_row)

    x, y, slope, shrink = dr.gather(Array4f, f.records, 2 * owner)
    half_width2, owner_row, _, gaussian = dr.gather(Array4f, f.records, 2 * owner + 1)
    gaussian = dr.reinterpret_array(UInt, gaussian)
    row = dr.maximum(dr.reinterpret_array(Int, owner_row), from_row) + Int(row_in_owner)
    lo, hi = Float(dr.inf), Float(-dr.inf)
    for j in range(BLOCK):
        dy = Float(BLOCK * row + j) + 0.5 - y
        inside = half_width2 - dy * dy * shrink
        half = dr.sqrt(dr.maximum(inside, 0.0)) + MARGIN
        hit = inside > -MARGIN
        centre = x + slope * dy
        lo = dr.minimum(lo, dr.select(hit, centre - half, dr.inf))
        hi = dr.maximum(hi, dr.select(hit, centre + half, -dr.inf))
    first_column, end_column = _span(lo, hi, f.columns)
    base = UInt((row - from_row) * f.columns + first_column)
    counts = UInt(end_column - first_column)
    dr.schedule(counts)
    words = pack_words(base, gaussian)  # (block, Gaussian) travel as pairs of words: one load each instead of two
    item, within, item_start, item_end = expand(counts)
    if len(item) == 0:
        return _empty(f, first_row, end_row)
    some = owner_end > owner_start
    segment = dr.gather(UInt, item_start, owner_start, some)
    segment_end = dr.gather(UInt, item_end, owner_end - 1, some)
    base, gaussian = dr.gather(Array2u, words, item)
    block = base + within
    dr.schedule(block)
    return _sort(block, pack_words(block, gaussian), segment, segment_end, f, first_row, end_row)


def expand(counts: UInt) -> tuple[UInt, UInt, UInt, UInt]:
    """Item i repeated counts[i] times: (item (M,), number within the item (M,), first and end place of each item)."""
    ends = dr.prefix_reduce(dr.ReduceOp.Add, counts, exclusive=False)
    starts = ends - counts
    dr.eval(starts)
    total = int(ends[len(ends) - 1])
    if total == 0:
        return UInt(), UInt(), starts, ends
    heads = dr.zeros(UInt, total)
    dr.scatter(heads, dr.arange(UInt, len(counts)), starts, counts > 0)
    item = dr.prefix_reduce(dr.ReduceOp.Max, heads, exclusive=False)
    return item, dr.arange(UInt, total) - dr.gather(UInt, starts, item), starts, ends


def stable_order(keys: UInt, count: int) -> UInt:
    """Return the permutation that sorts keys below `count`; equal keys keep their order."""
    bits = (count - 1).bit_length()
    passes = max(1, -(-bits // DIGIT_BITS))
    digit_bits = -(-bits // passes)
    order = None
    for k in range(passes):
        sorted_so_far = keys if order is None else dr.gather(UInt, keys, order)
        digit = sorted_so_far if passes == 1 else (sorted_so_far >> (k * digit_bits)) & ((1 << digit_bits) - 1)
        step = dr.detail.block_mkperm(digit, len(keys), 1 << digit_bits)
        order = step if order is None else dr.gather(UInt, order, step)
    return order


def _span(lo: Float, hi: Float, limit: int) -> tuple[Int, Int]:
    """Blocks [first, end) with a pixel centre in [lo, hi] along one axis, clipped to the image."""
    far = float(BLOCK * limit + 8)
    first_pixel = Int(dr.ceil(dr.clip(lo, -8.0, far) - 0.5))
    last_pixel = Int(dr.floor(dr.clip(hi, -8.0, far) - 0.5))
    some = last_pixel >= first_pixel
    first = dr.clip(first_pixel >> 2, 0, limit - 1)
    end = dr.minimum((last_pixel >> 2) + 1, limit)
    return first, dr.select(some, dr.maximum(end, first), first)


def _sort(
    block: UInt, pairs: UInt, segment: UInt, segment_end: UInt, f: Footprints, first_row: int, end_row: int
) -> Bins:
    """Order (block, Gaussian) pairs by block; pairs of one block keep their order."""
    n_blocks, n = f.columns * (end_row - first_row), len(block)
    i, last = dr.arange(UInt, n), dr.opaque(UInt, n - 1)
    slot = stable_order(block, n_blocks)
    block, gaussian = dr.gather(Array2u, pairs, slot)
    dr.eval(block, gaussian)

    previous = dr.gather(UInt, block, i - 1, i > 0)
    begins = (i == 0) | (previous != block)
    start, end = dr.zeros(UInt, n_blocks), dr.zeros(UInt, n_blocks)
    dr.scatter(start, i, block, begins, mode=dr.ReduceMode.NoConflicts)
    dr.scatter(end, i, previous, begins & (i > 0), mode=dr.ReduceMode.NoConflicts)
    dr.scatter(end, i + 1, block, i == last, mode=dr.ReduceMode.NoConflicts)
    # Lanes of equal work side by side, within groups of rows that share Gaussians in the cache.
    group = dr.arange(UInt, n_blocks) // GROUP
    key = group * 256 + (255 - dr.minimum((end - start) >> 2, 255))
    order = stable_order(key, 256 * -(-n_blocks // GROUP))
    dr.eval(start, end)
    return Bins(n, Lists(gaussian, start, end, order, dr.opaque(UInt, first_row)), slot, segment, segment_end)


def _empty(f: Footprints, first_row: int, end_row: int) -> Bins:
    n, g = f.columns * (end_row - first_row), len(f.order)
    empty = [dr.zeros(UInt, k) for k in (1, n, n, 1, g, g)]
    dr.make_opaque(empty)  # memory, as in the usual case: the same kernels run
    gaussian, start, end, slot, segment, segment_end = empty
    order = dr.arange(UInt, n)
    dr.make_opaque(order)
    return Bins(0, Lists(gaussian, start, end, order, dr.opaque(UInt, first_row)), slot, segment, segment_end)
