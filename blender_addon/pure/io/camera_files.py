"""Cameras in files that other programs read: Nerfstudio's ``transforms.json`` and COLMAP's text model; and a dataset's.

Pictures' distortion is nothing that a Blender camera has, so files that speak of it are refused.
"""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path, PureWindowsPath
from typing import Any

import numpy as np

from ...core.description import FILE, CameraEntry, DatasetDescription
from ...core.errors import DataFormatError
from ...core.files import is_name, read_json, read_text, write_json, write_text
from ..camera_poses import rotation_matrix

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])  # OpenGL's camera axes (y up, looking along -z) to OpenCV's, and back
DISTORTION = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2", "is_fisheye", "distortion_params", "rolling_shutter")
STRAIGHT = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "FULL_OPENCV", "RADIAL", "SIMPLE_RADIAL")  # without distortion
PICTURES = frozenset("avif bmp dng exr gif hdr heic heif jp2 jpeg jpg jxl pgm png ppm raw tga tif tiff webp".split())
COLMAP = ("cameras.txt", "images.txt")
BINARY = ("cameras.bin", "images.bin", "points3D.bin", "rigs.bin", "frames.bin")
LENSES = {"SIMPLE_PINHOLE": (0, 0, 1, 2), "PINHOLE": (0, 1, 2, 3)}  # where fx, fy, cx and cy are in the parameters
MOST = 10_000  # cameras


def read(path: Path) -> tuple[CameraEntry, ...]:
    """The cameras of dataset.json, transforms.json, or cameras.txt with images.txt; pictures of one camera are one.

    Raises:
        DataFormatError: no such file, another format, distortion, or values that are no camera.
    """
    if path.name == FILE:
        return DatasetDescription.read(path.parent).cameras
    if path.suffix.lower() == ".json":
        found = list(_of_transforms(path))
    elif path.name in BINARY or (path.name in COLMAP and _is_binary(path.parent)):
        raise DataFormatError(
            f"{path}: a binary COLMAP model; make text of it: colmap model_converter --output_type TXT"
        )
    elif path.name in COLMAP:
        found = list(_of_colmap(path.parent))
    else:
        raise DataFormatError(f"{path}: not {FILE}, transforms.json, cameras.txt or images.txt")
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
        raise DataFormatError(f"{path}: has no list 'frames', so it is not a transforms.json")
    names = _camera_names([str(frame.get("file_path", "cam")) for frame in frames])
    for number, (own, name) in enumerate(zip(frames, names, strict=True)):
        frame, what = whole | own, f"{path}: frame {number}"
        bent = [name for name in DISTORTION if _says(frame.get(name))]
        bent += [name for name in frame if name.startswith("ftheta_p") or name in ("latlong", "equirectangular")]
        if frame.get("camera_model", "OPENCV") not in STRAIGHT:
            bent.append(f"camera_model {str(frame['camera_model'])[:40]}")
        if bent:
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


def _is_binary(folder: Path) -> bool:
    return not (folder / COLMAP[1]).is_file() and (folder / BINARY[1]).is_file()


def _of_colmap(folder: Path) -> Iterator[CameraEntry]:
    lenses = _lenses(folder / COLMAP[0])
    path = folder / COLMAP[1]
    pictures = _pictures(path)
    names = _camera_names([name for _, _, _, name in pictures])
    for (number, values, lens_number, _), name in zip(pictures, names, strict=True):
        try:
            pose = np.eye(4)
            pose[:3, :3], pose[:3, 3] = _matrix(values[:4]), values[4:]
            if lens_number not in lenses:
                raise ValueError(f"no camera {lens_number} in cameras.txt")
            yield _entry(name, *lenses[lens_number], pose)
        except ValueError as error:
            raise DataFormatError(f"{path}: line {number}: {error}") from None


def _lenses(path: Path) -> dict[int, tuple[int, int, list[float]]]:
    """Width, height and fx, fy, cx, cy by COLMAP's camera number."""
    lenses = {}
    for number, line in _lines(path):
        words = line.split()
        if not words:
            continue
        what = f"{path}: line {number}"
        if len(words) < 5 or words[1] not in LENSES:
            raise DataFormatError(f"{what} is no PINHOLE or SIMPLE_PINHOLE: run COLMAP's image_undistorter")
        try:
            if not words[0].isdecimal() or int(words[0]) in lenses:
                raise ValueError(f"{words[0][:40]} is no camera number of its own")
            if len(words) != 4 + len(set(LENSES[words[1]])):
                raise ValueError(f"{words[1]} has {len(set(LENSES[words[1]]))} parameters, here are {len(words) - 4}")
            lens = [float(words[4 + place]) for place in LENSES[words[1]]]
            lenses[int(words[0])] = (_whole(words[2]), _whole(words[3]), lens)
        except ValueError as error:
            raise DataFormatError(f"{what}: {error}") from None
    return lenses


def _pictures(path: Path) -> list[tuple[int, list[float], int, str]]:
    """Of every picture: its line's number, quaternion and translation, its camera's number, its name.

    Pictures' lines and those of their observations, which may be empty or stripped, are told apart by their form.
    """
    found, names, observed = [], set(), True  # whether the picture before has had its line of observations
    for number, line in _lines(path):
        picture, observations = _is_picture(line), _is_observations(line)
        if not line:
            observed = True
        elif picture and observations and not observed and _turns(line):
            raise DataFormatError(
                f"{path}: line {number} may be a picture or observations; write an empty line after every picture"
            )
        elif picture and (observed or not observations):
            words = line.split(maxsplit=9)
            if any("\udc80" <= c <= "\udcff" for c in words[9]):
                raise DataFormatError(f"{path}: line {number}: the picture's name is not UTF-8")
            if words[9] in names:
                raise DataFormatError(f"{path}: line {number}: a second picture is called '{words[9][:80]}'")
            found.append((number, [float(word) for word in words[1:8]], int(words[8]), words[9]))
            names.add(words[9])
            observed = False
        elif observations and not observed:
            observed = True
        else:
            raise DataFormatError(
                f"{path}: line {number} is no 'IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME': {line[:60]!r}"
            )
    return found


def _is_picture(line: str) -> bool:
    """Whether a line says "number pose camera name"; the name is all that is left, blanks too."""
    words = line.split(maxsplit=9)
    return len(words) == 10 and words[0].isdecimal() and words[8].isdecimal() and _are_numbers(words[1:8])


def _turns(line: str) -> bool:
    """Whether the second to fifth word are a quaternion of length 1, which no observations in pixels are."""
    return abs(math.hypot(*map(float, line.split()[1:5])) - 1) < 1e-2


def _is_observations(line: str) -> bool:
    """Whether a line says "x y point", any number of times."""
    words = line.split()
    whole = all(re.fullmatch("[+-]?[0-9]+", word, re.ASCII) for word in words[2::3])
    return len(words) % 3 == 0 and whole and _are_numbers(words)


def _are_numbers(words: list[str]) -> bool:
    try:
        return "_" not in "".join(words) and all(math.isfinite(float(word)) for word in words)
    except ValueError:
        return False


def _lines(path: Path) -> list[tuple[int, str]]:
    """Numbers and texts of the lines that are no comments. What is not UTF-8 may stand in comments only."""
    lines = enumerate(read_text(path, "surrogateescape").split("\n"), 1)
    return [(number, line.strip()) for number, line in lines if not line.lstrip().startswith("#")]


def _says(value: Any) -> bool:
    """Whether a field of distortion says that there is some."""
    return any(map(_says, value)) if isinstance(value, list) else bool(value)


def _camera_names(pictures: list[str]) -> list[str]:
    """What cameras are called by the names of their pictures.

    `cam_0.png` and `cam_0/000001.png` are of camera `cam_0`, and so is `static/cam_0.png` where all pictures lie in one
    folder. Folders may be written with backslashes. `gof` decides the same.
    """
    paths = [PureWindowsPath(picture) for picture in pictures]  # which knows both separators
    one_folder = len({path.parent for path in paths}) == 1
    files = [path.stem if path.suffix[1:].lower() in PICTURES else path.name for path in paths]
    return [file if one_folder else path.parent.name or file for path, file in zip(paths, files, strict=True)]


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
    return CameraEntry(_plain(name), width, height, k.tolist(), to_camera.tolist())


def _plain(name: str) -> str:
    """A name that files can have: the same with "_" for the characters that no file's name may hold."""
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
