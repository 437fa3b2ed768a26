"""Pictures of one camera as stored, from a video or a folder."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from gof.errors import DataFormatError
from gof.pictures import read_picture

PICTURES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")


def stored_frames(path: Path) -> Iterator[np.ndarray]:
    """Frames as (H, W, 3) uint8 RGB, as stored, in file (video) or name (folder) order.

    Raises:
        DataFormatError: not a readable video, an empty folder, a broken picture.
    """
    import cv2

    path = Path(path)
    if path.is_dir():
        for file in picture_files(path):
            yield cv2.cvtColor(read_picture(file), cv2.COLOR_BGR2RGB)
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


def picture_files(folder: Path) -> list[Path]:
    """The pictures of a folder in name order.

    Raises:
        DataFormatError: there is none.
    """
    files = sorted(f for f in Path(folder).iterdir() if f.suffix.lower() in PICTURES)
    if not files:
        raise DataFormatError(f"{folder}: no pictures ({', '.join(PICTURES)}) in this folder")
    return files


def first_frame(path: Path) -> np.ndarray:
    """The first stored frame, (H, W, 3) uint8 RGB."""
    return next(iter(stored_frames(path)))


def count_frames(path: Path) -> int:
    """How many frames can really be read (containers lie)."""
    return sum(1 for _ in stored_frames(path))


def stated_frames(path: Path) -> int | None:
    """How many frames a folder holds or a video's container states (for progress bars); None when it states none."""
    return len(picture_files(path)) if Path(path).is_dir() else _stated(path, "FRAME_COUNT", int)


def stated_fps(path: Path) -> float | None:
    """Frame rate the container states (slow-motion files state the playback rate), None when it states none."""
    return None if Path(path).is_dir() else _stated(path, "FPS", float)


def _stated(path, what, number):
    import cv2

    video = cv2.VideoCapture(str(path))
    value = video.get(getattr(cv2, f"CAP_PROP_{what}"))
    video.release()
    return number(value) if value and np.isfinite(value) and value > 0 else None


def distinct_names(paths: list[Path]) -> list[str]:
    """A name per footage: the stem, or parent and stem where stems repeat."""
    stems = [p.stem for p in paths]
    names = [s if stems.count(s) == 1 else f"{p.parent.name}_{s}" for s, p in zip(stems, paths, strict=True)]
    return [n if names.count(n) == 1 else f"{n}_{i}" for i, n in enumerate(names)]
