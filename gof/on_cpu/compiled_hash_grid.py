"""The hash grid's two passes in space compiled for a CPU, point by point: no corner's weight or row is ever stored.

`gof.on_cpu.hash_grid` says what they compute, and has their plain twins.
"""

from __future__ import annotations

import numpy as np

from gof.render.native.compiled import kernel, part

AXES, CORNERS = 3, 8  # known when it is compiled, so that loops over them are unrolled
PRIMES = np.array([1, 2654435761, 805459861], np.uint32)  # of the hash, by axis


@kernel
def encode(points, table, offsets, scales, vertices, features):
    """Write features (L, B, C) of points (B, 3).

    Args:
        table: (T, C).   offsets: (L + 1,) where each level's part of it begins.
        scales: (L, 3) from a point to its place among a level's vertices.   vertices: (L, 3) int64 along each axis.
    """
    terms, weights = np.empty((AXES, 2), np.uint32), np.empty((AXES, 2), points.dtype)
    slopes = np.empty((AXES, 2), points.dtype)
    for level in range(len(scales)):
        size, hashed = _part(offsets, vertices, level)
        for b in range(len(points)):
            features[level, b, :] = 0
            if not _find_cell(points, b, scales, vertices, level, hashed, terms, weights, slopes):
                continue
            for corner in range(CORNERS):
                row = offsets[level] + _row(corner, terms, size, hashed)
                weight = _weight(corner, weights, -1)
                for c in range(table.shape[1]):
                    features[level, b, c] += weight * table[row, c]


@kernel
def encode_backward(grad, points, table, offsets, scales, vertices, grad_table, grad_points, wanted):
    """Add the gradients of the table (T, C), and of the points (B, 3) where they are wanted; other args as `encode`.

    Args:
        grad: (L, B, C), of the features.
    """
    terms, weights = np.empty((AXES, 2), np.uint32), np.empty((AXES, 2), points.dtype)
    slopes = np.empty((AXES, 2), points.dtype)
    for level in range(len(scales)):
        size, hashed = _part(offsets, vertices, level)
        for b in range(len(points)):
            if not _find_cell(points, b, scales, vertices, level, hashed, terms, weights, slopes):
                continue
            for corner in range(CORNERS):
                row = offsets[level] + _row(corner, terms, size, hashed)
                weight, pull = _weight(corner, weights, -1), points.dtype.type(0)
                for c in range(table.shape[1]):
                    grad_table[row, c] += weight * grad[level, b, c]
                    pull += table[row, c] * grad[level, b, c]
                if wanted:
                    for axis in range(AXES):
                        slope = slopes[axis, corner >> axis & 1] * _weight(corner, weights, axis)
                        grad_points[b, axis] += slope * pull


@part
def _part(offsets, vertices, level):
    """Return how many rows a level has, and whether its vertices do not all fit."""
    size = np.int64(offsets[level + 1]) - np.int64(offsets[level])
    return size, vertices[level, 0] * vertices[level, 1] * vertices[level, 2] > size


@part
def _find_cell(points, b, scales, vertices, level, hashed, terms, weights, slopes):
    """Write by axis, for the lower and the upper vertices: their term of the row, their weight, and its slope.

    Returns whether the point is in the cube; one at NaN is not.
    """
    one, two = points.dtype.type(1), points.dtype.type(2)
    three, six = points.dtype.type(3), points.dtype.type(6)
    stride = np.int64(1)
    for d in range(AXES):
        if not (points[b, d] >= 0 and points[b, d] <= 1):
            return False
        place = points[b, d] * scales[level, d]
        cell = np.floor(place)
        share = place - cell
        rise, steep = share * share * (three - two * share), six * share * (one - share) * scales[level, d]
        weights[d, 0], weights[d, 1], slopes[d, 0], slopes[d, 1] = one - rise, rise, -steep, steep
        factor = np.int64(PRIMES[d]) if hashed else stride
        terms[d, 0], terms[d, 1] = np.int64(cell) * factor, (np.int64(cell) + 1) * factor  # the lower 32 bits
        stride *= vertices[level, d]
    return True


@part
def _row(corner, terms, size, hashed):
    """Return a corner's row in its level's part; bit d of `corner`: whether it is the upper one along axis d."""
    a, b, c = terms[0, corner & 1], terms[1, corner >> 1 & 1], terms[2, corner >> 2]
    row = np.int64(a ^ b ^ c) if hashed else np.int64(a) + np.int64(b) + np.int64(c)
    if size & (size - 1) == 0:
        return row & (size - 1)  # as the remainder, which takes as long as all the rest
    return row if row < size else row % size


@part
def _weight(corner, weights, without):
    """Return the product over the axes, but for one, of what a corner has of a point."""
    weight = weights.dtype.type(1)
    for d in range(AXES):
        if d != without:
            weight *= weights[d, corner >> d & 1]
    return weight
