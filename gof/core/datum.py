"""The datum: where a world and a clock are measured from, in float64.

float32, which Gaussians are made of, knows seven digits. UTM coordinates and Unix seconds use them up before the first
millimetre and millisecond. So a dataset far from zero is opened measured from its datum, its results are too, and say
so in their files.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from .errors import DataFormatError, GofError

WORLD = 1e-5  # of the distance between cameras, that float32 may round a place by


@dataclass(frozen=True)
class Datum:
    """A point of the world and an instant of the clock. position: (3,) m.   time_s: s. Zeros: nothing was moved."""

    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    time_s: float = 0.0

    @classmethod
    def of(cls, centres: np.ndarray, times_s: np.ndarray) -> Datum:
        """Return that of cameras at `centres` (C, 3) m and frames at `times_s` (T,) s; zeros where float32 has digits
        to spare.

        The world's is a round number amid the cameras, the clock's is the first frame.
        """
        centres, times_s = np.asarray(centres, np.float64), np.asarray(times_s, np.float64)
        position, time_s = np.zeros(3), 0.0
        apart = float(np.ptp(centres, axis=0).max()) if len(centres) else 0.0
        if apart > 0 and rounded_off(centres) > WORLD * apart:
            unit = 10.0 ** np.floor(np.log10(apart))
            position = np.round(centres.mean(0) / unit) * unit
        frame_time_s = float(np.median(np.diff(times_s))) if len(times_s) > 1 else 0.0
        if frame_time_s > 0 and rounded_off(times_s) > MOST * frame_time_s:
            time_s = float(times_s[0])
        return cls(tuple(position.tolist()), time_s)

    @classmethod
    def from_numbers(cls, numbers: ArrayLike, source: object) -> Datum:
        """Build one from x, y, z (m) and t (s), as files hold it. Raises DataFormatError: not four finite numbers."""
        try:
            x, y, z, t = np.asarray(numbers, np.float64).reshape(4).tolist()
        except (TypeError, ValueError) as e:
            raise DataFormatError(f"{source}: 'datum' must be four numbers: x, y, z (m) and t (s)") from e
        if not np.isfinite([x, y, z, t]).all():
            raise DataFormatError(f"{source}: 'datum' holds NaN or Inf")
        return cls((x, y, z), t)

    def numbers(self) -> np.ndarray:
        """Return (4,) float64: x, y, z (m) and t (s)."""
        return np.array([*self.position, self.time_s])

    def __bool__(self) -> bool:
        """Return whether anything is moved."""
        return bool(self.numbers().any())


# ----------------------------------------------------------------
# The part that float32 rounds off. Results hold times and places as float32, which knows seven digits and no more.

MOST = 0.01  # of the least difference that matters


def rounded_off(values: np.ndarray) -> float:
    """Return the distance between neighbouring float32 numbers at the largest of some values, in their unit."""
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
