"""Cameras in files that other programs read: Nerfstudio's ``transforms.json`` and COLMAP's text model; and a dataset's.

Pictures' distortion is nothing that a Blender camera has, so files that speak of it are refused.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ..camera_poses import rotation_matrix
from ..description import FILE, CameraEntry, DatasetDescription
from . import FileFormatError
from .files import is_name, read_json, write_json, write_text

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])  # OpenGL's camera axes (y up, looking along -z) to OpenCV's, and back
DISTORTION = ("k1", "k2", "k3", "k4", "p1", "p2")
COLMAP = ("cameras.txt", "images.txt")
LENSES = {"SIMPLE_PINHOLE": (0, 0, 1, 2), "PINHOLE": (0, 1, 2, 3)}  # where fx, fy, cx and cy are in the parameters
MOST = 10_000  # cameras


def read(path: Path) -> tuple[CameraEntry, ...]:
    """The cameras of dataset.json, transforms.json, or cameras.txt with images.txt; pictures of one camera are one.

    Raises:
        FileFormatError: no such file, another format, distortion, or values that are no camera.
    """
    if path.name == FILE:
        return DatasetDescription.read(path.parent).cameras
    if path.suffix.lower() == ".json":
        found = list(_of_transforms(path))
    elif path.name in COLMAP:
        found = list(_of_colmap(path.parent))
    else:
        raise FileFormatError(f"{path}: not {FILE}, transforms.json, cameras.txt or images.txt")
    if not found:
        raise FileFormatError(f"{path}: holds no cameras")
    return tuple(_named_apart(_different(found)))


def write(path: Path, cameras: tuple[CameraEntry, ...]) -> None:
    """Write transforms.json (any name with .json), or COLMAP's text model beside a name with .txt."""
    if path.suffix.lower() == ".json":
        write_json(path, {"camera_model": "OPENCV", "frames": [_frame(entry) for entry in cameras]})
        return
    lenses, poses = [], []
    for number, entry in enumerate(cameras, 1):
        k = np.array(entry.K)
        lens = _words(k[0, 0], k[1, 1], k[0, 2], k[1, 2])
        pose = np.array(entry.world_to_camera)
        lenses.append(f"{number} PINHOLE {entry.width} {entry.height} {lens}\n")
        poses.append(f"{number} {_words(*_quaternion(pose[:3, :3]), *pose[:3, 3])} {number} {entry.name}.png\n\n")
    write_text(path.with_name("points3D.txt"), "")
    write_text(path.with_name("cameras.txt"), "".join(lenses))
    write_text(path.with_name("images.txt"), "".join(poses))


def _frame(entry: CameraEntry) -> dict[str, Any]:
    k = np.array(entry.K)
    return {
        "file_path": f"{entry.name}.png",
        "role": entry.role,
        "transform_matrix": (np.linalg.inv(np.array(entry.world_to_camera)) @ FLIP).tolist(),
        "fl_x": k[0, 0],
        "fl_y": k[1, 1],
        "cx": k[0, 2],
        "cy": k[1, 2],
        "w": entry.width,
        "h": entry.height,
    }


def _of_transforms(path: Path) -> Iterator[CameraEntry]:
    whole = read_json(path)
    frames = whole.get("frames") if isinstance(whole, dict) else None
    if not isinstance(frames, list) or not all(isinstance(frame, dict) for frame in frames):
        raise FileFormatError(f"{path}: has no list 'frames', so it is not a transforms.json")
    for number, own in enumerate(frames):
        frame, what = whole | own, f"{path}: frame {number}"
        if any(frame.get(name) for name in DISTORTION):
            raise FileFormatError(f"{what} has distortion, which Blender's cameras have not: undistort the pictures")
        try:
            pose = np.array(frame["transform_matrix"], np.float64)
            width, height = _whole(frame["w"]), _whole(frame["h"])
            fl_x = frame["fl_x"] if "fl_x" in frame else width / 2 / math.tan(frame["camera_angle_x"] / 2)
            lens = (fl_x, frame.get("fl_y", fl_x), frame.get("cx", width / 2), frame.get("cy", height / 2))
            if pose.shape != (4, 4):
                raise ValueError(f"transform_matrix is {pose.shape}")
            to_camera = np.linalg.inv(pose @ FLIP)
            entry = _entry(Path(str(frame.get("file_path", "cam"))).stem, width, height, lens, to_camera)
        except KeyError as error:
            raise FileFormatError(f"{what} has no {error}") from None
        except (TypeError, ValueError, ZeroDivisionError, np.linalg.LinAlgError) as error:
            raise FileFormatError(f"{what}: {error}") from None
        yield _with_role(entry, frame.get("role"))


def _of_colmap(folder: Path) -> Iterator[CameraEntry]:
    lenses = {}
    for words in _lines(folder / "cameras.txt"):
        what = f"{folder / 'cameras.txt'}: camera {words[0]}"
        if len(words) < 5 or words[1] not in LENSES:
            raise FileFormatError(f"{what} is no PINHOLE or SIMPLE_PINHOLE: run COLMAP's image_undistorter")
        try:
            lens = [float(words[4 + place]) for place in LENSES[words[1]]]
            lenses[words[0]] = (_whole(words[2]), _whole(words[3]), lens)
        except (ValueError, IndexError) as error:
            raise FileFormatError(f"{what}: {error}") from None
    for words in list(_lines(folder / "images.txt"))[::2]:  # every other line lists points
        what = f"{folder / 'images.txt'}: picture {words[0]}"
        try:
            pose = np.eye(4)
            pose[:3, :3], pose[:3, 3] = _matrix([float(word) for word in words[1:5]]), [float(w) for w in words[5:8]]
            width, height, lens = lenses[words[8]]
            yield _entry(Path(" ".join(words[9:])).stem, width, height, lens, pose)
        except (KeyError, ValueError, IndexError) as error:
            raise FileFormatError(f"{what}: {error}") from None


def _lines(path: Path) -> Iterator[list[str]]:
    """Words of every line that is no comment; of images.txt's empty lines one empty word."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise FileFormatError(f"{path}: cannot be read ({error})") from None
    for line in text.splitlines():
        if not line.startswith("#") and (line.strip() or path.name == "images.txt"):
            yield line.split() or [""]


def _entry(name: str, width: int, height: int, lens, to_camera: np.ndarray) -> CameraEntry:
    """A camera. Raises ValueError: not finite, no focal length, or a pose that is no turn."""
    fx, fy, cx, cy = (float(value) for value in lens)
    k = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
    if not (np.isfinite(k).all() and np.isfinite(to_camera).all()):
        raise ValueError("its numbers must be finite")
    if min(fx, fy) <= 0 or min(width, height) < 1:
        raise ValueError("its focal length and size must be positive")
    turn = to_camera[:3, :3]
    if np.abs(turn @ turn.T - np.eye(3)).max() > 1e-3 or np.linalg.det(turn) < 0:
        raise ValueError("its pose is no turn and move; was it scaled?")
    return CameraEntry(name if is_name(name) else "cam", width, height, k.tolist(), to_camera.tolist())


def _with_role(entry: CameraEntry, role: Any) -> CameraEntry:
    return replace(entry, role="eval") if role == "eval" else entry


def _different(found: list[CameraEntry]) -> list[CameraEntry]:
    """Without pictures that the same camera took from the same place."""
    kept: dict[tuple, CameraEntry] = {}
    for entry in found:
        key = (
            entry.width,
            entry.height,
            *np.round(np.ravel(entry.K), 4),
            *np.round(np.ravel(entry.world_to_camera), 6),
        )
        kept.setdefault(key, entry)
    if len(kept) > MOST:
        raise FileFormatError(f"{len(kept)} cameras; does this file hold a moving camera's path? {MOST} are the most")
    return list(kept.values())


def _named_apart(found: list[CameraEntry]) -> list[CameraEntry]:
    names = [entry.name for entry in found]
    if len(set(names)) == len(names):
        return found
    return [replace(entry, name=f"cam_{number}") for number, entry in enumerate(found)]


def _whole(value: Any) -> int:
    number = float(value)
    if number != int(number) or not 1 <= number <= 65_536:
        raise ValueError(f"{value} is no number of pixels")
    return int(number)


def _words(*numbers: float) -> str:
    return " ".join(format(float(number), ".17g") for number in numbers)


def _matrix(wxyz: list[float]) -> np.ndarray:
    """(3, 3) the turn of a quaternion of any length. Raises ValueError for zero."""
    length = math.sqrt(sum(value * value for value in wxyz))
    if not length > 1e-9:
        raise ValueError("its quaternion is zero")
    return rotation_matrix([value / length for value in wxyz])


def _quaternion(turn: np.ndarray) -> np.ndarray:
    """(4,) wxyz of a rotation: the eigenvector of the largest eigenvalue of Bar-Itzhack's matrix."""
    m = turn
    k = np.array(
        [
            [m[0, 0] + m[1, 1] + m[2, 2], 0, 0, 0],
            [m[2, 1] - m[1, 2], m[0, 0] - m[1, 1] - m[2, 2], 0, 0],
            [m[0, 2] - m[2, 0], m[0, 1] + m[1, 0], m[1, 1] - m[0, 0] - m[2, 2], 0],
            [m[1, 0] - m[0, 1], m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], m[2, 2] - m[0, 0] - m[1, 1]],
        ]
    )
    found = np.linalg.eigh(k)[1][:, -1]
    return found if found[0] >= 0 else -found
