"""Scaling of the solver's constants with the size of a fire, so that its gas is as fast as in real fires.

Mantaflow counts lengths in domains: with the same constants, hot gas is lifted with an acceleration that is the inverse
of the domain's longest side, 24 / L m/s2 for beta 1.5 and heat 3 (`gof_benchmark.evidence.fire_sizes`): a fire of a
candle's size rises at 5 m/s. In reality it is gravity times the gas' excess temperature over that of the air, at every
size.

Its time has to follow, too: fuel that needs as long to burn over a candle as over a pool leaves the picture before it
has burnt. Fuel given per area of the burner makes a flame whose height goes as D^0.8 (Heskestad 1983: as Q^0.4, and Q
as D^2), and it is passed at a speed that goes as the root of the height (McCaffrey 1979), so in a time of D^0.4.

A burner of REFERENCE_D_M in a domain of REFERENCE_L_M is where all this is 1: the fires that the fuels were chosen on.
"""

from __future__ import annotations

from dataclasses import dataclass

from .fuels import Fuel

REFERENCE_D_M, REFERENCE_L_M = 0.26, 1.6
LIFT = 1.2
"""Factor on the lift that brings the speed on the axis near McCaffrey's law."""
MOST_RATE = 4.0  # Blender takes no higher burning rate
HOT_M2_S, LAMINAR_RE = 2e-4, 500.0
"""Viscosity of burning gas, and the Reynolds number of the burner around which flames become turbulent."""


@dataclass(frozen=True)
class Constants:
    """The constants of the solver.

    Attributes:
        gravity: factor on gravity, hence on the lift.
        burning_rate, amount: Mantaflow's, as in `Fuel`.
        confinement: factor on the strength of the effect `vorticity`.
        drift: factor on the speed at which the fuel's unevenness changes.
    """

    gravity: float
    burning_rate: float
    amount: float
    confinement: float = 1.0
    drift: float = 1.0


def unscaled(fuel: Fuel) -> Constants:
    """Return the same at every size."""
    return Constants(1.0, fuel.burning_rate, fuel.amount)


def scaled(fuel: Fuel, diameter_m: float, longest_m: float) -> Constants:
    """Return those of a burner of a width in a domain of a longest side, both > 0."""
    rate = fuel.burning_rate * (REFERENCE_D_M / diameter_m) ** 0.4
    speed = 6.8 * diameter_m**0.5  # McCaffrey's, at the height of a diameter
    reynolds = speed * diameter_m / HOT_M2_S
    per_second = (REFERENCE_D_M / diameter_m) ** 0.5  # vortices turn as fast as the gas passes a diameter
    return Constants(
        LIFT * longest_m / REFERENCE_L_M,
        min(rate, MOST_RATE),
        fuel.amount * min(1.0, MOST_RATE / rate),  # less fuel is burnt sooner, too
        per_second * reynolds / (reynolds + LAMINAR_RE),
        per_second,
    )


def wind_push(wind_m_s: float, diameter_m: float) -> float:
    """Sideways acceleration (m/s2) with which burning gas has taken on the wind's speed when it leaves the flame.

    A flame of 2.5 widths, which gas that is lifted evenly to McCaffrey's speed passes in twice its height over that.
    """
    height = 2.5 * diameter_m
    return wind_m_s * 6.8 * height**0.5 / (2 * height)
