"""Fires that others have measured, read from your own copy of a public database, beside simulated ones.

MaCFP's database (github.com/MaCFP/macfp-db) holds mean and rms of the vertical velocity in a methanol pool of 0.305 m,
at twelve heights: the experiment of Weckman and Strong (1996) at Waterloo. No file of it is part of this project.
"""

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gof.core.errors import DataFormatError
from gof.core.fields import VelocitySequence

WATERLOO = Path("Liquid_Pool_Fires/Waterloo_Methanol/Experimental_Data")
PROFILES = "Mean_and_rms_values_z*cm.csv"  # a file per height
COLUMNS = ("z (cm)", "r (cm)", "u-bar (m/s)", "u-rms (m/s)")
ANGLES = 16  # around the axis, over which a simulated fire is averaged too
SAME_SIZE, SAME_HEAT = 0.1, 0.25  # relative: what counts as the same fire


@dataclass(frozen=True)
class MeasuredFire:
    """Mean and rms of the vertical velocity at N points of a fire that is round in the mean.

    Attributes:
        diameter_m, heat_kw: of the burner.   height_m, radius_m: (N,) above it, from its axis.
        mean_m_s, rms_m_s: (N,) over time.
    """

    name: str
    diameter_m: float
    heat_kw: float
    height_m: np.ndarray
    radius_m: np.ndarray
    mean_m_s: np.ndarray
    rms_m_s: np.ndarray

    def is_same(self, diameter_m: float, heat_kw: float) -> bool:
        """Return whether a burner is as wide, and its heat, where it is known, as large."""
        wide = abs(diameter_m / self.diameter_m - 1) <= SAME_SIZE
        return wide and (math.isnan(heat_kw) or abs(heat_kw / self.heat_kw - 1) <= SAME_HEAT)


@dataclass(frozen=True)
class SimulatedFlow:
    """A simulated fire's velocity, and the middle of its burner's mouth (3,) m."""

    velocity: VelocitySequence
    mouth_m: np.ndarray


@dataclass(frozen=True)
class Comparison:
    """A simulated fire beside a measured one, at the measured points that lie in its domain.

    Attributes:
        points, over_s: how many points, and seconds of the simulated fire.
        mean_ratio, rms_ratio: sum of the simulated values over that of the measured ones.
        mean_error, rms_error: root of the summed squared differences over that of the measured squares.
    """

    points: int
    over_s: float
    mean_ratio: float
    mean_error: float
    rms_ratio: float
    rms_error: float


def read_waterloo(copy: Path) -> MeasuredFire:
    """Read Waterloo's methanol pool.

    Args:
        copy: of the whole database, or its folder `Experimental_Data` of that fire.
    Raises:
        DataFormatError: no profile there, or a file of another form (names it and the column).
    """
    folder = copy / WATERLOO if (copy / WATERLOO).is_dir() else copy
    files = sorted(folder.glob(PROFILES))
    if not files:
        raise DataFormatError(
            f"{copy}: holds neither {WATERLOO} nor files {PROFILES}; give a copy of github.com/MaCFP/macfp-db"
        )
    height, radius, mean, rms = np.concatenate([_rows(file) for file in files]).T
    return MeasuredFire("Waterloo, methanol", 0.305, 21.3, height / 100, abs(radius) / 100, mean, rms)


def _rows(file: Path) -> np.ndarray:
    """(N, 4) numbers of COLUMNS."""
    try:
        with file.open(encoding="utf-8-sig", newline="") as text:
            table = csv.DictReader(text, skipinitialspace=True)
            lacks = [name for name in COLUMNS if name not in (table.fieldnames or ())]
            if lacks:
                raise DataFormatError(f"{file}: has no column '{lacks[0]}'; is it MaCFP's?")
            rows = np.array([[float(row[name]) for name in COLUMNS] for row in table])
    except (OSError, UnicodeDecodeError, ValueError, TypeError) as error:
        raise DataFormatError(f"{file}: cannot be read as a table of numbers ({error})") from error
    if not len(rows) or not np.isfinite(rows).all():
        raise DataFormatError(f"{file}: holds no rows, or one that is not finite")
    return rows


def compare(flow: SimulatedFlow, measured: MeasuredFire) -> Comparison:
    """Average a simulated fire over its clip and around its axis, and hold it beside a measured one.

    A fluctuation is from the mean around the ring, as the fire is round in the mean: so a short clip does not hide it.

    Raises:
        DataFormatError: a frame is damaged, or no measured point lies in the domain.
    """
    angle = 2 * np.pi * np.arange(ANGLES) / ANGLES
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros(ANGLES)], -1)
    offset = measured.radius_m[:, None, None] * ring + measured.height_m[:, None, None] * [0.0, 0.0, 1.0]
    points = (flow.mouth_m + offset).reshape(-1, 3)
    inside = flow.velocity.frame(0).contains(points).reshape(-1, ANGLES).all(1)
    if not inside.any():
        raise DataFormatError(f"{flow.velocity.path}: none of the points of '{measured.name}' lies in its domain")
    frames = [flow.velocity.frame(k).sample(points)[:, 2].reshape(-1, ANGLES) for k in range(len(flow.velocity))]
    rise = np.asarray(frames, float)[:, inside]
    mean, rms = rise.mean((0, 2)), rise.std((0, 2))
    times = flow.velocity.times_s
    return Comparison(
        int(inside.sum()),
        float(times[-1] - times[0]),
        *_ratio_and_error(mean, measured.mean_m_s[inside]),
        *_ratio_and_error(rms, measured.rms_m_s[inside]),
    )


def _ratio_and_error(simulated: np.ndarray, measured: np.ndarray) -> tuple[float, float]:
    return float(simulated.sum() / measured.sum()), float(
        np.linalg.norm(simulated - measured) / np.linalg.norm(measured)
    )
