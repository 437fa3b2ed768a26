"""Reads video as the brightness that the decoder needs: the smallest colour channel, which white LEDs fill and flames do not."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from gof.errors import DataFormatError


def frames(path: Path) -> Iterator[np.ndarray]:
    """Frames of a video as (H, W, 3) uint8 BGR, in file order.

    Raises:
        DataFormatError: the file cannot be opened as a video, or holds no frame.
    """
    import cv2

    if not Path(path).is_file():
        raise DataFormatError(f"{path}: no such video")
    video = cv2.VideoCapture(str(path))
    try:
        count = 0
        while True:
            ok, frame = video.read()
            if not ok:
                break
            count += 1
            yield frame
        if not count:
            raise DataFormatError(f"{path}: OpenCV reads no frame from it; re-encode it, for example with ffmpeg")
    finally:
        video.release()


def nominal_fps(path: Path) -> float | None:
    """Frame rate the container states (slow-motion files state the playback rate), None when it states none."""
    import cv2

    video = cv2.VideoCapture(str(path))
    fps = video.get(cv2.CAP_PROP_FPS)
    video.release()
    return float(fps) if fps and np.isfinite(fps) and fps > 0 else None


def white(frame: np.ndarray) -> np.ndarray:
    """(H, W) uint8: the smallest colour channel."""
    import cv2

    if frame.ndim == 2:
        return frame
    blue, green, red = cv2.split(frame)
    return cv2.min(cv2.min(blue, green), red)


def sample(image: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Bilinear values of an (H, W) image at continuous pixel coordinates (..., 2) (centres at integer + 0.5); points
    outside take the nearest edge pixel."""
    import cv2

    flat = np.asarray(points, np.float32).reshape(-1, 2) - np.float32(0.5)
    columns = 4096  # OpenCV maps are limited to 32767 entries per side
    rows = -(-len(flat) // columns)
    maps = np.zeros((2, rows * columns), np.float32)
    maps[:, : len(flat)] = flat.T
    values = cv2.remap(image, *maps.reshape(2, rows, columns), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return values.reshape(-1)[: len(flat)].reshape(np.shape(points)[:-1]).astype(np.float32)
