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
    """Rotation matrices (..., 3, 3) to unit quaternions (..., 4), of the two the one with w >= 0."""
    from scipy.spatial.transform import Rotation  # here: it takes longer to load than the rest of the importers

    xyzw = Rotation.from_matrix(matrix).as_quat(canonical=True)
    return np.roll(xyzw, 1, axis=-1)


def quaternion_product(q: np.ndarray, p: np.ndarray) -> np.ndarray:
    """q p of one q (4,) with many p (N, 4), wxyz: the turn p first, then q."""
    w, v = q[0], q[1:]
    pw, pv = p[:, :1], p[:, 1:]
    return np.concatenate([w * pw - pv @ v[:, None], w * pv + pw * v + np.cross(v, pv)], 1)
