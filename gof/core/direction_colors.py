"""The colours of motion in a picture: one colour wheel for all pages and stage pictures."""

from __future__ import annotations

import numpy as np

from .colour import linear_to_srgb

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


def direction_colors(flow: np.ndarray, longest: float) -> np.ndarray:
    """(..., 2) px/s to (..., 3) display colours: hue is the direction, brightness the length up to `longest`.

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
