"""The fire-free plate in the fire's own light.

A fire lights its surroundings. Without that light in the plate, fat faint Gaussians paint it in front of walls and
floor, where no gas moves; they spoil the motion and the pictures around the flame (notebook/choices.md has the
figures).
"""

from __future__ import annotations

import cv2
import numpy as np

from gof.footage.flame_mask import STRONG, WEAK, flame_mask

LEAST_SEEN = 1 / 8  # share of the pictures in which a pixel must be free of flame for its median to be believed
FILL = 1 / 24  # of the height: how far light is carried on behind the flame
FAINT, FAINT_SOMEWHERE = 0.06, 0.12  # of `flame_mask` over a lit plate, display values
NOISE_TO_SD = 1.4826  # of a normal distribution, from the median of its absolute values
LEAST_OVER_NOISE = 4.0  # standard deviations
NOISE_PICTURES = 16  # of a clip, from which its noise is read


def faint_flame(
    static: np.ndarray, images: np.ndarray, bright: np.ndarray, unseen: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Masks that have the faint flame, too, and the plate in the light of the fire.

    Over a plate in the dark, faint flame and what the fire throws on a wall rise alike. So bright flame is found first;
    pixels without it say what is thrown; and above *that*, flame may be fainter.

    Args:
        static, images: as in `lit_plate`.
        bright: (F, H, W) bool, flame that stands out of the dark.   unseen: (F, 1, 1) bool, pictures that are none.
    Returns:
        (F, H, W) bool, `bright` and more, and (H, W, 3) `lit_plate` by it. Where the thrown light is nowhere known (a
        clip of a picture or two), `bright` and the plate in the dark.
    """
    plate = lit_plate(static, images, bright | unseen)
    free = ~(bright | unseen)
    if not often(free).any():
        return bright, plate
    noise = _noise(images, plate, free)
    weak = min(max(FAINT, LEAST_OVER_NOISE * noise), WEAK)
    strong = min(max(FAINT_SOMEWHERE, 2 * LEAST_OVER_NOISE * noise), STRONG)
    masks = bright | np.stack([flame_mask(image, plate, weak, strong) for image in images])
    return masks, lit_plate(static, images, masks | unseen)


def _noise(images: np.ndarray, plate: np.ndarray, free: np.ndarray) -> float:
    """Measure red's standard deviation about the plate where `free` (F, H, W) of flame, display values.

    Flame hardly moves it. It takes NOISE_PICTURES pictures that have a free pixel; there must be one.
    """
    some = np.flatnonzero(free.any((1, 2)))
    few = some[:: -(-len(some) // NOISE_PICTURES)]
    return NOISE_TO_SD * float(np.median(np.abs(images[few, ..., 0] - plate[..., 0])[free[few]]))


def often(free: np.ndarray) -> np.ndarray:
    """(H, W) bool: pixels that are free of flame, `free` (F, H, W), in enough pictures for a median of them."""
    return free.sum(0) >= max(LEAST_SEEN * len(free), 2)


def lit_plate(static: np.ndarray, images: np.ndarray, masks: np.ndarray) -> np.ndarray:
    """Return the view without flame but with its light: the temporal median of what is not flame.

    Args:
        static: (H, W, 3) the fire-free plate.   images: (F, H, W, 3), same range.
        masks: (F, H, W) bool, where flame may be (all of a picture that does not count).
    Returns:
        (H, W, 3) float32. Pixels hardly ever free of flame get their surroundings' light, or none where nothing was
        seen.
    """
    count = (~masks).sum(0)
    seen = often(~masks)
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
