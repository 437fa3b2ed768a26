"""Picture files. Those that are read are not trusted: their header is checked before memory is taken for them."""

from __future__ import annotations

import io
import warnings
from pathlib import Path

import numpy as np

from gof.core.errors import DataFormatError
from gof.core.files import atomic_path

ORIENTATION = 0x0112  # tag of EXIF and TIFF
TURNS = {3: 180, 6: 90, 8: 270}  # its values, degrees clockwise
MIRRORED = (2, 4, 5, 7)
MOST_PIXELS = 2**28  # 16384 x 16384, where nothing else is known


def read_picture(
    path: Path, size: tuple[int, int] | None = None, most: int = MOST_PIXELS, unchanged: bool = False, remedy: str = ""
) -> np.ndarray:
    """Return a picture as it is stored, whatever its orientation tag says (but for TIFF files, which OpenCV turns).

    (H, W, 3) uint8 BGR; `unchanged`: its own channels and depth.

    Args:
        size: (width, height) that it must have.   most: pixels that it may have.
        remedy: what to do about one with more; ends the error.
    Raises:
        DataFormatError: absent, not a picture that can be decoded, of another size, or larger.
    """
    import cv2

    if not path.is_file():
        raise DataFormatError(f"{path}: no such file")
    data = path.read_bytes()  # OpenCV itself crashes at a path that is not UTF-8
    width, height = _size(data, path)
    if width * height > (size[0] * size[1] if size else most):
        raise DataFormatError(f"{path}: is {width}x{height}, {_expected(size, most)}{remedy and f'; {remedy}'}")
    colors = cv2.IMREAD_UNCHANGED if unchanged else cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        picture = cv2.imdecode(np.frombuffer(data, np.uint8), colors)
    except cv2.error:
        picture = None
    if picture is None:
        raise DataFormatError(f"{path}: cannot be decoded; remove it, and make it again")
    if size and picture.shape[1::-1] != size:
        raise DataFormatError(f"{path}: is {picture.shape[1]}x{picture.shape[0]}, {_expected(size, most)}")
    return picture


def _expected(size: tuple[int, int] | None, most: int) -> str:
    return f"the camera says {size[0]}x{size[1]}" if size else f"at most {most} pixels are expected"


def write_picture(path: Path, picture: np.ndarray) -> None:
    """Write (H, W, 3) BGR or (H, W) values in the format of the suffix, atomically.

    Raises:
        DataFormatError: the format cannot hold it.   OSError: the disk does not take it.
    """
    import cv2

    ok, data = cv2.imencode(path.suffix, picture)
    if not ok:
        raise DataFormatError(f"{path}: OpenCV cannot encode {picture.dtype} of shape {picture.shape}")
    with atomic_path(path) as temporary:
        temporary.write_bytes(data.tobytes())


def read_rotation(path: Path) -> int:
    """0, 90, 180 or 270: how far a viewer turns a picture clockwise, by its orientation tag; 0 without one.

    Raises:
        DataFormatError: it cannot be decoded; it is tagged as mirrored, or is a TIFF that is tagged as turned.
    """
    from PIL import Image

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with Image.open(path) as opened:
                tag, kind = opened.getexif().get(ORIENTATION, 1), opened.format
    except Exception as e:  # each of its formats has errors of its own for damage
        raise DataFormatError(f"{path}: cannot be decoded; remove it, and make it again") from e
    if tag in MIRRORED or (kind == "TIFF" and tag in TURNS):
        raise DataFormatError(
            f"{path}: its orientation tag says {'mirrored' if tag in MIRRORED else 'turned'}; save the pictures as "
            "they should be seen, without the tag"
        )
    return TURNS.get(tag, 0)


def _size(data: bytes, path: Path) -> tuple[int, int]:
    from PIL import Image

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with Image.open(io.BytesIO(data)) as opened:
                return opened.size
    except Image.DecompressionBombError as e:
        raise DataFormatError(f"{path}: {e}") from e
    except Exception as e:  # each of its formats has errors of its own for damage
        raise DataFormatError(f"{path}: cannot be decoded; remove it, and make it again") from e
