"""Sums over the pixels of a block, many at a time: see `gof.render.native.lanes`."""

from __future__ import annotations

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

from gof.render.native.lanes import FLAGS, LANES, elements, pointer_to, shuffle, use_wide_registers, vector

MOMENTS = {"1": 0, "x": 1, "xx": 2, "y": 4, "xy": 5, "yy": 8}  # lane of `block_sums` with sum d, sum d dx, ...
PLAIN = (12, 3, 7, 11, 15, 9, 13, 6, 10, 14)  # lanes with the sums of the other blocks


@intrinsic
def block_sums(typing, d, dx, dy, others):
    """Sum over the 16 pixels d times 1, dx, dx^2, dy, dx dy, dy^2, and up to ten other blocks; one sum per lane.

    dx must be the same in every row, so rows are summed before anything is multiplied by it: four blocks fold into one
    whose four quads hold the sums of their columns.
    """

    def emit(context, builder, signature, values):
        use_wide_registers(builder)
        d, dx, dy, others = values
        fold = _Folding(builder)
        plain = [*elements(builder, others), *[None] * 10][:10] if len(signature.args[3]) else [None] * 10
        d_dy = fold.times(d, dy)
        first = fold.rows(d, d_dy, fold.times(d_dy, dy), plain[0])
        second = fold.times(first, dx)  # its quads 0 and 1 are moments; 2 and 3 are free for others
        third = fold.times(second, dx)  # quad 0 is a moment
        fourth = fold.rows(*plain[1:5])
        second = fold.replaced(second, 8, fold.rows(None, None, *plain[5:7]))
        third = fold.replaced(third, 4, fold.rows(None, *plain[7:10]))
        return fold.columns(first, second, third, fourth)

    return vector(d, dx, dy, others), emit


@intrinsic
def store_plain_sums(typing, arrays, index, sums):
    """arrays[k][index] = sums[PLAIN[k]]."""

    def emit(context, builder, signature, values):
        for array, lane in zip(elements(builder, values[0]), PLAIN, strict=False):
            place = pointer_to(context, builder, signature.args[2], values[2], ir.Constant(values[1].type, lane))
            builder.store(builder.load(place), pointer_to(context, builder, signature.args[0].dtype, array, values[1]))
        return context.get_dummy_value()

    return types.void(arrays, types.int64, sums), emit


class _Folding:
    """Sums of vectors by halves: what costs is one shuffle or two and an addition, for two vectors at a time."""

    HALVES = [*range(8), *range(16, 24)], [*range(8, 16), *range(24, 32)]
    QUADS = [k for q in (0, 8, 16, 24) for k in range(q, q + 4)], [k for q in (4, 12, 20, 28) for k in range(q, q + 4)]

    def __init__(self, builder):
        self.builder = builder

    def times(self, x, y):
        return self.builder.fmul(x, y, flags=FLAGS)

    def replaced(self, x, start, y):
        """x with the lanes of y from `start` on; None changes nothing."""
        return x if y is None else shuffle(self.builder, x, [*range(start), *range(16 + start, 32)], y)

    def rows(self, a, b, c, d):
        """Quads a, b, c, d: the sums of each one's columns. None is nothing; all None give None."""
        return self._pair(self._pair(a, b, *self.HALVES), self._pair(c, d, *self.HALVES), *self.QUADS)

    def columns(self, a, b, c, d):
        """Lane 4 q + 0, 1, 2, 3: the sum of quad q of a, b, c, d."""
        near = [self._near(1), self._near(2)]
        return self._pair(self._pair(a, b, *near[0]), self._pair(c, d, *near[0]), *near[1])

    def _near(self, distance):
        low = [k // (2 * distance) * 2 * distance + k % distance + 16 * (k // distance % 2) for k in range(LANES)]
        return low, [k + distance for k in low]

    def _pair(self, x, y, low, high):
        """Lanes `low` plus lanes `high` of x and y together."""
        if x is None and y is None:
            return None
        x, y = y if x is None else x, x if y is None else y
        shuffled = [shuffle(self.builder, x, lanes, y) for lanes in (low, high)]
        return self.builder.fadd(*shuffled, flags=FLAGS)
