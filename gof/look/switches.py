"""The controls that the player of `gof share` and `gof view` have in common: one name, one range and one colour map."""

from __future__ import annotations

import cv2
import numpy as np

# In the order in which both show them
CAMERA = "Camera"
COLOUR = "Colour"
COLOURS = ("Radiance", "Speed", "Doubt")  # of the light; of the gas, m/s; standard deviation of its components, m/s
LINES = "Velocity lines"
SIZE = "Size of Gaussians"
SIZE_PERCENT = (5, 150, 5)  # least, most, step; 100 = as they are
RESET = "Reset view"
TIME = "Time"
PLAY = "Play"
SPEED = "Speed"
LOOP = "Loop"
SPEEDS = {"1\u00d7": 1, "1/2": 2, "1/5": 5, "1/10": 10, "1/20": 20, "1/50": 50, "1/100": 100}  # times slower
FIRST_SPEED = "1/10"


def scheme() -> np.ndarray:
    """(256, 3) uint8 sRGB: viridis, dark violet for nothing to yellow for the most."""
    return cv2.applyColorMap(np.arange(256, dtype=np.uint8)[:, None], cv2.COLORMAP_VIRIDIS)[:, 0, ::-1]
