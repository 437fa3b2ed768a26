"""COLMAP models, binary or text: camera poses and points. Read here, because pycolmap is an optional extra."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from gof.errors import DataFormatError
from gof.rotations import rotation_matrices


def read_colmap(folder: Path) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """World-to-camera matrices by image name, and points (P, 3) of a COLMAP model (binary or text).

    Raises:
        DataFormatError: no model there, or its files are cut off.
    """
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
    check_poses(poses, folder)
    if not np.isfinite(cloud).all():
        raise DataFormatError(f"{folder}: points of the COLMAP model are NaN or Inf")
    return poses, cloud


def _pose(values: tuple) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = rotation_matrices(np.array([values[:4]]))[0]
    matrix[:3, 3] = values[4:7]
    return matrix


def check_poses(poses: dict[str, np.ndarray], path: Path) -> None:
    for name, pose in poses.items():
        R = pose[:3, :3]
        if (
            not np.isfinite(pose).all()
            or np.abs(R @ R.T - np.eye(3)).max() > 1e-3
            or np.linalg.det(R) < 0
            or np.abs(pose[3] - [0, 0, 0, 1]).max() > 1e-6
        ):
            raise DataFormatError(f"{path}: world_to_camera of '{name[:40]}' is not a rotation and a shift")
