"""Tri-linear interpolation in cell-centred grids."""

from __future__ import annotations

import numpy as np


def trilinear(grid: np.ndarray, coordinate: np.ndarray) -> np.ndarray:
    """Values between cell centres; outside of them that of the nearest.

    Args:
        grid: (X, Y, Z, C).   coordinate: (N, 3) in cells, 0 at the centre of the first one.
    Returns:
        (N, C) float64.
    """
    last = np.array(grid.shape[:3]) - 1
    at = np.clip(coordinate, 0, last)
    low = np.minimum(at.astype(int), np.maximum(last - 1, 0))
    part = at - low
    value = np.zeros((len(at), grid.shape[3]))
    for corner in np.ndindex(2, 2, 2):
        weight = np.prod(np.where(corner, part, 1 - part), axis=1)
        x, y, z = np.minimum(low + corner, last).T  # a one-cell axis has no neighbour to blend with
        value += weight[:, None] * grid[x, y, z]
    return value
