"""Gaussians that touch each 4x4 pixel block, front to back: what `gof.render.bins` does, in loops over memory.

Gaussians by depth (radix sort of the depths' bits) -> in memory order, the span of blocks of every row a Gaussian
touches, and how many spans begin and end at each block -> where each block's list begins -> in depth order, the lists.

Only the last step reads memory out of order, and only two numbers per Gaussian and one per row. Arrays:
    shapes (4 N,) float32: slope, shrink, half_width2 of `bins.Ellipses` and, as bits, first row | end row << 16.
    bits (4 N,) uint32: the same memory.
    first_span (N + 1,) uint32: of each Gaussian, within the band; spans (S,) uint32: first column | end column << 16.
"""

from __future__ import annotations

import numpy as np

from gof.render.bins import BLOCK, MARGIN
from gof.render.native.compiled import kernel, part
from gof.render.native.lanes import (
    LANES,
    ceil,
    exchange,
    floor,
    get,
    maximum,
    minimum,
    prefetch,
    row_numbers,
    square_root,
    store_words,
    where,
)

RECORD, SHAPE = 16, 4  # floats
DIGIT = 11  # bits that a pass of the radix sort looks at
ROWS_AT_ONCE = LANES // BLOCK
FAR = np.float32(1e6)  # pixels
AHEAD = 24  # Gaussians whose data are fetched before they are needed


@part
def rows_of(bits, i, first_row, end_row):
    """Block rows [first, end) of Gaussian i within a band; empty where it is not drawn. `bits`: the shapes' bits."""
    rows = get(bits, i * SHAPE + 3)
    return max(np.int64(rows & np.uint32(0xFFFF)), first_row), min(np.int64(rows >> np.uint32(16)), end_row)


@kernel
def sort_by_depth(depth_bits, bits, order, keys, spare_order, spare_keys):
    """Put the Gaussians that are drawn in order of depth, those of equal depth in order of index; returns their number.

    Depths are positive, so their bits sort like the numbers. Three passes over what is copied first leave the result in
    `spare_order`.
    """
    counts = np.zeros((3, 1 << DIGIT), np.uint32)
    digit, n = np.uint32((1 << DIGIT) - 1), 0
    for i in range(len(depth_bits)):
        first, end = rows_of(bits, i, 0, 0xFFFF)
        if first < end:
            key = depth_bits[i]
            keys[n], order[n] = key, np.uint32(i)
            n += 1
            for k in range(3):
                counts[k, (key >> np.uint32(DIGIT * k)) & digit] += np.uint32(1)
    for k in range(3):
        total = np.uint32(0)
        for value in range(1 << DIGIT):
            count = counts[k, value]
            counts[k, value] = total
            total += count
        for i in range(n):
            value = (keys[i] >> np.uint32(DIGIT * k)) & digit
            place = counts[k, value]
            counts[k, value] = place + np.uint32(1)
            spare_keys[place], spare_order[place] = keys[i], order[i]
        keys, order, spare_keys, spare_order = spare_keys, spare_order, keys, order
    return n


@kernel
def pairs_by_row(bits, widths, rows):
    """Return an upper bound of the pairs in each block row: every Gaussian has its greatest width everywhere."""
    change = np.zeros(rows + 1, np.int64)
    for i in range(len(widths)):
        first, end = rows_of(bits, i, 0, rows)
        if first < end:
            change[first] += widths[i]
            change[end] -= widths[i]
    return np.cumsum(change)[:rows]


@kernel
def count_spans(bits, first_row, end_row, first_span):
    """Count the spans of the Gaussians in a band's rows [first_row, end_row), numbering each one's first."""
    total = 0
    for i in range(len(first_span) - 1):
        first_span[i] = total
        first, end = rows_of(bits, i, first_row, end_row)
        total += max(end - first, 0)
    first_span[len(first_span) - 1] = total
    return total


@kernel
def find_spans(begin, stop, records, shapes, bits, first_row, end_row, first_span, columns, spans, change):
    """Find the spans of Gaussians [begin, stop); note in `change` (rows, columns + 1) where they begin (+1), end (-1).

    In the pixel row at dy from its mean a Gaussian reaches alpha 1/255 in x + slope dy +- sqrt(half_width2 - shrink
    dy^2): sixteen pixel rows at a time, of which four are a row of blocks.
    """
    words, last_pixel = np.empty(LANES, np.uint32), np.float32(columns * BLOCK - 1)
    for i in range(begin, stop):
        row, end = rows_of(bits, i, first_row, end_row)
        x, y = get(records, i * RECORD), get(records, i * RECORD + 1)
        slope, shrink, half_width2 = (
            get(shapes, i * SHAPE),
            get(shapes, i * SHAPE + 1),
            get(shapes, i * SHAPE + 2),
        )
        place = np.int64(first_span[i])
        while row < end:
            dy = row_numbers() + np.float32(np.float32(row * BLOCK) + np.float32(0.5) - y)
            inside = half_width2 - dy * dy * shrink
            hit = inside >= -MARGIN
            half = square_root(maximum(inside, 0.0)) + MARGIN
            centre = dy * slope + (x - np.float32(0.5))  # in numbers of pixels, not their centres
            low = where(hit, centre - half, FAR)
            high = where(hit, centre + half, -FAR)
            low, high = minimum(low, exchange(low, 1)), maximum(high, exchange(high, 1))
            low, high = minimum(low, exchange(low, 2)), maximum(high, exchange(high, 2))
            low = ceil(low)
            first_column = floor(maximum(low, 0.0) * 0.25)
            end_column = where(high >= low, floor(minimum(high, last_pixel) * 0.25) + 1.0, 0.0)
            some = first_column < end_column
            store_words(words, 0, where(some, first_column, 0.0), where(some, end_column, 0.0))
            for k in range(min(ROWS_AT_ONCE, end - row)):
                word = words[k * BLOCK]
                spans[place] = word
                place += 1
                at = (row + k - first_row) * (columns + 1)
                change[at + np.int64(word & np.uint32(0xFFFF))] += 1
                change[at + np.int64(word >> np.uint32(16))] -= 1
            row += ROWS_AT_ONCE


@kernel
def begin_lists(change, rows, columns, start):
    """Return where each block's list begins, and the end of the last in one entry more, from the parts' changes."""
    total = np.uint32(0)
    for row in range(rows):
        open_spans = 0
        for column in range(columns):
            for p in range(len(change)):
                open_spans += change[p, row * (columns + 1) + column]
            start[row * columns + column] = total
            total += np.uint32(open_spans)
    start[rows * columns] = total


@kernel
def fill_lists(order, bits, first_span, spans, first_row, begin, stop, end_row, columns, cursor, lists):
    """Write the lists of block rows [begin, stop) of the band [first_row, end_row), front to back; the cursors begin as
    the lists do."""
    last = len(order) - 1
    for rank in range(len(order)):
        soon = np.int64(order[min(rank + AHEAD, last)])
        prefetch(bits, soon * SHAPE + 3)
        prefetch(first_span, soon)
        prefetch(spans, np.int64(first_span[np.int64(order[min(rank + AHEAD // 3, last)])]))
        i = np.int64(order[rank])
        first, end = rows_of(bits, i, first_row, end_row)
        place = np.int64(first_span[i]) - first
        for row in range(max(first, begin), min(end, stop)):
            span, block = get(spans, place + row), (row - first_row) * columns
            for b in range(block + np.int64(span & np.uint32(0xFFFF)), block + np.int64(span >> np.uint32(16))):
                at = cursor[b]
                lists[at] = np.uint32(i)
                cursor[b] = at + np.uint32(1)
