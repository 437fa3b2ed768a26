"""The scene normalisations that trainers apply to a COLMAP model and do not store: found again and undone."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from gof.core.colmap import Poses, name_model, read_colmap
from gof.core.errors import DataFormatError
from gof.core.files import read_json
from gof.io.importers.source import WorldBy

NEAR, CLEARLY = 0.1, 2.0  # of the points' spread: what lies on them; how much nearer than any other reading
SAMPLES = 2000, 50_000  # COLMAP points and Gaussians that are compared: more say nothing new
JSON = 'a JSON file with "training_to_world", the inverse of its parser\'s transform (docs/importers.md)'


def freetime_normalisation(poses: Poses, points: np.ndarray) -> np.ndarray:
    """Return the world-to-training similarity (4, 4) of FreeTimeGsVanilla's own parser.

    The mean of the cameras' centres moves to the origin, and the farthest of them to distance 1; then the points'
    principal axes, largest first, become x, y, z, turned about the cameras' mean.

    Args:
        poses: world_to_camera by name, OpenCV.   points: (P, 3), at least 3.
    """
    centre = np.stack([np.linalg.inv(pose)[:3, 3] for pose in poses.values()])
    middle = centre.mean(0)
    reach = np.linalg.norm(centre - middle, axis=1).max()
    scale = 1 / reach if reach > 1e-6 else 1.0
    turn = _principal_axes(points - points.mean(0)) if len(points) >= 4 else np.eye(3)
    if np.linalg.det(turn) < 0:
        turn[2] *= -1
    return _similarity(scale * turn, -scale * turn @ middle)


def gsplat_normalisation(poses: Poses, points: np.ndarray) -> np.ndarray:
    """Return the world-to-training similarity (4, 4) of gsplat's example trainers.

    Mean camera up becomes -y, the median of the points where the optical axes pass closest to the origin moves to the
    origin, the median camera distance becomes 1; then the points' principal axes, largest first, become x, y, z.

    Args:
        poses: world_to_camera by name, OpenCV.   points: (P, 3), at least 3.
    """
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
    first = _similarity(turn, shift)
    first[:3] /= np.median(np.linalg.norm(centre + shift, axis=1))
    moved = points @ first[:3, :3].T + first[:3, 3]
    middle = np.median(moved, axis=0)
    axes = _principal_axes(moved - middle)
    if np.linalg.det(axes) < 0:
        axes[0] *= -1
    return _similarity(axes, -axes @ middle) @ first


NORMALISATIONS = {"freetime": freetime_normalisation, "gsplat": gsplat_normalisation}


def world_from_training(path: Path, by: WorldBy | None, position: np.ndarray) -> tuple[np.ndarray, str]:
    """Training world to the COLMAP model's world, of `ImportOptions.world`, and a sentence that says how it was found.

    A trainer's Gaussians begin on the COLMAP points, so the right reading is the one that leaves them there. Signs of
    principal axes are a convention of the linear-algebra library, so all four are tried of every normalisation.

    Args:
        path: a COLMAP folder, or JSON with "training_to_world".   by: whose normalisation; None = found out.
        position: (N, 3) of the Gaussians in the training's world.
    Raises:
        DataFormatError: no model or matrix there, or nothing tells the readings apart and the options do not either.
    """
    if path.is_file():
        return _stored(path), f"scene normalisation undone with {path}"
    try:
        poses, points = read_colmap(path)
        found = list(_readings(poses, points, by))
    except DataFormatError as e:
        raise e if str(path) in str(e) else DataFormatError(f"{path}: {e}") from e
    except np.linalg.LinAlgError as e:
        raise DataFormatError(
            f"{path}: the COLMAP model has no normalisation ({e}); do all cameras or points coincide?"
        ) from e
    if not all(np.isfinite(matrix).all() for _, matrix in found):
        raise DataFormatError(
            f"{path}: the COLMAP model has no finite normalisation; do all cameras or points coincide?"
        )
    away = [_distance(matrix, position, points) for _, matrix in found]
    best, second = np.argsort(away)[:2]
    if away[best] < NEAR and away[second] > CLEARLY * away[best]:
        name, matrix = found[best]
        return matrix, (
            f"scene normalisation of {name} undone with {name_model(path)}; the COLMAP points then lie "
            f"{away[best]:.2g} of their spread from the Gaussians"
        )
    if by is None:
        raise DataFormatError(
            f"{path}: no reading of its normalisation brings the Gaussians clearly onto the COLMAP points (the best "
            f"leaves {away[best]:.2g} of their spread); say whose it was with gof convert RESULT --world-by "
            f"freetime or --world-by gsplat, or give {JSON}"
        )
    return found[0][1], (
        f"scene normalisation of {by} undone with {name_model(path)}; its Gaussians do not lie on the COLMAP points, "
        "so a turn by 180 degrees would not be noticed: a JSON file with the transform is safer"
    )


def _stored(path: Path) -> np.ndarray:
    value = read_json(path)
    try:
        matrix = np.asarray(value["training_to_world"], np.float64).reshape(4, 4)
    except (KeyError, TypeError, ValueError) as e:
        raise DataFormatError(f"{path}: no 4x4 'training_to_world' in it") from e
    if not np.isfinite(matrix).all():
        raise DataFormatError(f"{path}: 'training_to_world' holds NaN or Inf")
    return matrix


def _readings(poses: Poses, points: np.ndarray, by: WorldBy | None) -> Iterator[tuple[str, np.ndarray]]:
    """Training-to-world matrices that the model could mean; the first is that of this machine's own signs."""
    if len(poses) < 1 or len(points) < 3:
        raise DataFormatError(
            f"the COLMAP model has {len(poses)} images and {len(points)} points; the normalisation needs 1 and 3"
        )
    for name in [by] if by else NORMALISATIONS:
        matrix = NORMALISATIONS[name](poses, points)
        for x, y in itertools.product((1.0, -1.0), repeat=2):
            yield name, np.linalg.inv(np.diag([x, y, x * y, 1.0]) @ matrix)


def _distance(matrix: np.ndarray, position: np.ndarray, points: np.ndarray) -> float:
    """Return median distance of the points from the nearest Gaussian, in units of the points' spread."""
    points, position = (
        values[:: max(1, len(values) // most)] for values, most in zip((points, position), SAMPLES, strict=True)
    )
    spread = np.median(np.linalg.norm(points - np.median(points, axis=0), axis=1))
    moved = position.astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
    from scipy.spatial import cKDTree  # here: a quarter of a second

    return float(np.median(cKDTree(moved).query(points)[0]) / max(spread, 1e-30))


def _principal_axes(offsets: np.ndarray) -> np.ndarray:
    """Return (3, 3): rows are the principal axes, largest first."""
    values, axes = np.linalg.eigh(np.cov(offsets, rowvar=False))
    return axes[:, values.argsort()[::-1]].T


def _similarity(linear: np.ndarray, shift: np.ndarray) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = linear, shift
    return matrix
