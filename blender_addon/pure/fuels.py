"""Fuels: how each burns and what its flame looks like."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Fuel:
    """Burning of a fuel, and the look of its flame."""

    burning_rate: float
    """Speed of the reaction: higher is a shorter flame (Mantaflow's burning rate)."""
    buoyancy: float
    """Lift per unit of heat (Mantaflow's beta): higher is a faster flame."""
    max_temperature: float
    """Heat at the hottest place of the reaction (Mantaflow's flame temperature)."""
    amount: float
    """Fuel released by the emitter, per cell."""
    colour_low_k: float
    """Black-body temperature of the coolest visible flame, kelvin."""
    colour_high_k: float
    """Black-body temperature of the hottest flame, kelvin."""
    radiance: float
    """Emission per metre of full flame, linear scene units."""
    soot: float
    """Soot of the fuel relative to wood: scales the effect ``smoke``, and does nothing without it."""
    tint: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Factor on the black-body colour: flames without glowing soot are blue."""
    absorption_per_m: float = 1.4
    """Absorption coefficient of a large flame for its own heat radiation, 1/m (`pure.soot`)."""
    soot_k: float = 1900.0
    """Temperature of the hottest soot, kelvin."""
    onset: float = 0.3
    """Height above the burner over which soot appears, in widths of the burner; 0: there is none, the flame is blue."""
    blue: float = 0.2
    """Radiance of burning fuel before there is soot, seen through a burner's width of it."""

    @property
    def sooty(self) -> bool:
        """Return whether the flame glows by its soot."""
        return self.onset > 0


FUELS = {
    "propane_high": Fuel(0.75, 1.5, 3.0, 1.0, 1200.0, 2250.0, 15.0, 0.2, soot_k=1950.0, blue=0.3),
    "propane_low": Fuel(1.1, 1.0, 2.5, 0.8, 1200.0, 2200.0, 14.0, 0.15, soot_k=1950.0, blue=0.3),
    "wood": Fuel(
        0.6, 1.0, 2.2, 0.9, 1150.0, 2000.0, 12.0, 1.0, absorption_per_m=0.8, soot_k=1850.0, onset=0.1, blue=0.05
    ),
    "gasoline": Fuel(
        0.85, 1.4, 2.8, 1.0, 1100.0, 1950.0, 14.0, 3.0, absorption_per_m=2.1, soot_k=1850.0, onset=0.06, blue=0.0
    ),
    "ethanol": Fuel(
        1.0, 1.2, 2.4, 0.8, 1500.0, 2400.0, 1.6, 0.02, (0.16, 0.34, 1.0), absorption_per_m=0.0, onset=0.0, blue=0.5
    ),
    "paper": Fuel(
        0.9, 0.9, 2.0, 0.9, 1200.0, 2050.0, 12.0, 0.6, absorption_per_m=0.8, soot_k=1850.0, onset=0.1, blue=0.05
    ),
}
"""Presets. Turbulence comes from the effect ``vorticity``, smoke in the picture from ``smoke``."""
