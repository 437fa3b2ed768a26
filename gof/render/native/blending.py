"""Front-to-back alpha blending and its adjoint: the 16 pixels of a block are one vector, and walk the block's list.

The mathematics and its derivation stand in `gof.render.blend` and docs/renderer_inside.md. A Gaussian's record is a
cache line: mean_x, mean_y, a, b, c, log2_opacity and up to ten channels. Its gradient is one too, made of `block_sums`.
"""

from __future__ import annotations

import numpy as np
from numba.core import types
from numba.extending import overload

from gof.render.bins import BLOCK, LOG2_255
from gof.render.blend import GEOMETRY, MIN_TRANSMITTANCE
from gof.render.blend import LN_2 as LN_2_F64
from gof.render.native.block_sums import MOMENTS, block_sums, store_plain_sums
from gof.render.native.compiled import kernel, part
from gof.render.native.lanes import (
    absolute,
    add_weighted,
    block_columns,
    block_rows,
    exp2,
    get,
    inner_product,
    load,
    load_blocks,
    minimum,
    prefetch,
    ratio,
    scaled,
    some,
    spread,
    store,
    store_blocks,
    take_next,
    weighted_sum,
    where,
    zeros,
)
from gof.render.native.lists import RECORD, rows_of

AHEAD = 32  # pairs whose records are fetched before they are needed
LN_2, TWO = np.float32(LN_2_F64), np.float32(2)
ALL_ROWS = 1 << 16
NEVER = np.float32(np.inf)
ONE, XX, X, Y, XY, YY = (MOMENTS[name] for name in ("1", "xx", "x", "y", "xy", "yy"))


@part
def _offsets(records, g, x, y):
    return x - get(records, g), y - get(records, g + 1)


@part
def _alpha(records, g, x, y, max_alpha):
    """Alpha of 16 pixels, 0 where it is below 1/255."""
    dx, dy = _offsets(records, g, x, y)
    a, b, c, log2_opacity = get(records, g + 2), get(records, g + 3), get(records, g + 4), get(records, g + 5)
    log2_alpha = (log2_opacity - dy * c * dy) - (dx * a + dy * b) * dx
    return where(log2_alpha >= -LOG2_255, minimum(exp2(log2_alpha), max_alpha), 0.0)


@part
def _absorb(alpha, T, stop):
    """(alpha, 0 in pixels that have stopped; transmittance behind it; `stop`).

    `stop` is the transmittance below which a pixel stops: MIN_TRANSMITTANCE, and NEVER once it has.
    """
    rest = T - T * alpha
    lives = rest >= stop
    return where(lives, alpha, 0.0), where(lives, rest, T), where(lives, stop, NEVER)


@part
def _record(lists, i):
    return np.int64(get(lists, i)) * RECORD


@part
def _pixels(block, columns, first_row):
    """Centres of a block's pixels, and where it begins in a plane."""
    row = block // columns
    column = block - row * columns
    row += first_row
    x = block_columns() + np.float32(np.float32(column * BLOCK) + np.float32(0.5))
    y = block_rows() + np.float32(np.float32(row * BLOCK) + np.float32(0.5))
    return x, y, (row * BLOCK * columns + column) * BLOCK


@kernel
def forward(records, lists, start, chunks, taken, columns, first_row, planes, max_alpha):
    """Draw chunks of a band into the planes: one per channel, then alpha.

    chunks: (C, 2), blocks [begin, stop) of each.   taken: (1,) how many of them have begun; threads that share it share
    the chunks, and a free one takes the next.
    """
    k = take_next(taken)
    while k < len(chunks):
        blocks = chunks[k, 0], chunks[k, 1]
        _draw_blocks(records, lists, start, *blocks, columns, first_row, planes, max_alpha)
        k = take_next(taken)


@part
def _draw_blocks(records, lists, start, begin, stop_block, columns, first_row, planes, max_alpha):
    last = len(lists) - 4
    for block in range(begin, stop_block):
        x, y, at = _pixels(block, columns, first_row)
        T, stop = spread(np.float32(1)), spread(MIN_TRANSMITTANCE)
        colors = zeros(planes[:-1])
        i, end = np.int64(start[block]), np.int64(start[block + 1])
        while i + 3 < end:  # four at a time: their alphas do not wait for each other
            g, h, k, m = _record(lists, i), _record(lists, i + 1), _record(lists, i + 2), _record(lists, i + 3)
            soon = min(i + AHEAD, last)
            prefetch(records, _record(lists, soon))
            prefetch(records, _record(lists, soon + 1))
            prefetch(records, _record(lists, soon + 2))
            prefetch(records, _record(lists, soon + 3))
            alpha_g, alpha_h = _alpha(records, g, x, y, max_alpha), _alpha(records, h, x, y, max_alpha)
            alpha_k, alpha_m = _alpha(records, k, x, y, max_alpha), _alpha(records, m, x, y, max_alpha)
            T, stop, colors = _draw(records, g, alpha_g, T, stop, colors)
            T, stop, colors = _draw(records, h, alpha_h, T, stop, colors)
            T, stop, colors = _draw(records, k, alpha_k, T, stop, colors)
            T, stop, colors = _draw(records, m, alpha_m, T, stop, colors)
            i = i + 4 if some(stop < NEVER) else end
        while i < end:
            g = _record(lists, i)
            T, stop, colors = _draw(records, g, _alpha(records, g, x, y, max_alpha), T, stop, colors)
            i += 1
        store_blocks(planes, at, columns * BLOCK, colors + (spread(np.float32(1)) - T,))


@part
def _draw(records, g, alpha, T, stop, colors):
    alpha, rest, stop = _absorb(alpha, T, stop)
    return rest, stop, add_weighted(colors, T * alpha, records, g + GEOMETRY)


@kernel
def backward(records, lists, start, chunks, taken, columns, first_row, planes, grads, max_alpha, absgrad, sums):
    """Add what chunks of a band give to the gradients of their Gaussians, as `block_sums` in `sums`; see `forward`.

    `absgrad` (None: no) adds |dL/dmean| per pixel.
    """
    k = take_next(taken)
    while k < len(chunks):
        blocks = chunks[k, 0], chunks[k, 1]
        _add_blocks(records, lists, start, *blocks, columns, first_row, planes, grads, max_alpha, absgrad, sums)
        k = take_next(taken)


@part
def _add_blocks(records, lists, start, begin, stop_block, columns, first_row, planes, grads, max_alpha, absgrad, sums):
    """Add what blocks [begin, stop_block) give.

    Three steps overlap, each on another Gaussian, because each alone waits for its own results: alpha of the next,
    derivative of this one, sums over the pixels of the last one.
    """
    last = len(lists) - 1
    for block in range(begin, stop_block):
        i, end = np.int64(start[block]), np.int64(start[block + 1])
        if i == end:
            continue
        x, y, at = _pixels(block, columns, first_row)
        g_planes = load_blocks(grads, at, columns * BLOCK)
        g_colors, g_alpha = g_planes[:-1], g_planes[-1]
        S = inner_product(g_planes, load_blocks(planes, at, columns * BLOCK))
        T, stop = spread(np.float32(1)), spread(MIN_TRANSMITTANCE)
        d = w = spread(np.float32(0))
        this = previous = _record(lists, i)
        alpha = _alpha(records, this, x, y, max_alpha)
        while i < end:
            i += 1
            following = _record(lists, min(i, last))
            soon = _record(lists, min(i + AHEAD, last))
            prefetch(records, soon)
            prefetch(sums, soon)
            next_alpha = _alpha(records, following, x, y, max_alpha)
            _collect(records, previous, x, y, d, w, g_colors, absgrad, sums)
            T, stop, S, d, w = _derive(records, this, alpha, T, stop, S, g_colors, g_alpha, max_alpha)
            previous, this, alpha = this, following, next_alpha
            if i % 4 == 0 and not some(stop < NEVER):
                i = end
        _collect(records, previous, x, y, d, w, g_colors, absgrad, sums)


@part
def _derive(records, g, alpha, T, stop, S, g_colors, g_alpha, max_alpha):
    """alpha dL/dalpha and weight of a Gaussian in 16 pixels; 0 by choice where alpha was clamped."""
    alpha, rest, stop = _absorb(alpha, T, stop)
    v = weighted_sum(g_colors, records, g + GEOMETRY, g_alpha)
    w = T * alpha
    wv = w * v
    S = S - wv
    d = where(alpha < max_alpha, wv - S * ratio(alpha, np.float32(1) - alpha), 0.0)
    return rest, stop, S, d, w


@part
def _collect(records, g, x, y, d, w, g_colors, absgrad, sums):
    dx, dy = _offsets(records, g, x, y)
    others = _with_absolute(absgrad, scaled(g_colors, w), records, g, d, dx, dy)
    store(sums, g, load(sums, g) + block_sums(d, dx, dy, others))


def _with_absolute(absgrad, others, records, g, d, dx, dy):
    """Return the others, and with `absgrad` |dL/d(mean)| of each pixel, x and y."""


@overload(_with_absolute)
def _choose_absolute(absgrad, others, records, g, d, dx, dy):
    if isinstance(absgrad, types.NoneType):
        return lambda absgrad, others, records, g, d, dx, dy: others
    return _append_absolute


def _append_absolute(absgrad, others, records, g, d, dx, dy):
    a, b, c = get(records, g + 2), get(records, g + 3), get(records, g + 4)
    d_mean_x = d * (dx * (TWO * a) + dy * b) * LN_2
    d_mean_y = d * (dy * (TWO * c) + dx * b) * LN_2
    return others + (absolute(d_mean_x), absolute(d_mean_y))


@kernel
def clear(begin, stop, bits, sums):
    """Zero the sums of those Gaussians in [begin, stop) that are drawn."""
    for i in range(begin, stop):
        first, end = rows_of(bits, i, 0, ALL_ROWS)
        if first < end:
            store(sums, i * RECORD, spread(np.float32(0)))


@kernel
def gradients(begin, stop, bits, records, sums, geometry, others):
    """From the sums of all parts (P, 16 N) the gradients of Gaussians [begin, stop), 0 where one is not drawn.

    `geometry`: of mean_x, mean_y, a, b, c, log2_opacity; `others`: of the channels, then perhaps absolute ones.
    """
    total = np.empty(RECORD, np.float32)
    mean_x, mean_y, d_a, d_b, d_c, d_log2 = geometry
    for i in range(begin, stop):
        at = i * RECORD
        first, end = rows_of(bits, i, 0, ALL_ROWS)
        added = spread(np.float32(0))
        if first < end:
            for p in range(len(sums)):
                added = added + load(sums[p], at)
        store(total, 0, added)
        a, b, c = get(records, at + 2), get(records, at + 3), get(records, at + 4)
        m_x, m_y = total[X] * LN_2, total[Y] * LN_2
        mean_x[i], mean_y[i] = TWO * a * m_x + b * m_y, TWO * c * m_y + b * m_x
        d_a[i], d_b[i], d_c[i], d_log2[i] = -total[XX] * LN_2, -total[XY] * LN_2, -total[YY] * LN_2, total[ONE] * LN_2
        store_plain_sums(others, i, total)
