"""The plates that a flame-only result is drawn over: its own beside it (plates/CAMERA.png), else the dataset's."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from gof.core.errors import DataFormatError
from gof.core.files import path_in
from gof.dataset.dataset import Dataset
from gof.footage.pictures import read_picture, write_picture

LEVELS = 65535  # 16 bits: plates are optimised and lit in steps finer than 1/255


def save_plates(folder: Path, names: list[str], plates: list[np.ndarray]) -> None:
    """Write folder/plates/NAME.png, 16 bits, from (H, W, 3) display sRGB in [0, 1].

    A fourth value, the PNG's alpha, says how much of a pixel stands before the flame.

    Raises:
        DataFormatError: a name leads out of the folder.
    """
    for name, plate in zip(names, plates, strict=True):
        stored = np.concatenate([plate[..., 2::-1], plate[..., 3:]], -1)  # OpenCV's blue, green, red, alpha
        write_picture(_plate(folder, name), np.rint(np.clip(stored, 0, 1) * LEVELS).astype(np.uint16))


def _plate(folder: Path, name: str) -> Path:
    return path_in(folder, f"plates/{name}.png")


def has_own_plate(result: Path, name: str) -> bool:
    """Return whether a result (its file or folder) has a plate of its own for a camera."""
    return _plate(result if result.is_dir() else result.parent, name).is_file()


def background(dataset: Dataset, camera: int, result: Path | None) -> np.ndarray:
    """Read the view of a camera without flame; arguments and result as in `own_plate`."""
    return own_plate(dataset.static(camera), dataset.cameras[camera].name, result)


def own_plate(static: np.ndarray, name: str, result: Path | None) -> np.ndarray:
    """Read the view of a camera without flame, as the result knows it: (H, W, 3) float32 display sRGB in [0, 1].

    (H, W, 4) where the result knows of something that stands before the flame: the fourth value, 0..1, is how much of a
    pixel does.

    Args:
        static: (H, W, 3) the dataset's plate, which it is where the result has none.
        name: of the camera.
        result: file or folder of the result, None when there is none. Its plates may be smaller than the dataset's
            pictures; then what they add to the dataset's plate is enlarged, and the plate keeps its sharpness.
    Raises:
        DataFormatError: a plate cannot be read, or is larger than the dataset's pictures.
    """
    if result is None:
        return static
    path = _plate(result if result.is_dir() else result.parent, name)
    if not path.is_file():
        return static
    height, width = static.shape[:2]
    remedy = (
        f"the dataset's pictures are {width}x{height}: score against the dataset that the result was made from, or "
        "remove plates/ beside the result to use the dataset's"
    )
    stored = read_picture(path, most=height * width, unchanged=True, remedy=remedy)
    if stored.dtype != np.uint16 or stored.ndim != 3 or stored.shape[2] not in (3, 4):
        raise DataFormatError(
            f"{path}: not a 16-bit RGB or RGBA PNG; remove the file to use the dataset's plate, or reconstruct again"
        )
    plate: np.ndarray = stored[..., 2::-1].astype(np.float32) / LEVELS
    before: np.ndarray = stored[..., 3:].astype(np.float32) / LEVELS
    if plate.shape != static.shape:
        small, large = plate.shape[1::-1], static.shape[1::-1]
        added = plate - cv2.resize(static, small, interpolation=cv2.INTER_AREA)
        plate = np.clip(static + cv2.resize(added, large, interpolation=cv2.INTER_LINEAR), 0, 1)
        if before.size:
            before = cv2.resize(before, large, interpolation=cv2.INTER_LINEAR)[..., None]
    return np.concatenate([plate, before], -1) if before.size else plate
