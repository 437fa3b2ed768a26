"""The fire-free plate in the fire's own light.

A fire lights its surroundings. Without that light in the plate, fat faint Gaussians paint it in front of walls and
floor, where no gas moves; they spoil the motion and the pictures around the flame (docs/choices.md has the
figures).
"""

from __future__ import annotations

import cv2
import numpy as np

LEAST_SEEN = 1 / 8  # share of the pictures in which a pixel must be free of flame for its median to be believed
FILL = 1 / 24  # of the height: how far light is carried on behind the flame


def lit_plate(static: np.ndarray, images: np.ndarray, masks: np.ndarray) -> np.ndarray:
    """The view without flame but with its light: the temporal median of what is not flame.

    Args:
        static: (H, W, 3) the fire-free plate.   images: (F, H, W, 3), same range.
        masks: (F, H, W) bool, where flame may be (all of a picture that does not count).
    Returns:
        (H, W, 3) float32. Pixels hardly ever free of flame get their surroundings' light, or none where nothing was
        seen.
    """
    count = (~masks).sum(0)
    seen = count >= max(LEAST_SEEN * len(images), 2)
    rise = np.zeros_like(static, dtype=np.float32)
    for row in range(len(static)):  # sorting whole clips of large pictures would take gigabytes
        free = np.sort(np.where(masks[:, row, :, None], np.inf, images[:, row]), axis=0)
        middle = [
            np.take_along_axis(free, np.maximum(count[row] - 1 + up, 0)[None, :, None] // 2, 0)[0] for up in (0, 1)
        ]
        median = np.where(seen[row, :, None], 0.5 * (middle[0] + middle[1]), static[row])
        rise[row] = median - static[row]
    width = FILL * len(static)
    weight = cv2.GaussianBlur(seen.astype(np.float32), (0, 0), width)
    around = cv2.GaussianBlur(rise, (0, 0), width) / np.maximum(weight, 1e-3)[..., None]
    return np.clip(static + np.where(seen[..., None], rise, around), 0, 1).astype(np.float32)
