"""Rotations in numpy: unit quaternions wxyz, matrices whose columns are the turned axes."""

from __future__ import annotations

import numpy as np


def rotation_matrices(quaternion: np.ndarray) -> np.ndarray:
    """Quaternions wxyz (N, 4), normalised here, to matrices (N, 3, 3) float64; columns are a Gaussian's own axes."""
    q = quaternion.astype(np.float64)
    w, x, y, z = (q / np.linalg.norm(q, axis=1, keepdims=True)).T
    return np.stack(
        [
            1 - 2 * (y * y + z * z),
            2 * (x * y - w * z),
            2 * (x * z + w * y),
            2 * (x * y + w * z),
            1 - 2 * (x * x + z * z),
            2 * (y * z - w * x),
            2 * (x * z - w * y),
            2 * (y * z + w * x),
            1 - 2 * (x * x + y * y),
        ],
        -1,
    ).reshape(-1, 3, 3)


def quaternions_wxyz(matrix: np.ndarray) -> np.ndarray:
    """Return rotation matrices (..., 3, 3) to unit quaternions (..., 4), of the two the one whose first number but 0 is
    > 0.

    Row i of 4 q q^T is 4 q_i q: of the four rows the one of the largest q_i loses no digits (Markley, 2008).
    """
    m = np.moveaxis(np.asarray(matrix, np.float64), (-2, -1), (0, 1))
    x, y, z = m[0, 0], m[1, 1], m[2, 2]
    wx, wy, wz = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
    xy, xz, yz = m[0, 1] + m[1, 0], m[0, 2] + m[2, 0], m[1, 2] + m[2, 1]
    squares = np.array([1 + x + y + z, 1 + x - y - z, 1 - x + y - z, 1 - x - y + z])
    rows = np.array(
        [[squares[0], wx, wy, wz], [wx, squares[1], xy, xz], [wy, xy, squares[2], yz], [wz, xz, yz, squares[3]]]
    )
    q = np.take_along_axis(rows, squares.argmax(0)[None, None], 0)[0]
    q /= np.linalg.norm(q, axis=0)
    first = np.take_along_axis(q, (np.abs(q) > 0).argmax(0)[None], 0)[0]
    return np.moveaxis(np.where(first < 0, -q, q), 0, -1)


def quaternion_product(q: np.ndarray, p: np.ndarray) -> np.ndarray:
    """q p of one q (4,) with many p (N, 4), wxyz: the turn p first, then q."""
    w, v = q[0], q[1:]
    pw, pv = p[:, :1], p[:, 1:]
    return np.concatenate([w * pw - pv @ v[:, None], w * pv + pw * v + np.cross(v, pv)], 1)
