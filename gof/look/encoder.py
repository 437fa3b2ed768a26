"""Films as files: WebM and MP4 (both VP9) by the FFmpeg of OpenCV, animated WebP by Pillow; a still one as PNG."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from gof.core.errors import DataFormatError, GofError
from gof.core.files import atomic_path

CODES = {".webm": "VP90", ".mp4": "vp09"}  # the tags by which OpenCV finds the codec in either container
STILL = ".png"  # a film of one frame
SUFFIXES = (*CODES, ".webp", STILL)
WEBP_QUALITY = 88


def require_film(path: Path) -> None:
    """Raises GofError: the suffix is none of a film that can be written here."""
    if path.suffix.lower() not in SUFFIXES:
        raise GofError(f"--out {path}: a film ends in {', '.join(SUFFIXES)}")


def write_film(path: Path, frames: Iterable[np.ndarray], fps: float, quality: int = WEBP_QUALITY) -> Path:
    """Write frames (H, W, 3) uint8, all of one even size, one after another; atomically.

    Args:
        quality: of a .webp, 0 to 100.
    Raises:
        GofError: no such kind of film.   DataFormatError: it cannot be written, or not all of it was.
    """
    require_film(path)
    with atomic_path(path) as temporary:
        if path.suffix.lower() in CODES:
            count = _write_video(temporary, frames, fps)
        else:
            count = _write_pictures(temporary, frames, fps, quality)
        if count == 0 or not temporary.is_file() or temporary.stat().st_size == 0:
            raise DataFormatError(f"{path}: no film could be written")
    return path


def _write_video(path: Path, frames: Iterable[np.ndarray], fps: float) -> int:
    import cv2

    writer, count = None, 0
    for frame in frames:
        if writer is None:
            code = cv2.VideoWriter_fourcc(*CODES[path.suffix.lower()])
            with _quiet():
                writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, code, fps, frame.shape[1::-1])
            if not writer.isOpened():
                raise DataFormatError(f"{path.name}: this build of OpenCV cannot write VP9; write a .webp")
        writer.write(np.ascontiguousarray(frame[..., ::-1]))
        count += 1
    if writer is not None:
        writer.release()
    return count


def _write_pictures(path: Path, frames: Iterable[np.ndarray], fps: float, quality: int) -> int:
    from PIL import Image

    pictures = [Image.fromarray(frame) for frame in frames]
    if path.suffix.lower() == STILL and pictures:
        pictures[0].save(path, optimize=True)
    elif pictures:
        how = {"duration": round(1000 / fps), "loop": 0, "quality": quality}
        pictures[0].save(path, "webp", save_all=True, append_images=pictures[1:], **how)
    return len(pictures)


@contextmanager
def _quiet() -> Iterator[None]:
    """FFmpeg says on the screen that it takes another tag than it was given: of no use to anybody."""
    sys.stderr.flush()
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)
