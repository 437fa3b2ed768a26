"""Similarities between worlds: applied to Gaussians, fitted to cameras, and undone from a COLMAP model."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gof.errors import DataFormatError, GofError
from gof.gaussians import TransientGaussians
from gof.harmonics import turned
from gof.rotations import quaternion_product, quaternions_wxyz, rotation_matrices


def apply(matrix: np.ndarray, position: np.ndarray, scale: np.ndarray, rotation: np.ndarray, color: np.ndarray):
    """(position, scale, rotation, color) of Gaussians after a similarity (4, 4): x -> s R x + t."""
    s, R, t = decompose(matrix)
    return position @ (s * R).T + t, scale * s, quaternion_product(quaternions_wxyz(R), rotation), turned(color, R)


def transformed(g: TransientGaussians, matrix: np.ndarray) -> TransientGaussians:
    """The same Gaussians in another world; velocities turn and stretch with it, times stay."""
    position, scale, rotation, color = apply(matrix, g.position, g.scale, g.rotation, g.color)
    return replace(
        g,
        position=position,
        scale=scale,
        rotation=rotation,
        color=color,
        velocity=g.velocity @ np.asarray(matrix, np.float64)[:3, :3].T,
    )


def decompose(matrix: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Scale, rotation (3, 3) and translation (3,) of a similarity.

    Raises:
        GofError: not a similarity (sheared, mirrored or singular).
    """
    matrix = np.asarray(matrix, np.float64)
    linear = matrix[:3, :3]
    s = np.cbrt(np.linalg.det(linear))
    if not np.isfinite(matrix).all() or not s > 0 or np.abs(linear @ linear.T / s**2 - np.eye(3)).max() > 1e-4:
        raise GofError("the world transform is not a similarity (sheared, mirrored or singular)")
    return float(s), linear / s, matrix[:3, 3]


@dataclass(frozen=True)
class Alignment:
    """world_from_source (4, 4), and how well it maps one set of cameras onto the other."""

    matrix: np.ndarray
    position_rms_m: float
    rotation_max_deg: float
    scale: float


def align_cameras(source: dict[str, np.ndarray], target: dict[str, np.ndarray]) -> Alignment:
    """Least-squares similarity that maps source cameras onto target cameras of the same name (Umeyama 1991, with orientations).

    Centres alone do not fix the turn about their line, and three cameras on an arc are almost on one; so every camera
    also contributes three points one mean camera distance along its axes, in proportion to the scale that is being fitted.

    Args:
        source, target: name -> world_to_camera (4, 4), OpenCV; source may be in any unit.
    Raises:
        GofError: fewer than two cameras in common, or all centres coincide.
    """
    names = sorted(set(source) & set(target))
    if len(names) < 2:
        raise GofError(
            f"alignment needs two cameras with the same name in both; found {names} of {sorted(source)[:5]} and {sorted(target)[:5]}"
        )
    pose = [np.stack([np.linalg.inv(np.asarray(p[n], np.float64)) for n in names]) for p in (source, target)]
    centres = [p[:, :3, 3] for p in pose]
    with np.errstate(over="ignore"):
        spread = [np.sqrt(np.mean(np.sum((c - c.mean(0)) ** 2, 1))) for c in centres]
    if not 1e-9 < min(spread) <= max(spread) < 1e30:
        raise GofError(
            f"alignment: the camera centres spread {spread[0]:.2g} and {spread[1]:.2g} around their middle; no scale follows from that"
        )
    points = [
        np.concatenate([c] + [c + d * p[:, :3, k] for k in range(3)])
        for c, p, d in zip(centres, pose, spread, strict=True)
    ]
    mean = [p.mean(0) for p in points]
    a, b = points[0] - mean[0], points[1] - mean[1]
    u, d, vt = np.linalg.svd(b.T @ a / len(a))
    sign = np.array([1, 1, np.sign(np.linalg.det(u @ vt))])
    R = u @ (sign[:, None] * vt)
    s = float((d * sign).sum() / np.mean(np.sum(a**2, 1)))
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = s * R, mean[1] - s * R @ mean[0]
    moved = centres[0] @ matrix[:3, :3].T + matrix[:3, 3]
    turn = np.einsum("nji,njk->nik", R @ pose[0][:, :3, :3], pose[1][:, :3, :3])
    angle = np.degrees(np.arccos(np.clip((np.trace(turn, axis1=1, axis2=2) - 1) / 2, -1, 1)))
    return Alignment(matrix, float(np.sqrt(np.mean(np.sum((moved - centres[1]) ** 2, 1)))), float(angle.max()), s)


def read_cameras(path: Path) -> dict[str, np.ndarray]:
    """World-to-camera matrices by camera name: a COLMAP folder, a dataset.json, or JSON of name -> 4x4.

    A COLMAP image `cam_0.png` or `cam_0/000001.png` is camera `cam_0`.
    """
    from gof.io.files import read_json

    path = Path(path)
    if path.is_dir():
        if (path / "dataset.json").is_file():
            return read_cameras(path / "dataset.json")
        return {
            Path(n).parent.name or Path(n).stem: pose for n, pose in sorted(read_colmap(path)[0].items(), reverse=True)
        }
    content = read_json(path)
    try:
        if "cameras" in content:
            content = {c["name"]: c["world_to_camera"] for c in content["cameras"]}
        found = {str(n): np.asarray(m, np.float64).reshape(4, 4) for n, m in content.items()}
    except (AttributeError, KeyError, TypeError, ValueError) as e:
        raise DataFormatError(f"{path}: no cameras with a name and a 4x4 world_to_camera in it ({e})") from e
    _check_poses(found, path)
    return found


def _check_poses(poses: dict[str, np.ndarray], path: Path) -> None:
    for name, pose in poses.items():
        R = pose[:3, :3]
        if (
            not np.isfinite(pose).all()
            or np.abs(R @ R.T - np.eye(3)).max() > 1e-3
            or np.linalg.det(R) < 0
            or np.abs(pose[3] - [0, 0, 0, 1]).max() > 1e-6
        ):
            raise DataFormatError(f"{path}: world_to_camera of '{name[:40]}' is not a rotation and a shift")


# ---------------------------------------------------------------- COLMAP


def read_colmap(folder: Path) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """World-to-camera matrices by image name, and points (P, 3) of a COLMAP model (binary or text).

    Raises:
        DataFormatError: no model there, or its files are cut off.
    """
    import struct

    folder = Path(folder)
    for candidate in (folder, folder / "sparse" / "0", folder / "0"):
        if (candidate / "images.bin").is_file() or (candidate / "images.txt").is_file():
            folder = candidate
            break
    else:
        raise DataFormatError(f"{folder}: no COLMAP model there (images.bin or images.txt)")
    poses: dict[str, np.ndarray] = {}
    points: list = []
    try:
        if (folder / "images.bin").is_file():
            data = (folder / "images.bin").read_bytes()
            (count,), at = struct.unpack_from("<Q", data), 8
            for _ in range(count):
                pose, at = struct.unpack_from("<7d", data, at + 4), at + 64
                end = data.index(b"\0", at)
                name, (observations,) = data[at:end].decode(), struct.unpack_from("<Q", data, end + 1)
                at = end + 9 + 24 * observations
                poses[name] = _pose(pose)
            data = (folder / "points3D.bin").read_bytes()
            (count,), at = struct.unpack_from("<Q", data), 8
            for _ in range(count):
                points.append(struct.unpack_from("<3d", data, at + 8))
                (track,) = struct.unpack_from("<Q", data, at + 43)
                at += 51 + 8 * track
        else:
            lines = [row for row in (folder / "images.txt").read_text().split("\n") if not row.startswith("#")]
            for line in lines[::2]:  # every second line lists observations
                if line.strip():
                    words = line.split()
                    poses[words[9]] = _pose(tuple(map(float, words[1:8])))
            for line in (folder / "points3D.txt").read_text().splitlines():
                if line.strip() and not line.startswith("#"):
                    points.append(tuple(map(float, line.split()[1:4])))
        cloud = np.array(points, np.float64).reshape(-1, 3)
    except (struct.error, ValueError, IndexError, FileNotFoundError) as e:
        raise DataFormatError(f"{folder}: the COLMAP model cannot be read ({e}); files missing or cut off?") from e
    _check_poses(poses, folder)
    if not np.isfinite(cloud).all():
        raise DataFormatError(f"{folder}: points of the COLMAP model are NaN or Inf")
    return poses, cloud


def _pose(values: tuple) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = rotation_matrices(np.array([values[:4]]))[0]
    matrix[:3, 3] = values[4:7]
    return matrix


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
    from gof.io.files import read_json

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
