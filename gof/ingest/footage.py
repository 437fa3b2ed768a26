"""A camera's clip: its pictures made upright and undistorted."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gof.errors import DataFormatError
from gof.footage import stored_frames
from gof.lens import Lens, Turn, prepare


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
