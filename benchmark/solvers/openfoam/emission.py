"""The light of a solved flame: glowing soot, as three wavelengths see it.

A diffusion flame's yellow light is thermal radiation of soot. Soot forms where there is more fuel than its oxygen can
burn and burns out on the lean side, so its amount is taken as a smooth step of the mixture fraction about the
stoichiometric one. Its particles are far smaller than light's waves, hence absorb as 6 pi E(m) f_v / wavelength
(Rayleigh; E(m) = 0.26, Modest, *Radiative Heat Transfer*, ch. 12) and emit that share of Planck's radiance
(Kirchhoff). The volume fraction f_v of soot is taken as one part in a million where it is richest: the one factor
that is not known.

What "T" means there is the question. A large-eddy simulation's temperature is a mean over cells of a centimetre, in
which the hot sheet, a millimetre thick, is mixed with cold gas. Two laws:

`planck`      the mean temperature itself. Exact for a resolved flame; here it lights the few hottest cells only.
`polynomial`  the hot sheet's share of the cell, as the square of (T - 900 K) / 900 K, times the radiance of soot at
              1800 K, in the colour of T. The square is a choice that no measurement fixes.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from gof_benchmark.solvers.openfoam.chemistry import Fuel

WAVELENGTH_M = np.array([610e-9, 550e-9, 465e-9])  # R, G, B
C1, C2 = 1.191042972e-16, 1.438776877e-2  # W m2/sr, m K (CODATA 2018)
SOOT_PPM, SOOT_ABSORPTION = 1.0, 0.26
DARK_K, SHEET_K = 900.0, 1800.0

LAWS = {
    "polynomial": "soot share x ((T - 900 K) / 900 K)^2 x Planck(1800 K) in the colour of T, 610, 550, 465 nm; 1 ppm",
    "planck": "soot share x Planck(T) at 610, 550, 465 nm; 1 ppm",
}


def planck(temperature_k: np.ndarray) -> np.ndarray:
    """(...) K to (..., 3) W m^-2 sr^-1 nm^-1 at the three wavelengths; below 300 K as at 300 K (nothing)."""
    t = np.maximum(temperature_k, 300.0)[..., None]
    return 1e-9 * C1 / WAVELENGTH_M**5 / np.expm1(C2 / (WAVELENGTH_M * t))


def soot_share(mixture_fraction: np.ndarray, fuel: Fuel) -> np.ndarray:
    """0 (leaner than half of stoichiometric) to 1 (richer than one and a half times)."""
    s = np.clip(mixture_fraction / fuel.stoichiometric_mixture_fraction - 0.5, 0, 1)
    return s * s * (3 - 2 * s)


def luminous_emission(
    temperature_k: np.ndarray,
    mixture_fraction: np.ndarray,
    fuel: Fuel,
    law: Literal["polynomial", "planck"] = "polynomial",
) -> np.ndarray:
    """Radiance per metre of path.

    Args:
        temperature_k, mixture_fraction: (...) of the gas.
    Returns:
        (..., 3) W m^-3 sr^-1 nm^-1, at least 0; grows with temperature, 0 where there is no fuel.
    """
    absorption = 6 * np.pi * SOOT_ABSORPTION * SOOT_PPM * 1e-6 / WAVELENGTH_M  # 1/m
    radiance = planck(temperature_k)
    if law == "polynomial":
        share = (np.maximum(temperature_k - DARK_K, 0) / (SHEET_K - DARK_K)) ** 2
        colour = radiance / np.maximum(radiance[..., :1], 1e-300)
        radiance = share[..., None] * colour * planck(np.array(SHEET_K))[0]
    return soot_share(mixture_fraction, fuel)[..., None] * absorption * radiance
