"""Cameras in files that other programs read: Nerfstudio's ``transforms.json`` and COLMAP's models; and a dataset's.

Pictures' distortion is nothing that a Blender camera has, so files that speak of it are refused.
"""

from __future__ import annotations

import math
import unicodedata
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ...core import colmap
from ...core.cameras import FLIP, bent_by, names_by_pictures
from ...core.description import FILE, CameraEntry, DatasetDescription
from ...core.errors import DataFormatError
from ...core.files import is_name, read_json, write_json, write_text
from ...core.rotations import quaternions_wxyz

COLMAP = tuple(f"{name}.{kind}" for name in ("cameras", "images", "points3D") for kind in ("txt", "bin"))
MOST = 10_000  # cameras


def read(path: Path) -> tuple[CameraEntry, ...]:
    """Return the cameras of dataset.json, transforms.json, or the COLMAP model of a file; pictures of one camera are
    one.

    Raises:
        DataFormatError: no such file, another format, distortion, or values that are no camera.
    """
    if path.name == FILE:
        return DatasetDescription.read(path.parent).cameras
    if path.suffix.lower() == ".json":
        found = list(_of_transforms(path))
    elif path.name in COLMAP:
        found = list(_of_colmap(path.parent))
    else:
        raise DataFormatError(
            f"{path}: not {FILE}, transforms.json, or a file of a COLMAP model (cameras.txt, images.bin, ...)"
        )
    if not found:
        raise DataFormatError(f"{path}: holds no cameras")
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
        poses.append(f"{number} {_words(*quaternions_wxyz(pose[:3, :3]), *pose[:3, 3])} {number} {entry.name}.png\n\n")
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
        raise DataFormatError(f"{path}: has no list 'frames', so it is not a transforms.json")
    names = names_by_pictures([str(frame.get("file_path", "cam")) for frame in frames])
    for number, (own, name) in enumerate(zip(frames, names, strict=True)):
        frame, what = whole | own, f"{path}: frame {number}"
        if bent := bent_by(frame):
            raise DataFormatError(
                f"{what} has {', '.join(bent)}: distortion, which Blender's cameras have not: undistort the pictures"
            )
        try:
            pose = np.array(frame["transform_matrix"], np.float64)
            width, height = _whole(frame["w"]), _whole(frame["h"])
            fl_x = frame["fl_x"] if "fl_x" in frame else width / 2 / math.tan(frame["camera_angle_x"] / 2)
            fl_y = fl_x
            if "camera_angle_y" in frame:
                fl_y = height / 2 / math.tan(frame["camera_angle_y"] / 2)
            lens = (fl_x, frame.get("fl_y", fl_y), frame.get("cx", width / 2), frame.get("cy", height / 2))
            if pose.shape != (4, 4):
                raise ValueError(f"transform_matrix is {pose.shape}")
            to_camera = np.linalg.inv(pose @ FLIP)
            entry = _entry(name, width, height, lens, to_camera)
        except KeyError as error:
            raise DataFormatError(f"{what} has no {error}") from None
        except (TypeError, ValueError, ZeroDivisionError, OverflowError, np.linalg.LinAlgError) as error:
            raise DataFormatError(f"{what}: {error}") from None
        yield _with_role(entry, frame.get("role"))


def _of_colmap(folder: Path) -> Iterator[CameraEntry]:
    found = colmap.read_cameras(folder)
    names = names_by_pictures([image.name for image, _ in found])
    for (image, lens), name in zip(found, names, strict=True):
        yield _entry(name, lens.width, lens.height, lens[2:], image.pose)


def _entry(name: str, width: int, height: int, lens, to_camera: np.ndarray) -> CameraEntry:
    """Return a camera. Raises ValueError: not finite, no focal length, or a pose that is no turn."""
    fx, fy, cx, cy = (float(value) for value in lens)
    k = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
    if not (np.isfinite(k).all() and np.isfinite(to_camera).all()):
        raise ValueError("its numbers must be finite")
    if min(fx, fy) <= 0 or min(width, height) < 1:
        raise ValueError("its focal length and size must be positive")
    turn = to_camera[:3, :3]
    if np.abs(turn @ turn.T - np.eye(3)).max() > 1e-3 or np.linalg.det(turn) < 0:
        raise ValueError("its pose is no turn and move; was it scaled?")
    return CameraEntry(_plain(name), width, height, k.tolist(), to_camera.tolist())


def _plain(name: str) -> str:
    """Return a name that files can have: the same with "_" for the characters that no file's name may hold."""
    plain = "".join("_" if c in '/\\:*?"<>|{}' or not c.isprintable() else c for c in name).strip(" .").lstrip("-~")
    return plain if plain and is_name(plain) else "cam"


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
        raise DataFormatError(f"{len(kept)} cameras; does this file hold a moving camera's path? {MOST} are the most")
    return list(kept.values())


def _named_apart(found: list[CameraEntry]) -> list[CameraEntry]:
    """With a number behind the names that there are already, in any case and any form of their letters."""
    named, taken = [], set()
    for entry in found:
        name, count = entry.name, 1
        while unicodedata.normalize("NFC", name).casefold() in taken:
            count += 1
            name = f"{entry.name}_{count}"
        taken.add(unicodedata.normalize("NFC", name).casefold())
        named.append(replace(entry, name=name))
    return named


def _whole(value: Any) -> int:
    number = float(value)
    if number != int(number) or not 1 <= number <= 65_536:
        raise ValueError(f"{value} is no number of pixels")
    return int(number)


def _words(*numbers: float) -> str:
    return " ".join(format(float(number), ".17g") for number in numbers)
