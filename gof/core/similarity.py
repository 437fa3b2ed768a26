"""Similarities x -> s R x + t between worlds, applied to Gaussians."""

from __future__ import annotations

import numpy as np

from .errors import GofError
from .harmonics import turned
from .rotations import quaternion_product, quaternions_wxyz

Y_UP = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])  # to the worlds of glTF and most viewers


def decompose(matrix: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Scale s, rotation R (3, 3) and translation t (3,) of a similarity (4, 4).

    Raises:
        GofError: not a similarity (sheared, mirrored or singular).
    """
    matrix = np.asarray(matrix, np.float64)
    linear = matrix[:3, :3]
    s = np.cbrt(np.linalg.det(linear))
    if not np.isfinite(matrix).all() or not s > 0 or np.abs(linear @ linear.T / s**2 - np.eye(3)).max() > 1e-4:
        raise GofError("the world transform is not a similarity (sheared, mirrored or singular)")
    return float(s), linear / s, matrix[:3, 3]


def transformed_splats(
    matrix: np.ndarray, position: np.ndarray, scale: np.ndarray, rotation: np.ndarray, color: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return (position, scale, rotation, color) of Gaussians in another world.

    Args:
        matrix: similarity (4, 4).   position, scale: (N, 3).   rotation: (N, 4) wxyz.   color: (M, 3) or (M, K, 3).
    Raises:
        GofError: see `decompose`.
    """
    s, R, t = decompose(matrix)
    turn = quaternions_wxyz(R)
    return position @ (s * R).T + t, scale * s, quaternion_product(turn, rotation), turned(color, R)
