"""Laws measured on real fires, all of free fires in still air: jets leave the first where their own momentum carries
them, wind leaves all of them.

- McCaffrey, *Purely Buoyant Diffusion Flames: Some Experimental Results*, NBSIR 79-1910, 1979: speed and temperature on
  the axis of a 0.3 m square natural-gas burner of 14 to 58 kW, in three zones of height.
- Heskestad, *Luminous heights of turbulent diffusion flames*, Fire Safety Journal 5, 1983: mean visible height.
- Cetegen and Ahmed, *Experiments on the periodic instability of buoyant plumes and pool fires*, Combustion and
  Flame 93, 1993: puffing frequency of pool fires of 0.03 to 60 m.
"""

from __future__ import annotations

import math

import numpy as np

# McCaffrey's zones: up to z / Q^(2/5) in m/kW^(2/5), k, and exponent eta of u / Q^(1/5) = k (z / Q^(2/5))^eta.
ZONES = ((0.08, 6.8, 0.5), (0.20, 1.9, 0.0), (math.inf, 1.1, -1 / 3))


def _zone(height_m: np.ndarray, heat_release_kw: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(scaled height, k, eta) at heights above the burner."""
    scaled = np.maximum(np.asarray(height_m, float), 1e-9) / heat_release_kw**0.4
    limits = [limit for limit, _, _ in ZONES]
    k, eta = np.array([zone[1:] for zone in ZONES])[np.searchsorted(limits, scaled)].T
    return scaled, k, eta


def mccaffrey_speed(height_m: np.ndarray, heat_release_kw: float) -> np.ndarray:
    """Mean vertical speed on the axis (m/s) at heights (m) above the burner: continuous flame, intermittent, plume."""
    scaled, k, eta = _zone(height_m, heat_release_kw)
    return heat_release_kw**0.2 * k * scaled**eta


def heskestad_height(heat_release_kw: float, diameter_m: float) -> float:
    """Mean height of the visible flame (m): 0.235 Q^(2/5) - 1.02 D, at least 0."""
    return max(0.0, 0.235 * heat_release_kw**0.4 - 1.02 * diameter_m)


def heskestad_heat(height_m: float, diameter_m: float) -> float:
    """Heat release (kW) of a fire whose visible flame has this mean height (m): Heskestad's law, solved for Q."""
    return ((height_m + 1.02 * diameter_m) / 0.235) ** 2.5


def puffing_law(diameter_m: float) -> float:
    """Frequency (Hz) at which a pool fire sheds its vortices: 1.5 / sqrt(D)."""
    return 1.5 / math.sqrt(diameter_m)
