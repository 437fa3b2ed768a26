"""Light of a flame, from its soot: hot particles that glow as black bodies and absorb as much as they emit.

By Kirchhoff's law a metre of gas with the absorption coefficient k emits k B(T), B being Planck's radiance. A thin
flame then shines in proportion to its soot, and one that cannot be seen through shines as a black body, however large
it is: a candle, a campfire and a pool of burning gasoline differ by a few times, not by their sizes.

Where in the flame the soot is, and how hot, follows from the solver's reaction grid ``flame`` (1: fresh fuel, 0: burnt
or air). Fuel has to break up before there is soot, so there is none right above the burner and less in the core; it is
coolest at the tips and edges, where it has radiated longest. Before there is soot, burning fuel is blue.

Real soot glows in thin sheets, the edges of the fuel, which the wind of the flame folds: with `thin` it is where the
reaction passes SHEET_AT, in a band that is often narrower than a cell. Without, all that burns glows, which looks
like cotton. Between cells the reaction is interpolated as in Cycles, by a cubic B-spline, so that the same truth has
finer pictures.

Sources of the figures:

- Absorption. Total (infrared) coefficients of flames, 1/m: LPG 1.4, gasoline 2.1 (V. Babrauskas, Estimating large pool
  fire burning rates, Fire Technology 19, 1983, doi 10.1007/BF02380810), wood cribs 0.8 (Drysdale, An Introduction to
  Fire Dynamics). The tables of these two were not at hand: the figures are quoted from memory.
- Soot absorbs as 1 / wavelength. The mean of that over Planck's radiation of T is 3.83 T / C2, with
  3.83 = Gamma(5) zeta(5) / (Gamma(4) zeta(4)), so that at 1500 K and 0.6 um soot absorbs C2 / (3.83 T wavelength) =
  4.2 times as much as on the mean. Only this ratio is used, and no volume fraction of the soot. (Between
  Planck's mean and Rosseland's, 3.60, lies the usual 3.72 of Modest, Radiative Heat Transfer.)
- A small laminar flame holds its soot in a thin sheet of several ppm (Santoro et al., Combustion and Flame 51, 1983),
  which a mean over a large turbulent flame is not: its optical thickness is taken as at least `LEAST_THICKNESS`. In
  large ones soot lies in folds, between which one sees deeper than through the mean: at most `MOST_THICKNESS`. Both are
  our choice.
- Thin sheets: their place, width, density, coolest soot and exposure are among the nearest of eleven, by colours and
  texture on seven fires, to eight filmed ones (`gof_benchmark.evidence.flame_looks`; notebook/how_real.md). One sees
  through a single sheet, which is orange; where folds lie behind each other it is nearly white.
- Soot of 1400 to 1950 K, and its distribution over ``flame``: chosen by eye and by the colours of the paper's filmed
  fires (`gof_benchmark.evidence.flame_looks`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .fuels import Fuel

WAVELENGTHS_UM = (0.60, 0.54, 0.46)
"""Wavelengths of a camera's red, green and blue: Planck's law is taken at these."""
C2_UM_K = 14388.0
WHITE_K = 7000.0
"""A black body of this temperature is white to the camera: daylight under a blue sky."""
VISIBLE_OVER_TOTAL = 4.2
LEAST_THICKNESS, MOST_THICKNESS = 0.5, 5.0
"""Optical thickness of a burner's width of full soot, at least and at most."""
REFERENCE_K = 1900.0
REFERENCE_RADIANCE = 14.0
"""Linear scene radiance of red of a black body of REFERENCE_K: Filmic shows it nearly white. In truth a flame is
thousands of times brighter than a room, which no picture shows."""
SHEET_AT, SHEET_WITHIN = 0.32, (0.22, 0.44)
"""Thin sheets: the reaction where most soot is, and between which values there is any. It cools from the inner side of
the sheet, where the fuel is, to the outer."""
SHEET_EXPOSURE = 7.0
"""How much longer a flame of thin sheets is exposed: there is less soot in it."""
SHEET_COOLEST = 0.6
"""Temperature of a sheet's outer side over that of its inner."""
COOLEST = 0.72
"""Temperature of the last soot, at the tips and edges, over that of the hottest: it cools by its own radiation."""
BLUE = (0.10, 0.32, 1.0)
"""Colour of burning fuel before there is soot: bands of CH at 431 nm and C2 at 516 nm."""
_U = 0.75  # of a cell from the neighbour below the one a quarter below
QUARTER = np.array([(1 - _U) ** 3, 3 * _U**3 - 6 * _U**2 + 4, -3 * _U**3 + 3 * _U**2 + 3 * _U + 1, _U**3, 0.0]) / 6
"""Weights of the five cells around, for the cubic B-spline a quarter of a cell below a cell's centre."""
STOPS = 32  # of the tables: as many as a colour ramp in Blender holds


def black_body(kelvin: np.ndarray) -> np.ndarray:
    """Return (..., 3) linear scene radiance of black bodies of (...) > 0 K; Wien's law, 0.1 % from Planck's below 2600
    K."""
    rate = C2_UM_K / np.array(WAVELENGTHS_UM)
    white = np.exp(rate * (1 / WHITE_K - 1 / REFERENCE_K))  # of REFERENCE_K, where daylight is (1, 1, 1)
    return REFERENCE_RADIANCE * white / white[0] * np.exp(rate * (1 / REFERENCE_K - 1 / np.asarray(kelvin)[..., None]))


@dataclass(frozen=True)
class Sheet:
    """The table that a flame's material looks up by the value of ``flame``, at STOPS even values from 0 to 1.

    Attributes:
        emission: (STOPS, 3) linear scene radiance per metre where there is soot.
        absorption: (STOPS,) 1/m where there is soot.
        blue: (STOPS, 3) linear scene radiance per metre where there is none yet.
        onset_m: height above the burner over which soot appears, m; 0 where blue is all there is.
    """

    emission: np.ndarray
    absorption: np.ndarray
    blue: np.ndarray
    onset_m: float

    def light(self, flame: np.ndarray, height_m: np.ndarray) -> np.ndarray:
        """Return mean over the colours of what a metre emits.

        Args:
            flame: of the solver.   height_m: above the burner; broadcasts with flame.
        """
        stops, sooty = np.linspace(0, 1, STOPS), soot_share(height_m, self.onset_m)
        of_soot, of_blue = (np.interp(flame, stops, table.mean(-1)) for table in (self.emission, self.blue))
        return sooty * of_soot + (1 - sooty) * of_blue


def sheet(fuel: Fuel, diameter_m: float, intensity: float = 1.0, thin: bool = False) -> Sheet:
    """Return the tables of a fuel on a burner of this width, > 0.

    Args:
        intensity: factor on all light.
        thin: whether soot lies in thin sheets, or in all that burns.
    """
    flame = np.linspace(0, 1, STOPS)
    if thin:
        low, high = SHEET_WITHIN
        share = smoothstep(flame, low, SHEET_AT) * (1 - smoothstep(flame, SHEET_AT, high))
    else:
        share = smoothstep(flame, 0.05, 0.45) * (1 - 0.7 * smoothstep(flame, 0.55, 0.95))
    coolest, warms, exposure = (SHEET_COOLEST, SHEET_WITHIN, SHEET_EXPOSURE) if thin else (COOLEST, (0.0, 0.65), 1.0)
    cold = coolest + (1 - coolest) * smoothstep(flame, *warms) - 0.05 * smoothstep(flame, 0.8, 1.0)
    thickness = np.clip(VISIBLE_OVER_TOTAL * fuel.absorption_per_m * diameter_m, LEAST_THICKNESS, MOST_THICKNESS)
    absorption = share * fuel.sooty * float(thickness) / diameter_m
    by_colour = WAVELENGTHS_UM[0] / np.array(WAVELENGTHS_UM)  # soot absorbs as 1 / wavelength
    emission = exposure * absorption[:, None] * by_colour * black_body(fuel.soot_k * cold)
    thin = smoothstep(flame, 0.02, 0.25) * (1 - smoothstep(flame, 0.35, 0.8))
    blue = thin[:, None] * np.array(BLUE) * fuel.blue / diameter_m
    return Sheet(intensity * emission, absorption, intensity * blue, fuel.onset * diameter_m)


def within_cells(flame: np.ndarray) -> np.ndarray:
    """Return (8, X, Y, Z) of a grid (X, Y, Z): its cubic B-spline at eight places in each cell, a quarter of a cell
    from the middle along each axis. Beyond the grid it is as at its sides."""
    found = np.asarray(flame, float)[None]
    for axis in (1, 2, 3):
        padded = np.concatenate([found.take([0, 0], axis), found, found.take([-1, -1], axis)], axis)
        parts = [
            sum(weight * _part(padded, axis, start) for start, weight in enumerate(weights))
            for weights in (QUARTER, QUARTER[::-1])
        ]
        found = np.concatenate(parts)
    return found


def _part(padded: np.ndarray, axis: int, start: int) -> np.ndarray:
    """Return, of a grid with two more cells at both ends of an axis, the cells from `start` on, as many as it had."""
    return padded.take(range(start, start + padded.shape[axis] - 4), axis)


def soot_share(height_m: np.ndarray, onset_m: float) -> np.ndarray:
    """Return the share of its soot that the gas has at a height above the burner, 0 to 1."""
    return smoothstep(height_m, 0.0, onset_m) if onset_m > 0 else np.zeros_like(height_m, dtype=float)


def smoothstep(value: np.ndarray, low: float, high: float) -> np.ndarray:
    """0 below low, 1 above high > low, and smooth between."""
    part = np.clip((np.asarray(value, float) - low) / (high - low), 0, 1)
    return part * part * (3 - 2 * part)
