"""The strongest trivial baseline of a held-out picture: the two frames around it, carried half way along their flow.

They are frames of *the very camera* that is drawn, which no method has for a view that was not filmed; so this says
what noise and compression leave to be had, and how far a flame in space is from it.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from gof.dataset import Dataset

Flow = Callable[[np.ndarray, np.ndarray], np.ndarray]  # of two pictures (H, W, 3) uint8: (H, W, 2) px


def between_neighbours(dataset: Dataset, camera: int, frame: int, flow: Flow) -> np.ndarray | None:
    """Return the (H, W, 3) display values of a frame by the two around it; None at the ends of the clip.

    Args:
        flow: finds the optical flow between two pictures.
    """
    if not 0 < frame < len(dataset.times_s) - 1:
        return None
    before, after = (dataset.image(camera, k) for k in (frame - 1, frame + 1))
    first, last = (np.rint(255 * picture).astype(np.uint8) for picture in (before, after))
    return (_moved(before, flow(first, last) / 2) + _moved(after, flow(last, first) / 2)) / 2


def _moved(picture: np.ndarray, flow: np.ndarray) -> np.ndarray:
    """Return the picture moved by `flow` (H, W, 2), px, taken to change slowly over the flow's own length.

    Beyond its edge it goes on as it is there.
    """
    height, width = flow.shape[:2]
    x, y = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    place = x - flow[..., 0], y - flow[..., 1]
    return cv2.remap(picture.astype(np.float32), *place, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
