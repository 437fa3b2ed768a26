"""COLMAP models, binary or text: camera poses, lenses and points. Read here, because pycolmap is an optional extra."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from .errors import DataFormatError
from .files import read_text
from .rotations import rotation_matrices

Poses = dict[str, np.ndarray]  # world_to_camera (4, 4) by image name
LARGEST = 65_536  # pixels a side
MODELS = ("SIMPLE_PINHOLE", "PINHOLE")  # of lenses, by COLMAP's number; others have distortion
Line = tuple[int, str]  # of text: its number, from 1, and what it says


class ColmapCamera(NamedTuple):
    """A camera of COLMAP without distortion; lengths in pixels."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float


class Image(NamedTuple):
    """An image of a model: its name, the number of its `ColmapCamera`, and world_to_camera (4, 4)."""

    name: str
    lens: int
    pose: np.ndarray


def read_colmap(folder: Path) -> tuple[Poses, np.ndarray]:
    """World-to-camera matrices by image name, and points (P, 3) of a COLMAP model (binary or text).

    Args:
        folder: the model, or the project with models in `sparse/0`, `sparse/1`, ... or `0`, `1`, ...: of several, the
            one with most pictures (`name_model` says which).
    Raises:
        DataFormatError: no model there, or its files are cut off or no COLMAP model (names file and line of text).
    """
    folder = _largest(_models_in(Path(folder)))
    poses, points = _poses_of(folder), _read(folder, "points3D", _binary_points, _text_points)
    cloud = np.array(points, np.float64).reshape(-1, 3)
    require_rigid_poses(poses, folder)
    if not np.isfinite(cloud).all():
        raise DataFormatError(f"{folder}: points of the COLMAP model are NaN or Inf")
    return poses, cloud


def read_cameras(folder: Path) -> list[tuple[Image, ColmapCamera]]:
    """Return the images of a model, in its order, each with its lens.

    Raises:
        DataFormatError: as `read_colmap`, a lens with distortion, or an image whose lens is not there.
    """
    images, found = _images_of(folder), _read(folder, "cameras", _binary_lenses, _text_lenses)
    require_rigid_poses({image.name: image.pose for image in images}, folder)
    lenses = dict(found)
    if len(lenses) < len(found):
        raise DataFormatError(f"{folder}: two cameras of the COLMAP model have the same number")
    for image in images:
        if image.lens not in lenses:
            raise DataFormatError(f"{folder}: there is no camera {image.lens}, which took '{image.name[:80]}'")
    return [(image, lenses[image.lens]) for image in images]


def name_model(path: Path) -> str:
    """Return the path in words; of a project with several COLMAP models, which one is read and what the others hold."""
    if not path.is_dir() or len(models := _models_in(path)) < 2:
        return str(path)
    used = _largest(models)
    others = ", ".join(f"{m.relative_to(path)} has {len(_poses_of(m))}" for m in models if m != used)
    return f"{used} (the model with most pictures, {len(_poses_of(used))}; {others})"


def _models_in(folder: Path) -> list[Path]:
    """Return the models of a folder or a project, in order of their numbers."""

    def numbered(parent: Path) -> list[Path]:
        found = parent.iterdir() if parent.is_dir() else ()
        return sorted((f for f in found if re.fullmatch("[0-9]{1,9}", f.name)), key=lambda f: int(f.name))

    for candidates in ([folder], [folder / "sparse"], numbered(folder / "sparse"), numbered(folder)):
        models = [f for f in candidates if (f / "images.bin").is_file() or (f / "images.txt").is_file()]
        if models:
            return models
    raise DataFormatError(f"{folder}: no COLMAP model there (images.bin or images.txt)")


def _largest(models: list[Path]) -> Path:
    return max(models, key=lambda model: len(_poses_of(model))) if len(models) > 1 else models[0]


def _poses_of(folder: Path) -> Poses:
    return {image.name: image.pose for image in _images_of(folder)}


def _images_of(folder: Path) -> list[Image]:
    """Read the images. Raises DataFormatError: the file is damaged, or two images have the same name."""
    images, names = _read(folder, "images", _binary_images, _text_images), set()
    for image in images:
        if image.name in names:
            raise DataFormatError(f"{folder}: two images of the COLMAP model are called '{image.name[:80]}'")
        names.add(image.name)
    return images


def _read(folder: Path, what: str, of_bytes: Callable[[bytes], list], of_lines: Callable[[list[Line]], list]) -> list:
    """Return the model's images, cameras or points."""
    binary = (folder / "images.bin").is_file()
    path = folder / f"{what}.{'bin' if binary else 'txt'}"
    try:
        return of_bytes(path.read_bytes()) if binary else of_lines(_lines(path))
    except (struct.error, ValueError, IndexError, OverflowError, OSError) as e:
        raise DataFormatError(f"{path}: the COLMAP model cannot be read ({e}); file missing or cut off?") from e


# ---------------------------------------------------------------- text


def _lines(path: Path) -> list[Line]:
    """Return numbers and texts of the lines that are no comments. Bytes beyond UTF-8 may stand in comments only."""
    lines = enumerate(read_text(path, "surrogateescape").split("\n"), 1)
    return [(number, line.strip()) for number, line in lines if not line.lstrip().startswith("#")]


def _text_images(lines: list[Line]) -> list[Image]:
    """Per image a line "number pose camera name", and one of observations, which may be empty or stripped.

    Lines are told apart by their form. Raises ValueError: a line is neither, or could be both.
    """
    found, observed = [], True  # whether the image before has had its line of observations
    for number, line in lines:
        image, observations = _is_image(line), _is_observations(line)
        if not line:
            observed = True
        elif image and observations and not observed and _turns(line):
            raise ValueError(f"line {number} may be an image or observations; write an empty line after every image")
        elif image and (observed or not observations):
            words = line.split(maxsplit=9)
            if any("\udc80" <= c <= "\udcff" for c in words[9]):
                raise ValueError(f"line {number}: the image's name is not UTF-8")
            found.append(Image(words[9], int(words[8]), _pose(tuple(map(float, words[1:8])))))
            observed = False
        elif observations and not observed:
            observed = True
        else:
            raise ValueError(f"line {number} is no 'IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME': {line[:60]!r}")
    return found


def _is_image(line: str) -> bool:
    """Return whether a line says "number pose camera name"; the name is all that is left, blanks too."""
    words = line.split(maxsplit=9)
    return len(words) == 10 and words[0].isdecimal() and words[8].isdecimal() and _are_numbers(words[1:8])


def _turns(line: str) -> bool:
    """Return whether the second to fifth word are a quaternion of length 1, which no observations in pixels are."""
    return bool(abs(np.linalg.norm([float(word) for word in line.split()[1:5]]) - 1) < 1e-2)


def _is_observations(line: str) -> bool:
    """Return whether a line says "x y point", any number of times."""
    words = line.split()
    return len(words) % 3 == 0 and _are_whole(words[2::3]) and _are_numbers(words)


def _are_whole(words: list[str]) -> bool:
    return all(re.fullmatch("[+-]?[0-9]+", word, re.ASCII) for word in words)


def _are_numbers(words: list[str]) -> bool:
    try:
        return "_" not in "".join(words) and bool(np.isfinite([float(word) for word in words]).all())
    except ValueError:
        return False


def _text_lenses(lines: list[Line]) -> list[tuple[int, ColmapCamera]]:
    """Per camera a line "number model width height parameters". Raises ValueError: a line is none."""
    lenses: list[tuple[int, ColmapCamera]] = []
    for number, line in lines:
        words = line.split()
        if words and not (len(words) > 4 and _are_whole([words[0], *words[2:4]]) and _are_numbers(words[4:])):
            raise ValueError(f"line {number} is no 'CAMERA_ID MODEL WIDTH HEIGHT PARAMS': {line[:60]!r}")
        if words:
            if int(words[0]) in dict(lenses):
                raise ValueError(f"line {number}: a second camera {words[0]}")
            try:
                lens = _lens(words[1], int(words[2]), int(words[3]), list(map(float, words[4:])))
            except ValueError as e:
                raise ValueError(f"line {number}: {e}") from e
            lenses.append((int(words[0]), lens))
    return lenses


def _text_points(lines: list[Line]) -> list[tuple[float, ...]]:
    """Per point a line "number position colour error track". Raises ValueError: a line is none."""
    points = []
    for number, line in lines:
        words = line.split()
        if words and not (
            len(words) >= 8 and _are_whole([words[0], *words[4:7], *words[8:]]) and _are_numbers(words[1:8])
        ):
            raise ValueError(f"line {number} is no 'POINT3D_ID X Y Z R G B ERROR TRACK': {line[:60]!r}")
        if words:
            points.append(tuple(map(float, words[1:4])))
    return points


# ---------------------------------------------------------------- binary


def _binary_images(data: bytes) -> list[Image]:
    """Per image: u32 number, 7 f64 pose, u32 camera, name with a zero at its end, u64 count of 24-byte observations."""
    found = []
    (count,) = struct.unpack_from("<Q", data)
    at = 8
    for _ in range(count):
        *pose, lens = struct.unpack_from("<7dI", data, at + 4)
        name_at = at + 64
        end = data.index(b"\0", name_at)
        (observations,) = struct.unpack_from("<Q", data, end + 1)
        found.append(Image(data[name_at:end].decode(), lens, _pose(tuple(pose))))
        at = end + 9 + 24 * observations
    return found


def _binary_lenses(data: bytes) -> list[tuple[int, ColmapCamera]]:
    """Per camera: u32 number, i32 model, u64 width, u64 height, f64 parameters, as many as the model has."""
    lenses = []
    (count,) = struct.unpack_from("<Q", data)
    at = 8
    for _ in range(count):
        number, model, width, height = struct.unpack_from("<IiQQ", data, at)
        name = MODELS[model] if 0 <= model < len(MODELS) else f"model {model}"
        values = struct.unpack_from(f"<{3 + MODELS.index(name)}d" if name in MODELS else "<", data, at + 24)
        lenses.append((number, _lens(name, width, height, list(values))))
        at += 24 + 8 * len(values)
    return lenses


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


def _lens(model: str, width: int, height: int, values: list[float]) -> ColmapCamera:
    """Read a lens. Raises ValueError: it has distortion, or is no lens."""
    if model not in MODELS:
        raise ValueError(f"{model[:40]} is no PINHOLE or SIMPLE_PINHOLE: run COLMAP's image_undistorter")
    if len(values) != 3 + MODELS.index(model):
        raise ValueError(f"{model} has {3 + MODELS.index(model)} parameters, here are {len(values)}")
    lens = ColmapCamera(width, height, values[0], *values[-3:])
    if not np.isfinite(lens).all() or not (
        min(lens.fx, lens.fy) > 0 and 1 <= min(width, height) <= max(width, height) <= LARGEST
    ):
        raise ValueError("focal length and size must be positive and of a picture")
    return lens


def _pose(values: tuple[float, ...]) -> np.ndarray:
    """Return (4, 4) world_to_camera of a quaternion wxyz and a translation."""
    quaternion = np.array([values[:4]])
    if not quaternion.any():
        raise ValueError("a zero quaternion")
    matrix = np.eye(4)
    matrix[:3, :3] = rotation_matrices(quaternion)[0]
    matrix[:3, 3] = values[4:7]
    return matrix


def require_rigid_poses(poses: Poses, path: Path) -> None:
    """Raise DataFormatError: one of the matrices is not a rotation and a shift (names it)."""
    for name, pose in poses.items():
        R = pose[:3, :3]
        if (
            not np.isfinite(pose).all()
            or np.abs(R @ R.T - np.eye(3)).max() > 1e-3
            or np.linalg.det(R) < 0
            or np.abs(pose[3] - [0, 0, 0, 1]).max() > 1e-6
        ):
            raise DataFormatError(f"{path}: world_to_camera of '{name[:40]}' is not a rotation and a shift")
