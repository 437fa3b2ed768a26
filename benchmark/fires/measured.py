"""Fires that others have measured, read from your own copy of a public database, beside simulated ones.

MaCFP's database (github.com/MaCFP/macfp-db) holds vertical velocities above round pools, and no file of it is part of
this project. Three sets are read:

- Waterloo: mean and rms in a methanol pool of 0.305 m, at twelve heights, by laser (Weckman and Strong 1996);
- Sandia: mean, and of two fires turbulent kinetic energy, above a burner of 1 m, methane and hydrogen, at three heights
  (Tieszen and others 2004);
- NIST: mean on the axis with its uncertainty, eight pools of 0.3 and 0.37 m (Sung and others 2024).
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
SANDIA = Path("Gaseous_Pool_Fires/Sandia_Flames/Experimental_Data")
NIST = Path("Liquid_Pool_Fires/NIST_Pool_Fires/Experimental_Data")
PROFILES = "Mean_and_rms_values_z*cm.csv"  # Waterloo's, a file per height
COLUMNS = ("z (cm)", "r (cm)", "u-bar (m/s)", "u-rms (m/s)")
SANDIA_KW = {"CH4_1m_Test14": 1590.0, "CH4_1m_Test24": 2070.0, "CH4_1m_Test17": 2610.0, "H2_1m_Test35": 2120.0}
SANDIA_M = {"p3": 0.301, "p5": 0.502, "p9": 0.903}  # heights of the files' names
NIST_M = {"30": 0.301, "37": 0.37, "100": 1.0}  # inner diameters of the burners of so many cm
ANGLES = 16  # around the axis, over which a simulated fire is averaged too
SAME_SIZE, SAME_HEAT = 0.1, 0.25  # relative: what counts as the same fire


@dataclass(frozen=True)
class MeasuredFire:
    """Vertical velocity at N points of a fire that is round in the mean; NaN where a figure was not measured.

    Attributes:
        diameter_m, heat_kw: of the burner.   height_m, radius_m: (N,) above it, from its axis.
        mean_m_s, rms_m_s: (N,) over time.   uncertainty_m_s: (N,) of the mean, as its authors state it.
        all_components: the rms is that of a component if all three were alike, sqrt(2/3 of the kinetic energy).
    """

    name: str
    diameter_m: float
    heat_kw: float
    height_m: np.ndarray
    radius_m: np.ndarray
    mean_m_s: np.ndarray
    rms_m_s: np.ndarray
    uncertainty_m_s: np.ndarray
    all_components: bool = False

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
    """A simulated fire beside a measured one, at the measured points that lie in its domain; NaN: not measured.

    Attributes:
        points, over_s: how many points, and seconds of the simulated fire.
        mean_ratio, rms_ratio: sum of the simulated values over that of the measured ones.
        mean_error, rms_error: root of the summed squared differences over that of the measured squares.
        within: share of the points whose mean lies within the stated uncertainty.
    """

    points: int
    over_s: float
    mean_ratio: float
    mean_error: float
    rms_ratio: float
    rms_error: float
    within: float


def read_database(copy: Path) -> list[MeasuredFire]:
    """Read the fires of MaCFP's database that are in a copy of it, or of a part.

    Args:
        copy: of the whole database, or Waterloo's folder `Experimental_Data`.
    Raises:
        DataFormatError: none of them is there, or a file has another form (names it and the column).
    """
    waterloo = copy / WATERLOO if (copy / WATERLOO).is_dir() else copy
    fires = [_read_waterloo(files)] if (files := sorted(waterloo.glob(PROFILES))) else []
    for name, heat_kw in SANDIA_KW.items():
        if files := sorted((copy / SANDIA).glob(f"Sandia_{name}_p[359].csv")):
            fires.append(_read_sandia(name, heat_kw, files))
    fires += [_read_nist(file) for file in sorted((copy / NIST).glob("*_U_r=0_*.csv"))]
    if not fires:
        raise DataFormatError(
            f"{copy}: holds neither {WATERLOO} nor {SANDIA} nor {NIST}; give a copy of github.com/MaCFP/macfp-db"
        )
    return fires


def _read_waterloo(files: list[Path]) -> MeasuredFire:
    height, radius, mean, rms = np.concatenate([_rows(file, COLUMNS) for file in files]).T
    unknown = np.full(len(mean), np.nan)
    return MeasuredFire("Waterloo, methanol", 0.305, 21.3, height / 100, abs(radius) / 100, mean, rms, unknown)


def _read_sandia(name: str, heat_kw: float, files: list[Path]) -> MeasuredFire:
    tables = []
    for file in files:
        energy = ("TKE (m2/s2)",) if "TKE" in file.open(encoding="utf-8-sig").readline() else ()
        found = _rows(file, ("x (m)", "W mean (m/s)", *energy))
        if energy and found[:, 2].min() < 0:
            raise DataFormatError(f"{file}: has a negative kinetic energy; is it whole?")
        rms = np.sqrt(2 / 3 * found[:, 2]) if energy else np.full(len(found), np.nan)
        height_m = np.full(len(found), SANDIA_M[file.stem[-2:]])
        tables.append(np.stack([height_m, abs(found[:, 0]), found[:, 1], rms], -1))
    height_m, radius_m, mean, rms = np.concatenate(tables).T
    fuel, _, test = name.split("_")
    unknown = np.full(len(mean), np.nan)
    return MeasuredFire(f"Sandia, {fuel}, {test}", 1.0, heat_kw, height_m, radius_m, mean, rms, unknown, True)


def _read_nist(file: Path) -> MeasuredFire:
    """Read a file FUEL_[HEAT_kW_]DIAMETER_cm_U_r=0_...; the heat stands in a file of its own beside it."""
    *words, diameter_cm = file.name.split("_cm_U_")[0].split("_")
    words = [word for word in words if word != "kW"]
    fuel = ", ".join([words[0], *(f"{heat} kW" for heat in words[1:])])
    named = "_".join([words[0], diameter_cm, "cm", *(f"{heat}_kW" for heat in words[1:])])
    heats = sorted(file.parent.glob(f"{named}_HRR_*.csv"))
    heat_kw = _rows(heats[0], ("HRR",), units=True)[0, 0] if heats else math.nan
    height, radius, mean, uncertainty = _rows(file, ("z", "r", "U", "Uc_U"), units=True).T
    unknown = np.full(len(mean), np.nan)
    diameter_m = NIST_M.get(diameter_cm, float(diameter_cm) / 100)
    return MeasuredFire(f"NIST, {fuel}", diameter_m, heat_kw, height / 100, radius / 100, mean, unknown, uncertainty)


def _rows(file: Path, columns: tuple[str, ...], units: bool = False) -> np.ndarray:
    """Return (N, C) numbers of some columns. `units`: the line below the names holds them."""
    try:
        with file.open(encoding="utf-8-sig", newline="") as text:
            table = csv.DictReader(text, skipinitialspace=True)
            lacks = [name for name in columns if name not in (table.fieldnames or ())]
            if lacks:
                raise DataFormatError(f"{file}: has no column '{lacks[0]}'; is it MaCFP's?")
            rows = np.array([[float(row[name]) for name in columns] for row in list(table)[int(units) :]])
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
    out = np.stack([np.cos(angle), np.sin(angle), np.zeros(ANGLES)], -1)
    around = np.stack([-np.sin(angle), np.cos(angle), np.zeros(ANGLES)], -1)
    axes = np.stack([out, around, np.broadcast_to([0.0, 0.0, 1.0], out.shape)], -1)  # (angle, xyz, component)
    offset = measured.radius_m[:, None, None] * out + measured.height_m[:, None, None] * [0.0, 0.0, 1.0]
    points = (flow.mouth_m + offset).reshape(-1, 3)
    inside = flow.velocity.frame(0).contains(points).reshape(-1, ANGLES).all(1)
    if not inside.any():
        raise DataFormatError(f"{flow.velocity.path}: none of the points of '{measured.name}' lies in its domain")
    frames = [flow.velocity.frame(k).sample(points).reshape(-1, ANGLES, 3)[inside] for k in range(len(flow.velocity))]
    velocity = np.einsum("kpaj,ajc->kpac", np.asarray(frames, float), axes)
    mean, rms = velocity.mean((0, 2))[:, 2], velocity.std((0, 2))
    rms = np.sqrt((rms**2).mean(-1)) if measured.all_components else rms[:, 2]
    times = flow.velocity.times_s
    off, allowed = abs(mean - measured.mean_m_s[inside]), measured.uncertainty_m_s[inside]
    return Comparison(
        int(inside.sum()),
        float(times[-1] - times[0]),
        *_ratio_and_error(mean, measured.mean_m_s[inside]),
        *_ratio_and_error(rms, measured.rms_m_s[inside]),
        float((off <= allowed).mean()) if np.isfinite(allowed).all() else math.nan,
    )


def _ratio_and_error(simulated: np.ndarray, measured: np.ndarray) -> tuple[float, float]:
    """Return both figures over the points that were measured; NaN where none was."""
    known = np.isfinite(measured)
    if not known.any():
        return math.nan, math.nan
    simulated, measured = simulated[known], measured[known]
    ratio = float(simulated.sum() / measured.sum())
    return ratio, float(np.linalg.norm(simulated - measured) / np.linalg.norm(measured))
