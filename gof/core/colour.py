"""Display sRGB (IEC 61966-2-1) and linear light; the colours of motion in a picture, one wheel for all of them."""

from __future__ import annotations

import numpy as np

UP_HUE = 235.0  # degrees in OKLab
# OKLab to linear sRGB (Ottosson 2020, "A perceptual color space for image processing")
LMS_OF_LAB = np.array(
    [[1, 0.3963377774, 0.2158037573], [1, -0.1055613458, -0.0638541728], [1, -0.0894841775, -1.2914855480]]
)
RGB_OF_LMS = np.array(
    [
        [4.0767416621, -3.3077115913, 0.2309699292],
        [-1.2684380046, 2.6097574011, -0.3413193965],
        [-0.0041960863, -0.7034186147, 1.7076147010],
    ]
)


def srgb_to_linear(x: np.ndarray) -> np.ndarray:
    """Display values in [0, 1], any shape, to linear light in [0, 1], float32."""
    return np.where(x <= 0.04045, x / 12.92, ((np.maximum(x, 0) + 0.055) / 1.055) ** 2.4).astype(np.float32)


def linear_to_srgb(x: np.ndarray) -> np.ndarray:
    """Linear light in [0, 1], any shape, to display values in [0, 1], of the precision of `x`."""
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 1e-9) ** (1 / 2.4) - 0.055)


def add_light(color: np.ndarray, alpha: np.ndarray, background: np.ndarray) -> np.ndarray:
    """Return (..., 3) display values of emissive Gaussians over what lies behind them.

    Fire adds its light to what is behind it and hides next to nothing of it. So light is added as cameras add it, in
    linear values; and of the Gaussians' opacity only what is more than they shine hides. To blend display values, as
    splats of surfaces do, takes the blue of a grey wall from the orange flame before it.

    Args:
        color: (..., 3) display values over black.   alpha: (...) opacity, 0..1.   background: (..., 3) display values.
    """
    cover = np.maximum(alpha - np.asarray(color).max(-1), 0)[..., None]
    return linear_to_srgb(srgb_to_linear(background) * (1 - cover) + srgb_to_linear(color))


def direction_colors(flow: np.ndarray, longest: float) -> np.ndarray:
    """Convert (..., 2) px/s to (..., 3) display colours: hue is the direction, brightness the length up to `longest`.

    The palette runs around a circle of equal chroma in a perceptual space (OKLab), so that no direction looks faster
    than another; up is a blue that no flame has.
    """
    length = np.clip(np.linalg.norm(flow, axis=-1) / max(longest, 1e-12), 0, 1)
    hue = np.arctan2(flow[..., 1], flow[..., 0]) + np.deg2rad(UP_HUE + 90)  # image y points down: up is -90 degrees
    lightness = 0.22 + 0.55 * length
    chroma = 0.145 * length
    lab = np.stack([lightness, chroma * np.cos(hue), chroma * np.sin(hue)], -1)
    lms = (lab @ LMS_OF_LAB.T) ** 3
    return linear_to_srgb(np.clip(lms @ RGB_OF_LMS.T, 0, 1))
