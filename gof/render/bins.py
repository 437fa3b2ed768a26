"""Which Gaussians touch which 4x4 pixel block, front to back.

Everything is one flat data-parallel step (no per-Gaussian loop), so one Gaussian that covers the image costs the same per
block as a million small ones:

  Gaussians in depth order -> the block rows each touches -> the span of blocks in each row -> (block, Gaussian) pairs
  -> stable counting sort by block.

The sort is stable, so pairs of one block stay in depth order, and Gaussians of equal depth in index order.
"""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr

from gof.render.backend import Bool, Float, Int, UInt
from gof.render.project import Projected

BLOCK = 4                       # pixels along one side of a block
LOG2_255 = 7.994353436858858    # alpha >= 1/255 is drawn
MARGIN = 1e-3                   # in log2 units and pixels: the test keeps pairs that rounding might move


@dataclass
class Bins:
    """Pairs sorted by block, and where each block's list starts."""

    pairs: int          # M
    gaussian: UInt      # (M,) index of the Gaussian; one unused entry when there is no pair
    start: UInt         # (B,) first pair of block b
    end: UInt           # (B,)
    order: UInt         # (B,) blocks from longest to shortest list: neighbouring lanes do equal work
    columns: int        # blocks per row
    rows: int


def expand(counts: UInt) -> tuple[UInt, UInt, int]:
    """Item i repeated counts[i] times: (item (M,), index within the item (M,), M)."""
    ends = dr.prefix_reduce(dr.ReduceOp.Add, counts, exclusive=False)
    total = int(ends[len(ends) - 1]) if len(ends) else 0
    if total == 0:
        return UInt(), UInt(), 0
    starts = ends - counts
    heads = dr.zeros(UInt, total)
    items = dr.arange(UInt, len(counts))
    dr.scatter(heads, items, starts, counts > 0)
    item = dr.prefix_reduce(dr.ReduceOp.Max, heads, exclusive=False)
    return item, dr.arange(UInt, total) - dr.gather(UInt, starts, item), total


def bin_gaussians(p: Projected, width: int, height: int) -> Bins:
    """Pairs of all drawable Gaussians with the blocks in which some pixel centre gets alpha >= 1/255 (conservative)."""
    columns, rows = -(-width // BLOCK), -(-height // BLOCK)
    with dr.suspend_grad():
        return _bin(p, columns, rows)


def _bin(p: Projected, columns: int, rows: int) -> Bins:
    order = dr.argsort(dr.select(p.visible, dr.detach(p.depth), dr.inf))
    g = lambda v: dr.gather(Float, dr.detach(v), order)  # noqa: E731
    mean_x, mean_y = g(p.mean_x), g(p.mean_y)
    xy, yy, det = g(p.cov_xy), g(p.cov_yy), g(p.det)
    # The drawn ellipse: a dx^2 + b dx dy + c dy^2 <= reach. In one pixel row at dy it is the interval
    # mean_x + slope dy +- sqrt(half^2 - dy^2 shrink).
    reach = g(p.log2_opacity) + (LOG2_255 + MARGIN)
    drawn = dr.gather(Bool, p.visible, order) & (reach > 0)
    mahalanobis2 = dr.maximum(reach, 0.0) * (2.0 / 1.4426950408889634)
    half_height = dr.sqrt(mahalanobis2 * yy) + MARGIN
    half_width2 = mahalanobis2 * det / yy
    slope, shrink = xy / yy, det / (yy * yy)

    first_row, end_row = _span(mean_y - half_height, mean_y + half_height, rows)
    row_counts = dr.select(drawn & (mean_x > -1e7), UInt(dr.maximum(end_row - first_row, 0)), 0)
    dr.eval(row_counts, first_row, mean_x, mean_y, half_width2, slope, shrink)
    owner, row_in_owner, n_rows = expand(row_counts)
    if n_rows == 0:
        return _empty(columns, rows)

    h = lambda v: dr.gather(type(v), v, owner)  # noqa: E731
    row = h(first_row) + Int(row_in_owner)
    x, y, w2, s, k = h(mean_x), h(mean_y), h(half_width2), h(slope), h(shrink)
    lo, hi = Float(dr.inf), Float(-dr.inf)
    for j in range(BLOCK):
        dy = Float(BLOCK * row + j) + 0.5 - y
        inside = w2 - dy * dy * k
        half = dr.sqrt(dr.maximum(inside, 0.0)) + MARGIN
        hit = inside > -MARGIN
        centre = x + s * dy
        lo = dr.minimum(lo, dr.select(hit, centre - half, dr.inf))
        hi = dr.maximum(hi, dr.select(hit, centre + half, -dr.inf))
    first, end = _span(lo, hi, columns)
    span_counts = UInt(dr.maximum(end - first, 0))
    base = UInt(row * columns + first)
    dr.eval(span_counts, base, owner)
    item, within, n_pairs = expand(span_counts)
    if n_pairs == 0:
        return _empty(columns, rows)
    block = dr.gather(UInt, base, item) + within
    gaussian = dr.gather(UInt, order, dr.gather(UInt, owner, item))
    dr.eval(block, gaussian)
    return _sort(block, gaussian, columns, rows)


def _span(lo: Float, hi: Float, limit: int) -> tuple[Int, Int]:
    """Blocks [first, end) with a pixel centre in [lo, hi] along one axis, clipped to the image."""
    far = float(BLOCK * limit + 8)
    first_pixel = Int(dr.ceil(dr.clip(lo, -8.0, far) - 0.5))
    last_pixel = Int(dr.floor(dr.clip(hi, -8.0, far) - 0.5))
    some = last_pixel >= first_pixel
    first = dr.maximum(first_pixel >> 2, 0)
    end = dr.minimum((last_pixel >> 2) + 1, limit)
    return first, dr.select(some, end, first)


def _sort(block: UInt, gaussian: UInt, columns: int, rows: int) -> Bins:
    n_blocks, n = columns * rows, len(block)
    by_block = dr.detail.block_mkperm(block, n, _power_of_two(n_blocks))
    sorted_block = dr.gather(UInt, block, by_block)
    sorted_gaussian = dr.gather(UInt, gaussian, by_block)
    dr.eval(sorted_block, sorted_gaussian)

    i, last = dr.arange(UInt, n), dr.opaque(UInt, n - 1)
    previous = dr.gather(UInt, sorted_block, i - 1, i > 0)
    following = dr.gather(UInt, sorted_block, i + 1, i < last)
    start, end = dr.zeros(UInt, n_blocks), dr.zeros(UInt, n_blocks)
    dr.scatter(start, i, sorted_block, (i == 0) | (previous != sorted_block), mode=dr.ReduceMode.NoConflicts)
    dr.scatter(end, i + 1, sorted_block, (i == last) | (following != sorted_block), mode=dr.ReduceMode.NoConflicts)
    shortness = 2047 - dr.minimum(end - start, 2047)
    order = dr.detail.block_mkperm(shortness, n_blocks, 2048)
    return Bins(n, sorted_gaussian, start, end, order, columns, rows)


def _empty(columns: int, rows: int) -> Bins:
    n = columns * rows
    bins = Bins(0, dr.zeros(UInt, 1), dr.zeros(UInt, n), dr.zeros(UInt, n), dr.arange(UInt, n), columns, rows)
    dr.make_opaque(bins.gaussian, bins.start, bins.end)     # memory, as in the usual case: the same kernels run
    return bins


def _power_of_two(n: int) -> int:
    return 1 << max(0, (n - 1).bit_length())
