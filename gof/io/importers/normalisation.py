"""The scene normalisation of gsplat's trainers, which FreeTimeGS applies and does not store: found again and undone."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gof.errors import DataFormatError
from gof.files import read_json
from gof.io.colmap import read_colmap


def normalisation(poses: dict[str, np.ndarray], points: np.ndarray) -> np.ndarray:
    """The world-to-training similarity (4, 4) that gsplat's trainers (FreeTimeGS among them) apply and do not store.

    Mean camera up becomes -y, the median of the points where the optical axes pass closest to the origin moves to the
    origin, the median camera distance becomes 1; then the points' principal axes, largest first, become x, y, z.
    The sign of a principal axis is a convention of the linear-algebra library (as it was for the trainer).

    Args:
        poses: world_to_camera by name, OpenCV.   points: (P, 3), at least 3.
    """
    if len(poses) < 1 or len(points) < 3:
        raise DataFormatError(
            f"the COLMAP model has {len(poses)} images and {len(points)} points; the normalisation needs 1 and 3"
        )
    camera = np.stack([np.linalg.inv(poses[n]) for n in sorted(poses)])
    up = -camera[:, :3, 1].mean(0)
    up /= np.linalg.norm(up)
    to = np.array([0.0, -1.0, 0.0])
    c = float(up @ to)
    if c > -1:
        k = np.cross(up, to)
        K = np.array([[0, -k[2], k[1]], [k[2], 0, -k[0]], [-k[1], k[0], 0]])
        turn = np.eye(3) + K + K @ K / (1 + c)
    else:
        turn = np.diag([-1.0, 1.0, 1.0])  # what the trainer does in this corner, mirrored as it is
    centre, forward = camera[:, :3, 3] @ turn.T, camera[:, :3, 2] @ turn.T
    closest = centre - np.sum(forward * centre, 1, keepdims=True) * forward
    shift = -np.median(closest, axis=0)
    first = np.eye(4)
    first[:3, :3], first[:3, 3] = turn, shift
    first[:3] /= np.median(np.linalg.norm(centre + shift, axis=1))
    moved = points @ first[:3, :3].T + first[:3, 3]
    middle = np.median(moved, axis=0)
    values, axes = np.linalg.eigh(np.cov(moved - middle, rowvar=False))
    axes = axes[:, values.argsort()[::-1]]
    if np.linalg.det(axes) < 0:
        axes[:, 0] *= -1
    second = np.eye(4)
    second[:3, :3], second[:3, 3] = axes.T, -axes.T @ middle
    return second @ first


def world_from_training(path: Path) -> np.ndarray:
    """(4, 4) from `ImportOptions.world`: a COLMAP folder, or JSON with "training_to_world"."""
    path = Path(path)
    if path.is_file():
        value = read_json(path)
        try:
            matrix = np.asarray(value["training_to_world"], np.float64).reshape(4, 4)
        except (KeyError, TypeError, ValueError) as e:
            raise DataFormatError(f"{path}: no 4x4 'training_to_world' in it") from e
        if not np.isfinite(matrix).all():
            raise DataFormatError(f"{path}: 'training_to_world' holds NaN or Inf")
        return matrix
    try:
        found = np.linalg.inv(normalisation(*read_colmap(path)))
    except DataFormatError as e:
        raise e if str(path) in str(e) else DataFormatError(f"{path}: {e}") from e
    except np.linalg.LinAlgError as e:
        raise DataFormatError(
            f"{path}: the COLMAP model has no normalisation ({e}); do all cameras or points coincide?"
        ) from e
    if not np.isfinite(found).all():
        raise DataFormatError(
            f"{path}: the COLMAP model has no finite normalisation; do all cameras or points coincide?"
        )
    return found
