"""Where flame may be in a picture, told from the view without it."""

from __future__ import annotations

import cv2
import numpy as np

WEAK, STRONG = 0.15, 0.35  # display values: more than a fire throws on its surroundings
BRIGHT = 0.65  # by which red of a picture's brightest flame rises, unless its camera is dimmer than others
DIMMEST = 0.6  # share of WEAK and STRONG: so much of STRONG is still more than a fire throws


def flame_mask(
    image: np.ndarray, static: np.ndarray, weak: float | None = None, strong: float | None = None, grow_px: int = 2
) -> np.ndarray:
    """Return (H, W) bool: where flame may be, closed and grown by `grow_px`.

    Flame raises red most, and so does the light it throws on its surroundings, only less. Hence hysteresis: regions
    whose rise in red, and in red over blue, is above `weak` everywhere and above `strong` somewhere. An overexposed
    core is white; so where red rises above `strong` a region goes on, whatever blue does. White light that touches no
    flame (LEDs) is none. In a dim picture everything rises by less, so thresholds that are not given fall with its
    brightest flame.

    Args:
        image, static: (H, W, 3) display sRGB in [0, 1], with and without fire.
        weak, strong: display values; default: WEAK and STRONG, less in a picture that is dimmer than BRIGHT.
    """
    rise, red = above_plate(image, static), image[..., 0] - static[..., 0]
    if weak is None or strong is None:
        brightest = cv2.medianBlur(np.nan_to_num(red, nan=0).astype(np.float32), 3).max()  # no single pixel
        share = float(np.clip(brightest / BRIGHT, DIMMEST, 1))
        weak = share * WEAK if weak is None else weak
        strong = share * STRONG if strong is None else strong
    white_hot = red > strong
    _, region = cv2.connectedComponents(((rise > weak) | white_hot).astype(np.uint8))
    flame = np.isin(region, np.unique(region[rise > strong])) & (region > 0)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * grow_px + 1, 2 * grow_px + 1))
    return cv2.dilate(cv2.morphologyEx(flame.astype(np.uint8), cv2.MORPH_CLOSE, disc), disc) > 0


def above_plate(image: np.ndarray, static: np.ndarray) -> np.ndarray:
    """Return (..., H, W): how far red, and red over blue, rise above the plate: the smaller of the two, display values.

    0 where green rises more than red, as it does where leaves sway and never where something glows.
    """
    red, green, blue = np.moveaxis(image - static, -1, 0)
    return np.where(green > red, 0.0, np.minimum(red, red - blue))
