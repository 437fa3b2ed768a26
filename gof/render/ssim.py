"""The window and the constants of SSIM (Wang et al. 2004), for a range of values of 1."""

from __future__ import annotations

import numpy as np

C1, C2 = 0.01**2, 0.03**2
REACH = 5  # the window covers 11 pixels
SIGMA_PX = 1.5  # of the window (Wang et al. 2004)


def _gaussian_window() -> list[float]:
    """Return the SSIM window along one axis, normalised.

    The reference twin has its own, so that the tests compare the two.
    """
    weights = np.exp(-0.5 * (np.arange(-REACH, REACH + 1) / SIGMA_PX) ** 2)
    return (weights / weights.sum()).tolist()


WINDOW = _gaussian_window()
