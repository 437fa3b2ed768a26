"""How gas shines: four laws, because light is not the same function of gas in every solver, nor in every fuel."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np

from gof_benchmark.training.factory.solver import Gas

Law = Literal["reaction", "algebraic_soot", "carried_soot", "sheets"]
LAWS: tuple[Law, ...] = get_args(Law)
USUAL_K = 1500.0  # gas as hot has a glow of 1


def emission(gas: Gas, law: Law, sharpness_k: float = 12_000.0) -> np.ndarray:
    """Return how brightly the gas shines, (X, Y, Z) float32 >= 0 in a unit of the law's own.

    - reaction: as much as it burns;
    - algebraic_soot: glowing soot wherever hot gas is rich, more the richer it is;
    - carried_soot: glowing soot that rich gas has made, that is carried away, and burns off where it is lean;
    - sheets: a thin hot layer where fuel and air are in balance.

    Args:
        sharpness_k: how steeply the glow grows with heat: exp(sharpness (1/1500 K - 1/T)); 24 000 K for green light.
    """
    if law == "reaction":
        return gas.heat.copy()
    balance = gas.chemistry.stoichiometric
    hot = gas.temperature
    if law == "sheets":
        slope = np.linalg.norm(np.gradient(gas.mixture), axis=0)  # per cell
        off = (gas.mixture - balance) / (0.6 * slope + 0.02 * balance)
        return (np.exp(-(off**2)) * np.clip((hot - 700) / 500, 0, 1)).astype(np.float32)
    glow = np.exp(sharpness_k * (1 / USUAL_K - 1 / hot))
    soot = gas.soot if law == "carried_soot" else np.clip((gas.mixture - 0.7 * balance) / balance, 0, 2)
    return (soot * glow).astype(np.float32)
