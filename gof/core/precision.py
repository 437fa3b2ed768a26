"""What float32 rounds off. Results hold times and places as float32, which knows seven digits and no more."""

from __future__ import annotations

import numpy as np

from .errors import GofError

MOST = 0.01  # of the least difference that matters


def rounded_off(values: np.ndarray) -> float:
    """How far apart neighbouring float32 numbers are at the largest of some values, in their unit."""
    largest = np.abs(np.asarray(values, np.float64)).max(initial=0.0)
    return float(np.spacing(np.float32(min(largest, 1e38))))


def require_digits(what: str, values: np.ndarray, least: float, remedy: str, most: float = MOST) -> None:
    """Make sure that float32 tells values apart that differ by a hundredth of `least`.

    Args:
        what: "the dataset's clock"; `least`: a frame's time, a voxel; `remedy`: what to do.
    Raises:
        GofError: it does not, with figures.
    """
    step = rounded_off(values)
    if least > 0 and step > most * least:
        largest = np.abs(values).max()
        raise GofError(
            f"{what} reaches {largest:.4g}, where float32 numbers, which results are made of, are {step:.2g} apart: "
            f"{step / least:.0%} of {least:.2g}, the least that matters. {remedy}"
        )
