"""A camera's lens: intrinsics of the pictures as stored, and what undistorting and turning upright makes of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np

from gof.core.errors import DataFormatError
from gof.core.files import read_json
from gof.core.records import from_json

Turn = Literal["none", "clockwise", "counterclockwise", "half"]
ROLL_DEG = {"none": 0, "clockwise": 90, "counterclockwise": -90, "half": 180}
CAMERA_AXES = {  # of the turned picture (rows: right, down, forward) in those of the stored one
    "none": np.eye(3),
    "clockwise": np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]),
    "counterclockwise": np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]),
    "half": np.diag([-1.0, -1, 1]),
}
STRAIGHT = np.empty(0)  # coefficients of a lens without distortion, as OpenCV takes them
DISTORTIONS = (0, 4, 5, 8, 12, 14)  # how many coefficients OpenCV's models have


@dataclass(frozen=True)
class Lens:
    """Intrinsics of the pictures as stored.

    Attributes:
        width, height: pixels.
        K: (3, 3), pixel centres at integer + 0.5.
        distortion: OpenCV coefficients (k1, k2, p1, p2[, k3...]); empty = none.
    """

    width: int
    height: int
    K: np.ndarray
    distortion: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @classmethod
    def from_fov(cls, width: int, height: int, fov_deg: float) -> Lens:
        """Square pixels, centred; `fov_deg` is the horizontal field of view, 0 to 180 exclusive."""
        if not 0 < fov_deg < 180:
            raise DataFormatError(f"a horizontal field of view of {fov_deg} degrees; it must lie between 0 and 180")
        focal = 0.5 * width / np.tan(np.deg2rad(fov_deg) / 2)
        return cls(width, height, np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]]))

    @property
    def fov_deg(self) -> float:
        """Horizontal field of view of a picture whose principal point is its middle."""
        return float(2 * np.rad2deg(np.arctan(self.width / 2 / self.K[0, 0])))

    @property
    def long_fov_deg(self) -> float:
        """Field of view along the longer side."""
        longer = int(self.height > self.width)
        return float(2 * np.rad2deg(np.arctan(max(self.width, self.height) / 2 / self.K[longer, longer])))

    def seeing(self, long_fov_deg: float) -> Lens:
        """Return the lens that sees so much along the longer side."""
        return self.magnified(float(np.tan(np.deg2rad(self.long_fov_deg / 2)) / np.tan(np.deg2rad(long_fov_deg / 2))))

    def magnified(self, factor: float) -> Lens:
        """Return the lens of so many times the focal lengths."""
        return replace(self, K=self.K * np.array([[factor, factor, 1], [factor, factor, 1], [1, 1, 1]]))

    def turned(self, turn: Turn) -> Lens:
        """Return the pinhole that remains after undistorting and turning the pictures."""
        (fx, _, cx), (_, fy, cy) = self.K[:2]
        if turn == "none":
            return Lens(self.width, self.height, self.K)
        if turn == "half":
            K = np.array([[fx, 0, self.width - cx], [0, fy, self.height - cy], [0, 0, 1.0]])
            return Lens(self.width, self.height, K)
        cx, cy = (self.height - cy, cx) if turn == "clockwise" else (cy, self.width - cx)
        return Lens(self.height, self.width, np.array([[fy, 0, cx], [0, fx, cy], [0, 0, 1.0]]))


@dataclass(frozen=True)
class CalibratedCamera:
    """A camera of cameras.json, by hand or by `gof capture calibrate`.

    Attributes:
        width, height, K, distortion: see `Lens`.
        name: for people; videos are matched by their order.
        world_to_camera: (4, 4) of the upright picture, world in metres, where the pose is known.
        rms_px, focal_sigma_px, coverage, views: how well the lens is known, see `gof.capture.calibration.Calibration`.
    """

    width: int
    height: int
    K: tuple[tuple[float, ...], ...]
    distortion: tuple[float, ...] = ()
    name: str | None = None
    world_to_camera: tuple[tuple[float, ...], ...] | None = None
    rms_px: float | None = None
    focal_sigma_px: float | None = None
    coverage: float | None = None
    views: int | None = None

    def __post_init__(self):
        who = f"camera '{self.name}': " if self.name else ""
        square = [len(row) for row in self.K] == [3, 3, 3]
        if not square or not np.isfinite(self.K).all() or not (np.diag(self.K) > 0).all():
            raise DataFormatError(f"{who}K must be 3x3 with positive focal lengths")
        if (self.K[0][1], *self.K[1][:1], *self.K[2]) != (0, 0, 0, 0, 1):
            raise DataFormatError(
                f"{who}K must be fx 0 cx, 0 fy cy, 0 0 1: OpenCV's model has no skew; is the matrix transposed?"
            )
        if len(self.distortion) not in DISTORTIONS or not np.isfinite(self.distortion).all():
            raise DataFormatError(f"{who}distortion must be none, or {DISTORTIONS[1:]} OpenCV numbers")

    @property
    def lens(self) -> Lens:
        return Lens(self.width, self.height, np.array(self.K), np.array(self.distortion, np.float64))


@dataclass(frozen=True)
class CamerasFile:
    """cameras.json: one entry per video, in their order, or one that stands for all."""

    SCHEMA: ClassVar[str] = "gof-cameras"
    VERSION: ClassVar[int] = 1

    cameras: tuple[CalibratedCamera, ...]


def read_cameras(path: Path, videos: Sequence[Path]) -> list[CalibratedCamera]:
    """Return the camera of each video by a cameras.json. A file by hand may leave out schema and version.

    Raises:
        DataFormatError: absent, not JSON, a missing or malformed field, another number of cameras, or names that say
            another order than the videos'.
    """
    count = len(videos)
    data = read_json(path)
    if isinstance(data, dict):
        data = {"schema": CamerasFile.SCHEMA, "version": CamerasFile.VERSION} | data
    cameras = list(from_json(CamerasFile, data, path, ignore_unknown=False).cameras)
    if len(cameras) not in (1, count):
        raise DataFormatError(f"{path}: 'cameras' must list one entry, or one per video ({count})")
    called = [camera.name for camera in cameras]
    stems = [video.stem if video.is_file() else video.name for video in videos]
    for place, (stem, video) in enumerate(zip(stems, videos, strict=True)):
        if len(cameras) == count and stem in called and called[place] != stem and stems.count(stem) == 1:
            raise DataFormatError(
                f"{path}: names the cameras {', '.join(map(str, called))}, and {video} is video {place + 1}: give the "
                "videos in the order of the cameras, or name the entries otherwise"
            )
    return cameras * count if len(cameras) == 1 else cameras


def prepare(picture: np.ndarray, lens: Lens, turn: Turn) -> np.ndarray:
    """Undistorted (same K) and upright picture; (H, W[, 3]) uint8."""
    return preparation(lens, turn)(picture)


def preparation(lens: Lens, turn: Turn) -> Callable[[np.ndarray], np.ndarray]:
    """Return `prepare` as a function for many pictures: the undistortion's maps are made once."""
    if not lens.distortion.any():
        return partial(turned, turn=turn)
    return straightening(lens.K, lens.distortion, lens, turn, half_pixel=0.5)


def straightening(
    K: np.ndarray, distortion: np.ndarray, straight: Lens, turn: Turn, half_pixel: float = 0.0
) -> Callable[[np.ndarray], np.ndarray]:
    """Return a function that makes a bent picture straight and upright.

    Args:
        K, distortion: of the bent picture.   straight: lens of the straight one, same size.
        half_pixel: what the first pixel's centre is in both, as OpenCV puts pixel centres at integers.
    """
    import cv2

    bent_K, straight_K = K.copy(), straight.K.copy()
    bent_K[:2, 2] -= half_pixel
    straight_K[:2, 2] -= half_pixel
    size = (straight.width, straight.height)
    x, y = cv2.initUndistortRectifyMap(bent_K, distortion, np.eye(3), straight_K, size, cv2.CV_16SC2)
    return lambda picture: turned(np.asarray(cv2.remap(picture, x, y, cv2.INTER_LINEAR)), turn)


def turned(picture: np.ndarray, turn: Turn) -> np.ndarray:
    """Return the picture (H, W[, 3]) turned upright."""
    import cv2

    if turn == "none":
        return picture
    codes = {
        "clockwise": cv2.ROTATE_90_CLOCKWISE,
        "counterclockwise": cv2.ROTATE_90_COUNTERCLOCKWISE,
        "half": cv2.ROTATE_180,
    }
    return cv2.rotate(picture, codes[turn])
