"""A camera's lens: intrinsics of the pictures as stored, and what undistorting and turning upright makes of them."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from gof.errors import DataFormatError
from gof.io.files import read_json

Turn = Literal["none", "clockwise", "counterclockwise"]
ROLL_DEG = {"none": 0, "clockwise": 90, "counterclockwise": -90}


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

    @classmethod
    def from_dict(cls, d: dict[str, Any], source: str) -> Lens:
        """Fields `width`, `height`, `K` and optionally `distortion`; others are ignored.

        Raises:
            DataFormatError: one is missing or malformed (names `source`).
        """
        try:
            lens = cls(
                int(d["width"]),
                int(d["height"]),
                np.asarray(d["K"], np.float64),
                np.ravel(np.asarray(d.get("distortion", []), np.float64)),
            )
        except (KeyError, TypeError, ValueError) as e:
            raise DataFormatError(f"{source}: needs width, height, K (3x3) and optionally distortion ({e})") from e
        good = lens.K.shape == (3, 3) and np.isfinite(lens.K).all() and (np.diag(lens.K) > 0).all()
        if not good or len(lens.distortion) not in (0, 4, 5, 8, 12, 14) or not np.isfinite(lens.distortion).all():
            raise DataFormatError(
                f"{source}: K must be 3x3 with positive focal lengths, distortion 4, 5, 8, 12 or 14 OpenCV numbers"
            )
        return lens

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready; inverse of `from_dict`."""
        return {
            "width": self.width,
            "height": self.height,
            "K": self.K.tolist(),
            "distortion": self.distortion.tolist(),
        }

    def turned(self, turn: Turn) -> Lens:
        """The pinhole that remains after undistorting and turning the pictures."""
        (fx, _, cx), (_, fy, cy) = self.K[:2]
        if turn == "none":
            return Lens(self.width, self.height, self.K)
        (cx, cy) = self._turn_point(cx, cy, turn)
        return Lens(self.height, self.width, np.array([[fy, 0, cx], [0, fx, cy], [0, 0, 1.0]]))

    def _turn_point(self, x, y, turn: Turn):
        """Where a point of the stored picture lies in the turned one."""
        return {"none": (x, y), "clockwise": (self.height - y, x), "counterclockwise": (y, self.width - x)}[turn]

    def before_undistortion(self, turn: Turn) -> np.ndarray:
        """(H, W, 2): for each pixel of the prepared picture, where its light was in the turned picture before undistortion
        (continuous pixel coordinates, may lie outside)."""
        import cv2

        xy = np.stack(np.meshgrid(np.arange(self.width) + 0.5, np.arange(self.height) + 0.5), -1)
        if self.distortion.any():
            rays = np.concatenate([xy, np.ones((*xy.shape[:2], 1))], -1) @ np.linalg.inv(self.K).T
            still = np.zeros(3)
            xy = cv2.projectPoints(rays.reshape(-1, 1, 3), still, still, self.K, self.distortion)[0].reshape(xy.shape)
        xy = np.stack(self._turn_point(xy[..., 0], xy[..., 1], turn), -1)
        return np.rot90(xy, {"none": 0, "clockwise": -1, "counterclockwise": 1}[turn])


def read_cameras(path: Path, count: int) -> list[dict[str, Any]]:
    """The `count` camera entries of a JSON file {"cameras": [...]}; one entry stands for all.

    Raises:
        DataFormatError: absent, not JSON, or another number of cameras.
    """
    d = read_json(path)
    entries = d.get("cameras") if isinstance(d, dict) else None
    if not isinstance(entries, list) or len(entries) not in (1, count):
        raise DataFormatError(f"{path}: 'cameras' must list one entry, or one per video ({count})")
    return entries * count if len(entries) == 1 else entries


def prepare(picture: np.ndarray, lens: Lens, turn: Turn) -> np.ndarray:
    """Undistorted (same K) and upright picture; (H, W[, 3]) uint8."""
    import cv2

    if lens.distortion.any():
        K = lens.K.copy()
        K[:2, 2] -= 0.5  # OpenCV puts pixel centres at integers
        picture = cv2.undistort(picture, K, lens.distortion)
    if turn != "none":
        code = cv2.ROTATE_90_CLOCKWISE if turn == "clockwise" else cv2.ROTATE_90_COUNTERCLOCKWISE
        picture = cv2.rotate(picture, code)
    return picture


def row_delay(lens: Lens, turn: Turn, readout: str, row_time_s: float) -> np.ndarray:
    """When each pixel of a prepared picture is read, after the first line of the sensor.

    Undistortion bends the sensor's lines, so they are no lines of the prepared picture.

    Args:
        readout: direction of later lines in the prepared picture (down, up, left, right).
        row_time_s: from one stored line to the next.
    Returns:
        (H, W) float64 s; below 0 and beyond the last line where the sensor did not look.
    """
    at = lens.before_undistortion(turn)[..., 0 if readout in ("left", "right") else 1]
    lines = at.shape[1] if readout in ("left", "right") else at.shape[0]
    return row_time_s * ((at if readout in ("right", "down") else lines - at) - 0.5)
