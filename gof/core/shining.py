"""Light that Gaussians give off, by the colour and the opacity with which they are drawn.

A Gaussian i adds alpha_i g_i / s_i to the opacity per metre (`gof.evaluate.visible`) and shines in its linear colour
c_i, so its whole light is

    m_i = c_i (-log(1 - alpha_i)) (2 pi)^(3/2) s_i^2,   s_i = (s_x s_y s_z)^(1/3),

radiance in units of display white times square metres; -log(1 - alpha) is the thickness that an opacity stands for. A
ray through its middle is sqrt(2 pi) times as thick by that as it is drawn: what a picture shows of it, summed over the
picture's plane, is m_i / sqrt(2 pi).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .colour import srgb_to_linear
from .gaussians import TransientGaussians
from .harmonics import plain_color

DRAWN = 1 / 255  # alpha below which nothing is drawn
OPAQUE = 0.998  # alpha above which thickness is not told apart


class Shining(NamedTuple):
    """The dynamic Gaussians that are drawn at a time, float64.

    Attributes:
        rows: (N,) of the Gaussians.   middle: (N, 3) world m.
        brightness: (N, 3) linear colour times thickness.   light: (N, 3) >= 0, m2, of each as a whole.
    """

    rows: np.ndarray
    middle: np.ndarray
    brightness: np.ndarray
    light: np.ndarray


def shining_at(gaussians: TransientGaussians, time_s: float) -> Shining:
    """Return which dynamic Gaussians are drawn at a time, and their light; colours count within [0, 1]."""
    position, alpha = gaussians.at(time_s)
    rows = np.flatnonzero(gaussians.dynamic & (alpha >= DRAWN))
    colour = srgb_to_linear(np.clip(plain_color(gaussians.color[rows]), 0, 1)).astype(np.float64)
    brightness = colour * -np.log1p(-np.minimum(alpha[rows].astype(np.float64), OPAQUE))[:, None]
    size = np.cbrt(gaussians.scale[rows].astype(np.float64).prod(1)) ** 2
    return Shining(rows, position[rows].astype(np.float64), brightness, brightness * (2 * np.pi) ** 1.5 * size[:, None])
