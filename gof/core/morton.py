"""Points in the order of the Morton curve: neighbours in space become neighbours in memory."""

from __future__ import annotations

import numpy as np

BITS = 10  # per axis


def morton_order(points: np.ndarray) -> np.ndarray:
    """Return (N,) indices that put (N, 3) finite points, in any unit, along a Morton curve of 1024 cells a side.

    Code that draws or gathers them then reads memory that is still in the cache. Points of one cell keep their order.
    """
    points = np.asarray(points, np.float64)
    low = points.min(axis=0, initial=np.inf)
    side = (points.max(axis=0, initial=-np.inf) - low).max() if len(points) else 0.0
    # One scale for all axes, so that cells are cubes; a set without extent is one cell.
    cell = ((points - low) * ((2**BITS - 1) / side)).astype(np.uint32) if side > 0 else np.zeros_like(points, np.uint32)
    code: np.ndarray = np.zeros(len(points), np.uint32)
    for bit in range(BITS):
        for axis in range(3):
            code |= ((cell[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.argsort(code, kind="stable")
