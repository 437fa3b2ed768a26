"""Pictures of one camera, from a video or a folder, made upright, undistorted and of the asked size."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from gof.errors import DataFormatError

Turn = Literal["none", "clockwise", "counterclockwise"]
PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")
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
            raise DataFormatError(
                f"a horizontal field of view of {fov_deg} degrees; it must lie between 0 and 180"
            )
        focal = 0.5 * width / np.tan(np.deg2rad(fov_deg) / 2)
        return cls(width, height, np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]]))

    @classmethod
    def from_dict(cls, d: dict[str, Any], source: str) -> Lens:
        """Fields `width`, `height`, `K` and optionally `distortion`.

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
            raise DataFormatError(
                f"{source}: needs width, height, K (3x3) and optionally distortion ({e})"
            ) from e
        good = lens.K.shape == (3, 3) and np.isfinite(lens.K).all() and (np.diag(lens.K) > 0).all()
        if (
            not good
            or len(lens.distortion) not in (0, 4, 5, 8, 12, 14)
            or not np.isfinite(lens.distortion).all()
        ):
            raise DataFormatError(
                f"{source}: K must be 3x3 with positive focal lengths, distortion 4, 5, 8, 12 or 14 OpenCV numbers"
            )
        return lens

    def turned(self, turn: Turn) -> Lens:
        """The pinhole that remains after undistorting and turning the pictures."""
        (fx, _, cx), (_, fy, cy) = self.K[:2]
        if turn == "none":
            return Lens(self.width, self.height, self.K)
        cx, cy = (self.height - cy, cx) if turn == "clockwise" else (cy, self.width - cx)
        return Lens(self.height, self.width, np.array([[fy, 0, cx], [0, fx, cy], [0, 0, 1.0]]))


def stored_frames(path: Path) -> Iterator[np.ndarray]:
    """Frames as (H, W, 3) uint8 RGB, as stored, in file (video) or name (folder) order.

    Raises:
        DataFormatError: not a readable video, an empty folder, a broken picture.
    """
    import cv2

    path = Path(path)
    if path.is_dir():
        files = sorted(f for f in path.iterdir() if f.suffix.lower() in PICTURES)
        if not files:
            raise DataFormatError(f"{path}: no pictures ({', '.join(PICTURES)}) in this folder")
        for file in files:
            frame = cv2.imread(str(file), cv2.IMREAD_COLOR)
            if frame is None:
                raise DataFormatError(f"{file}: cannot be decoded as a picture")
            yield cv2.cvtColor(frame, cv2.COLOR_BGR2RGB)
        return
    if not path.is_file():
        raise DataFormatError(f"{path}: no such video or folder of pictures")
    video, count = cv2.VideoCapture(str(path)), 0
    try:
        while True:
            ok, frame = video.read()
            if not ok:
                break
            count += 1
            yield cv2.cvtColor(frame, cv2.COLOR_BGR2RGB)
    finally:
        video.release()
    if not count:
        raise DataFormatError(f"{path}: OpenCV reads no frame from it; re-encode it, for example with ffmpeg")


def prepare(frame: np.ndarray, lens: Lens, turn: Turn) -> np.ndarray:
    """Undistorted (same K) and upright picture; (H, W, 3) uint8."""
    import cv2

    if lens.distortion.any():
        K = lens.K.copy()
        K[:2, 2] -= 0.5  # OpenCV puts pixel centres at integers
        frame = cv2.undistort(frame, K, lens.distortion)
    if turn != "none":
        code = cv2.ROTATE_90_CLOCKWISE if turn == "clockwise" else cv2.ROTATE_90_COUNTERCLOCKWISE
        frame = cv2.rotate(frame, code)
    return frame


def read_clip(path: Path, lens: Lens, turn: Turn, frames: range) -> np.ndarray:
    """(T, H, W, 3) uint8 RGB: the prepared pictures of these frame numbers.

    Raises:
        DataFormatError: the footage is shorter, or of another size than the lens says.
    """
    clip = []
    for k, frame in enumerate(stored_frames(path)):
        if k >= frames.stop:
            break
        if frame.shape[:2] != (lens.height, lens.width):
            raise DataFormatError(
                f"{path}: frame {k} is {frame.shape[1]}x{frame.shape[0]}, the lens is given for {lens.width}x{lens.height}"
            )
        if k in frames:
            clip.append(prepare(frame, lens, turn))
    if len(clip) < len(frames):
        raise DataFormatError(f"{path}: has {frames.start + len(clip)} frames, {frames.stop} are asked for")
    return np.stack(clip)


def first_frame(path: Path) -> np.ndarray:
    """The first stored frame, (H, W, 3) uint8 RGB."""
    return next(iter(stored_frames(path)))


def count_frames(path: Path) -> int:
    """How many frames can really be read (containers lie)."""
    return sum(1 for _ in stored_frames(path))
