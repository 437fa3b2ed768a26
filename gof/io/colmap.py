"""COLMAP models, binary or text: camera poses and points. Read here, because pycolmap is an optional extra."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from gof.errors import DataFormatError
from gof.rotations import rotation_matrices

Poses = dict[str, np.ndarray]  # world_to_camera (4, 4) by image name


def read_colmap(folder: Path) -> tuple[Poses, np.ndarray]:
    """World-to-camera matrices by image name, and points (P, 3) of a COLMAP model (binary or text).

    Args:
        folder: the model, or the project with the model in `sparse/0` or `0`.
    Raises:
        DataFormatError: no model there, or its files are cut off.
    """
    folder = _model_in(Path(folder))
    try:
        if (folder / "images.bin").is_file():
            poses = _binary_images((folder / "images.bin").read_bytes())
            points = _binary_points((folder / "points3D.bin").read_bytes())
        else:
            poses = _text_images((folder / "images.txt").read_text())
            points = _text_points((folder / "points3D.txt").read_text())
        cloud = np.array(points, np.float64).reshape(-1, 3)
    except (struct.error, ValueError, IndexError, FileNotFoundError) as e:
        raise DataFormatError(f"{folder}: the COLMAP model cannot be read ({e}); files missing or cut off?") from e
    check_poses(poses, folder)
    if not np.isfinite(cloud).all():
        raise DataFormatError(f"{folder}: points of the COLMAP model are NaN or Inf")
    return poses, cloud


def _model_in(folder: Path) -> Path:
    for candidate in (folder, folder / "sparse" / "0", folder / "0"):
        if (candidate / "images.bin").is_file() or (candidate / "images.txt").is_file():
            return candidate
    raise DataFormatError(f"{folder}: no COLMAP model there (images.bin or images.txt)")


def _binary_images(data: bytes) -> Poses:
    """Per image: u32 number, 7 f64 pose, u32 camera, name with a zero at its end, u64 count of 24-byte observations."""
    poses = {}
    (count,) = struct.unpack_from("<Q", data)
    at = 8
    for _ in range(count):
        pose = struct.unpack_from("<7d", data, at + 4)
        name_at = at + 64
        end = data.index(b"\0", name_at)
        (observations,) = struct.unpack_from("<Q", data, end + 1)
        poses[data[name_at:end].decode()] = _pose(pose)
        at = end + 9 + 24 * observations
    return poses


def _binary_points(data: bytes) -> list[tuple[float, ...]]:
    """Per point: u64 number, 3 f64 position, 3 u8 colour, f64 error, u64 count of 8-byte track entries."""
    points = []
    (count,) = struct.unpack_from("<Q", data)
    at = 8
    for _ in range(count):
        points.append(struct.unpack_from("<3d", data, at + 8))
        (track,) = struct.unpack_from("<Q", data, at + 43)
        at += 51 + 8 * track
    return points


def _text_images(text: str) -> Poses:
    """Per image a line "number pose camera name", and one of observations."""
    lines = [line for line in text.split("\n") if not line.startswith("#")]
    images = [line.split() for line in lines[::2] if line.strip()]
    return {words[9]: _pose(tuple(map(float, words[1:8]))) for words in images}


def _text_points(text: str) -> list[tuple[float, ...]]:
    """Per point a line "number position colour error track"."""
    points = [line.split() for line in text.splitlines() if line.strip() and not line.startswith("#")]
    return [tuple(map(float, words[1:4])) for words in points]


def _pose(values: tuple[float, ...]) -> np.ndarray:
    """(4, 4) world_to_camera of a quaternion wxyz and a translation."""
    quaternion = np.array([values[:4]])
    if not quaternion.any():
        raise ValueError("a zero quaternion")
    matrix = np.eye(4)
    matrix[:3, :3] = rotation_matrices(quaternion)[0]
    matrix[:3, 3] = values[4:7]
    return matrix


def check_poses(poses: Poses, path: Path) -> None:
    """Raises DataFormatError: one of the matrices is not a rotation and a shift (names it)."""
    for name, pose in poses.items():
        R = pose[:3, :3]
        if (
            not np.isfinite(pose).all()
            or np.abs(R @ R.T - np.eye(3)).max() > 1e-3
            or np.linalg.det(R) < 0
            or np.abs(pose[3] - [0, 0, 0, 1]).max() > 1e-6
        ):
            raise DataFormatError(f"{path}: world_to_camera of '{name[:40]}' is not a rotation and a shift")
