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
    size = np.array(grid.shape[:3])
    at = np.clip(coordinate, 0, size - 1)
    low = np.minimum(at.astype(int), np.maximum(size - 2, 0))
    part = at - low
    sides = ((1 - part).T, part.T)
    along = np.array([size[1] * size[2], size[2], 1])
    first, step = low @ along, along * (size > 1)  # a one-cell axis has no neighbour to blend with
    cells = grid.reshape(-1, grid.shape[3])
    value = np.zeros((len(at), grid.shape[3]))
    for corner in np.ndindex(2, 2, 2):
        weight = sides[corner[0]][0] * sides[corner[1]][1] * sides[corner[2]][2]
        value += weight[:, None] * cells[first + step @ corner]
    return value
