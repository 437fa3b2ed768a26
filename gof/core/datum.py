"""The datum: where a world and a clock are measured from, in float64.

float32, which Gaussians are made of, knows seven digits. UTM coordinates and Unix seconds use them up before the first
millimetre and millisecond. So a dataset far from zero is opened measured from its datum, its results are too, and say
so in their files.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .errors import DataFormatError
from .precision import MOST, rounded_off

WORLD = 1e-5  # of the distance between cameras, that float32 may round a place by


@dataclass(frozen=True)
class Datum:
    """A point of the world and an instant of the clock. position: (3,) m.   time_s: s. Zeros: nothing was moved."""

    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    time_s: float = 0.0

    @classmethod
    def of(cls, centres: np.ndarray, times_s: np.ndarray) -> Datum:
        """Of cameras at `centres` (C, 3) m and frames at `times_s` (T,) s; zeros where float32 has digits to spare.

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
    def from_numbers(cls, numbers: np.ndarray, source: object) -> Datum:
        """Of x, y, z (m) and t (s), as files hold it. Raises DataFormatError: not four finite numbers."""
        try:
            x, y, z, t = np.asarray(numbers, np.float64).reshape(4).tolist()
        except (TypeError, ValueError) as e:
            raise DataFormatError(f"{source}: 'datum' must be four numbers: x, y, z (m) and t (s)") from e
        if not np.isfinite([x, y, z, t]).all():
            raise DataFormatError(f"{source}: 'datum' holds NaN or Inf")
        return cls((x, y, z), t)

    def numbers(self) -> np.ndarray:
        """(4,) float64: x, y, z (m) and t (s)."""
        return np.array([*self.position, self.time_s])

    def __bool__(self) -> bool:
        """Whether anything is moved."""
        return bool(self.numbers().any())
