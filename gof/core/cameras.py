"""Pinhole cameras in the OpenCV convention: x right, y down, z forward, pixel centres at integer + 0.5."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import PureWindowsPath
from typing import Any

import numpy as np

from .datum import Datum
from .errors import DataFormatError, NonFiniteError
from .files import is_name

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])  # OpenGL's camera axes (y up, looking along -z) to OpenCV's, and back
PICTURES = frozenset("avif bmp dng exr gif hdr heic heif jp2 jpeg jpg jxl pgm png ppm raw tga tif tiff webp".split())
READOUT_DIRECTIONS = ("down", "up", "right", "left")
BENT = "k1 k2 k3 k4 k5 k6 p1 p2 is_fisheye distortion distortion_params rolling_shutter latlong equirectangular".split()
STRAIGHT = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "FULL_OPENCV", "RADIAL", "SIMPLE_RADIAL")  # without coefficients


@dataclass(frozen=True)
class Camera:
    """One calibrated camera.

    Args:
        name: unique name inside its dataset; files are named after it (`gof.core.files.is_name`).
        width, height: image size in pixels.
        K: (3, 3) float64 intrinsics in pixels; rows fx s cx, 0 fy cy and 0 0 1.
        world_to_camera: (4, 4) float64 rigid transform, world (Z up, metres) to OpenCV camera axes.
        row_time_s: seconds between two neighbouring image lines of a rolling shutter; 0 = global shutter.
        readout: direction in the image in which lines are read later. A landscape sensor rolled by 90 degrees
            reads its rows along portrait columns, so "right" or "left".

    Raises:
        DataFormatError: the name cannot be that of a file, a matrix has the wrong shape, the rotation is not
            orthonormal, or a size is not positive.
        NonFiniteError: a matrix holds NaN or Inf.
    """

    name: str
    width: int
    height: int
    K: np.ndarray
    world_to_camera: np.ndarray
    row_time_s: float = 0.0
    readout: str = "down"

    def __post_init__(self):
        if not is_name(self.name):
            raise DataFormatError(f"camera {self.name[:80]!r}: files are named after cameras; give it a plain name")
        object.__setattr__(self, "K", np.asarray(self.K, np.float64))
        object.__setattr__(self, "world_to_camera", np.asarray(self.world_to_camera, np.float64))
        for field, shape in (("K", (3, 3)), ("world_to_camera", (4, 4))):
            matrix = getattr(self, field)
            if matrix.shape != shape:
                raise DataFormatError(f"camera '{self.name}': {field} has shape {matrix.shape}, expected {shape}")
            if not np.isfinite(matrix).all():
                raise NonFiniteError(f"camera '{self.name}': {field} holds NaN or Inf")
        if not np.isfinite(self.row_time_s):
            raise NonFiniteError(f"camera '{self.name}': row_time_s is {self.row_time_s}")
        if self.width < 1 or self.height < 1:
            raise DataFormatError(f"camera '{self.name}': size {self.width}x{self.height} is not positive")
        R = self.world_to_camera[:3, :3]
        if np.abs(R @ R.T - np.eye(3)).max() > 1e-4 or np.linalg.det(R) < 0:
            raise DataFormatError(
                f"camera '{self.name}': world_to_camera is not a rigid transform (rotation not orthonormal, or "
                "mirrored; OpenGL camera-to-world matrices must be converted first)"
            )
        for field, row, expected in (
            ("K", self.K[1, :1], [0]),
            ("K", self.K[2], [0, 0, 1]),
            ("world_to_camera", self.world_to_camera[3], [0, 0, 0, 1]),
        ):
            if np.abs(row - expected).max() > 1e-9:
                raise DataFormatError(
                    f"camera '{self.name}': {field} is {getattr(self, field).tolist()}; expected "
                    + ("rows fx s cx, 0 fy cy and 0 0 1" if field == "K" else "a last row 0 0 0 1 (is it transposed?)")
                )
        if self.K[0, 0] <= 0 or self.K[1, 1] <= 0:
            raise DataFormatError(
                f"camera '{self.name}': focal lengths must be positive, got {self.K[0, 0]}, {self.K[1, 1]}"
            )
        if self.readout not in READOUT_DIRECTIONS:
            raise DataFormatError(f"camera '{self.name}': readout '{self.readout}' is not one of {READOUT_DIRECTIONS}")

    @property
    def position(self) -> np.ndarray:
        """(3,) camera centre in world metres."""
        R, t = self.world_to_camera[:3, :3], self.world_to_camera[:3, 3]
        return -R.T @ t

    def to_camera(self, points: np.ndarray) -> np.ndarray:
        """Convert world points (N, 3) in metres to camera axes (N, 3) in metres."""
        return np.asarray(points, np.float64) @ self.world_to_camera[:3, :3].T + self.world_to_camera[:3, 3]

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Project world points.

        Args:
            points: (N, 3) world metres.
        Returns:
            pixels (N, 2): continuous image coordinates, (0.5, 0.5) is the centre of the first pixel; NaN for points
                on or behind the camera plane (depth <= 1e-9 m), which have no image.
            depth (N,): camera z in metres, negative behind the camera.
        """
        xyz = self.to_camera(points)
        depth = xyz[:, 2]
        safe = np.where(depth > 1e-9, depth, np.nan)
        uv = xyz[:, :2] / safe[:, None]
        pixels = uv @ self.K[:2, :2].T + self.K[:2, 2]
        return pixels, depth

    def unproject(self, pixels: np.ndarray, depth: np.ndarray) -> np.ndarray:
        """Return world points (N, 3) in metres of pixels (N, 2), as `project` gives them, at camera depths (N,) in
        metres."""
        rays = np.column_stack([pixels, np.ones(len(pixels))]) @ np.linalg.inv(self.K).T  # at depth 1
        local = rays * np.asarray(depth, np.float64)[:, None]
        return (local - self.world_to_camera[:3, 3]) @ self.world_to_camera[:3, :3]

    def projection_jacobian(self, points: np.ndarray) -> np.ndarray:
        """d(pixel)/d(world) at points (N, 3): (N, 2, 3) in px/m; NaN on or behind the camera plane."""
        xyz = self.to_camera(points)
        z = np.where(xyz[:, 2] > 1e-9, xyz[:, 2], np.nan)
        d_uv = np.zeros((len(xyz), 2, 3))
        d_uv[:, 0, 0] = d_uv[:, 1, 1] = 1 / z
        d_uv[:, 0, 2] = -xyz[:, 0] / z**2
        d_uv[:, 1, 2] = -xyz[:, 1] / z**2
        return self.K[:2, :2] @ d_uv @ self.world_to_camera[:3, :3]

    def measured_from(self, datum: Datum) -> Camera:
        """Return the same camera in a world whose zero is the datum's place."""
        if not any(datum.position):
            return self
        pose = self.world_to_camera.copy()
        pose[:3, 3] += pose[:3, :3] @ datum.position
        return replace(self, world_to_camera=pose)

    def scaled(self, width: int, height: int) -> Camera:
        """Return the same camera for an image resampled to width x height (row time per image line scales with it)."""
        sx, sy = width / self.width, height / self.height
        lines = sx if self.readout in ("left", "right") else sy
        return Camera(
            self.name,
            width,
            height,
            np.diag([sx, sy, 1.0]) @ self.K,
            self.world_to_camera,
            self.row_time_s / lines,
            self.readout,
        )

    def cropped(self, x: int, y: int, width: int, height: int) -> Camera:
        """Return the camera of a part of the picture.

        A rolling shutter reads the part's first line later than the whole picture's; times are not known here.

        Args:
            x, y: px, first column and row of the part.   width, height: px, > 0.
        """
        K = self.K.copy()
        K[:2, 2] -= x, y
        return replace(self, width=width, height=height, K=K)

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready description; inverse of `from_dict`."""
        return {
            "name": self.name,
            "width": self.width,
            "height": self.height,
            "K": self.K.tolist(),
            "world_to_camera": self.world_to_camera.tolist(),
            "row_time_s": self.row_time_s,
            "readout": self.readout,
        }

    @classmethod
    def from_dict(cls, d: dict[str, Any], source: str = "camera") -> Camera:
        """Read `to_dict`'s fields; extra fields are ignored.

        Raises:
            DataFormatError: a field is missing or has the wrong type or shape (names `source` and the field).
        """
        try:
            return cls(
                str(d["name"]),
                int(d["width"]),
                int(d["height"]),
                d["K"],
                d["world_to_camera"],
                float(d.get("row_time_s", 0.0)),
                str(d.get("readout", "down")),
            )
        except KeyError as e:
            raise DataFormatError(f"{source}: camera field {e} is missing") from e
        except (TypeError, ValueError, OverflowError) as e:
            raise DataFormatError(f"{source}: camera field cannot be read ({e})") from e
        except (DataFormatError, NonFiniteError) as e:
            raise type(e)(f"{source}: {e}") from e


def bent_by(fields: dict[str, Any]) -> list[str]:
    """Return the fields of another program's camera by which its pictures are distorted; none of `Camera`'s are."""
    found = [name for name in fields if (name in BENT or name.startswith("ftheta_p")) and _says(fields[name])]
    models = {name: fields[name] for name in ("camera_model", "model") if fields.get(name, "OPENCV") not in STRAIGHT}
    return found + [f"{name} {str(model)[:40]}" for name, model in models.items()]


def _says(value: Any) -> bool:
    """Return whether a field of distortion says that there is some."""
    return any(map(_says, value)) if isinstance(value, list) else bool(value)


def names_by_pictures(pictures: Sequence[str]) -> list[str]:
    """Return the names of cameras by the names of their pictures.

    `cam_0.png` and `cam_0/000001.png` are of camera `cam_0`, and so is `static/cam_0.png` where all pictures lie in one
    folder. Folders may be written with backslashes.
    """
    paths = [PureWindowsPath(picture) for picture in pictures]  # which knows both separators
    one_folder = len({path.parent for path in paths}) == 1  # which says nothing of which camera
    files = [path.stem if path.suffix[1:].lower() in PICTURES else path.name for path in paths]
    return [file if one_folder else path.parent.name or file for path, file in zip(paths, files, strict=True)]


def sizes_px(cameras: Iterable[Camera]) -> tuple[tuple[int, int], ...]:
    """Return the different picture sizes, (width, height), in the cameras' order: what a picture's score depends on."""
    return tuple(dict.fromkeys((camera.width, camera.height) for camera in cameras))


def in_words(sizes: Iterable[tuple[int, int]]) -> str:
    """Return picture sizes for people: "480x854 px"; "" when none is known."""
    words = ", ".join(f"{width}x{height}" for width, height in sizes)
    return f"{words} px" if words else ""
