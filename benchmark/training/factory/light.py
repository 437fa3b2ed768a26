"""How the baked gas shines: four laws, because light is not the same function of gas in every solver and fuel."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

Law = Literal["soot", "reaction", "sheets", "glow"]
LAWS: tuple[Law, ...] = get_args(Law)
AMBIENT_K, HOTTEST_K = 293.0, 2000.0
SHARPNESS_K = 12_000.0  # of the glow: exp(-SHARPNESS_K / T), between red light's 24 000 K and the heat's


def emission(law: Law, flame: np.ndarray, heat: np.ndarray) -> np.ndarray:
    """Return how brightly the gas shines, float32 >= 0 in a unit of the law's own, in the shape of the grids.

    - soot, sheets: the light of the spec's own soot, thick or in thin sheets, which its grid `flame` holds;
    - reaction: as much as it burns;
    - glow: as hot as it is, burnt or not, so that light is carried away with the gas and cools there.
    """
    if law != "glow":
        return np.maximum(flame, 0).astype(np.float32)
    kelvin = AMBIENT_K + (HOTTEST_K - AMBIENT_K) * heat.astype(np.float32) / max(float(heat.max()), 1e-6)
    return np.exp(SHARPNESS_K * (1 / HOTTEST_K - 1 / np.maximum(kelvin, AMBIENT_K))).astype(np.float32)
