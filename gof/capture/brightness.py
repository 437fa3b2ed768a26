"""The brightness that the decoder needs: the smallest colour channel, which white LEDs fill and flames do not."""

from __future__ import annotations

import numpy as np


def white(frame: np.ndarray) -> np.ndarray:
    """(H, W) uint8: the smallest colour channel."""
    import cv2

    if frame.ndim == 2:
        return frame
    a, b, c = cv2.split(frame)
    return cv2.min(cv2.min(a, b), c)


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
