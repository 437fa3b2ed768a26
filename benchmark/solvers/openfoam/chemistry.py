"""Fuels, and the gases of their complete combustion in air, with the sources of every figure.

Heat capacities and enthalpies of formation: NASA polynomials of GRI-Mech 3.0 (Smith et al., 1999), dimensionless (by
the gas constant). Viscosity: Sutherland's law of air for all gases. Absorption: the Planck-mean coefficients fitted
to RADCAL (Grosshandler, NIST TN 1402, 1993) by Barlow et al., 1/(m atm), as the turbulent non-premixed flame workshop
uses them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

GAS_CONSTANT = 8.314462618  # J/(mol K)
OXYGEN_IN_AIR = 0.2330  # mass fraction; the rest is nitrogen
AMBIENT_K = 293.15
AMBIENT_PA = 101325.0
MOLAR_MASS = {"O2": 31.9988, "N2": 28.0134, "H2O": 18.0153, "CO2": 44.0095, "CH4": 16.0425, "C3H8": 44.0956}  # g/mol

FuelName = Literal["methane", "propane"]


@dataclass(frozen=True)
class Hydrocarbon:
    """A hydrocarbon C_n H_m that burns in one step: C_n H_m + (n + m/4) O2 -> n CO2 + m/2 H2O."""

    species: str
    carbon: int
    hydrogen: int

    @property
    def oxygen(self) -> float:
        """Mol O2 per mol of fuel."""
        return self.carbon + self.hydrogen / 4

    @property
    def heat_of_combustion(self) -> float:
        """Lower heating value at 298.15 K, J/kg, from the enthalpies of formation below."""
        products = self.carbon * enthalpy("CO2") + self.hydrogen / 2 * enthalpy("H2O")
        return (enthalpy(self.species) + self.oxygen * enthalpy("O2") - products) / (MOLAR_MASS[self.species] * 1e-3)

    @property
    def stoichiometric_mixture_fraction(self) -> float:
        """Mass of fuel in a stoichiometric mixture with air."""
        air = self.oxygen * MOLAR_MASS["O2"] / MOLAR_MASS[self.species] / OXYGEN_IN_AIR
        return 1 / (1 + air)

    @property
    def density(self) -> float:
        """Return the density of the cold gas, kg/m3."""
        return AMBIENT_PA * MOLAR_MASS[self.species] * 1e-3 / (GAS_CONSTANT * AMBIENT_K)

    def mixture_fraction(self, fuel, carbon_dioxide):
        """Return mass that came from the burner, 0..1, from mass fractions: carbon is in the fuel and its CO2 only."""
        return fuel + carbon_dioxide * MOLAR_MASS[self.species] / (self.carbon * MOLAR_MASS["CO2"])


FUELS: dict[str, Hydrocarbon] = {"methane": Hydrocarbon("CH4", 1, 4), "propane": Hydrocarbon("C3H8", 3, 8)}

# Species: (above 1000 K, below 1000 K), seven NASA coefficients each.
NASA = {
    "O2": (
        (3.28253784, 1.48308754e-03, -7.57966669e-07, 2.09470555e-10, -2.16717794e-14, -1088.45772, 5.45323129),
        (3.78245636, -2.99673416e-03, 9.84730201e-06, -9.68129509e-09, 3.24372837e-12, -1063.94356, 3.65767573),
    ),
    "N2": (
        (2.92664, 1.4879768e-03, -5.684760e-07, 1.0097038e-10, -6.753351e-15, -922.7977, 5.980528),
        (3.298677, 1.4082404e-03, -3.963222e-06, 5.641515e-09, -2.444854e-12, -1020.8999, 3.950372),
    ),
    "H2O": (
        (3.03399249, 2.17691804e-03, -1.64072518e-07, -9.70419870e-11, 1.68200992e-14, -30004.2971, 4.96677010),
        (4.19864056, -2.03643410e-03, 6.52040211e-06, -5.48797062e-09, 1.77197817e-12, -30293.7267, -0.849032208),
    ),
    "CO2": (
        (3.85746029, 4.41437026e-03, -2.21481404e-06, 5.23490188e-10, -4.72084164e-14, -48759.1660, 2.27163806),
        (2.35677352, 8.98459677e-03, -7.12356269e-06, 2.45919022e-09, -1.43699548e-13, -48371.9697, 9.90105222),
    ),
    "CH4": (
        (0.0748514950, 1.33909467e-02, -5.73285809e-06, 1.22292535e-09, -1.01815230e-13, -9468.34459, 18.4373180),
        (5.14987613, -1.36709788e-02, 4.91800599e-05, -4.84743026e-08, 1.66693956e-11, -10246.6476, -4.64130376),
    ),
    "C3H8": (
        (7.5341368, 1.8872239e-02, -6.2718491e-06, 9.1475649e-10, -4.7838069e-14, -16467.516, -17.892349),
        (0.93355381, 2.6424579e-02, 6.1059727e-06, -2.1977499e-08, 9.5149253e-12, -13958.520, 19.201691),
    ),
}

ABSORPTION: dict[str, dict[str, Any]] = {  # polynomials in 1/T (inverse) or T, K
    "H2O": {"inverse": True, "c": (-0.23093, -1.12390e3, 9.41530e6, -2.99880e9, 0.51382e12, -1.86840e10)},
    "CO2": {"inverse": True, "c": (18.741, -121.310e3, 273.500e6, -194.050e9, 56.310e12, -5.8169e15)},
    "CH4": {"inverse": False, "c": (6.6334, -0.0035686, 1.6682e-08, 2.5611e-10, -2.6558e-14, 0.0)},
}


def enthalpy(species: str, temperature_k: float = 298.15) -> float:
    """J/mol, heat of formation included."""
    a = NASA[species][0 if temperature_k > 1000 else 1]
    t = temperature_k
    return GAS_CONSTANT * (sum(a[i] * t ** (i + 1) / (i + 1) for i in range(5)) + a[5])


def species_of(fuel: Hydrocarbon) -> list[str]:
    """Return every gas of the mixture; nitrogen, which OpenFOAM takes as what remains, last."""
    return ["O2", "H2O", fuel.species, "CO2", "N2"]


def reactions(fuel: Hydrocarbon) -> dict[str, Any]:
    """OpenFOAM's reactions file: the one step, nitrogen carried along in the proportion of air."""
    nitrogen = fuel.oxygen * MOLAR_MASS["O2"] / OXYGEN_IN_AIR * (1 - OXYGEN_IN_AIR) / MOLAR_MASS["N2"]
    left = f"{fuel.species} + {fuel.oxygen:g}O2 + {nitrogen:.6g}N2"
    right = f"{fuel.carbon:g}CO2 + {fuel.hydrogen / 2:g}H2O + {nitrogen:.6g}N2"
    reaction = {"type": "irreversibleinfiniteReaction", "reaction": f'"{left} = {right}"'}
    return {"species": species_of(fuel), "reactions": {"combustion": reaction}}


def thermodynamics(fuel: Hydrocarbon) -> dict[str, Any]:
    """OpenFOAM's file of the gases' properties."""
    gases = {}
    for name in species_of(fuel):
        high, low = NASA[name]
        gases[name] = {
            "specie": {"molWeight": MOLAR_MASS[name]},
            "thermodynamics": {
                "Tlow": 200,
                "Thigh": 5000,
                "Tcommon": 1000,
                "highCpCoeffs": high,
                "lowCpCoeffs": low,
            },
            "transport": {"As": 1.458e-06, "Ts": 110.4},
        }
    return gases


def absorption(fuel: Hydrocarbon) -> dict[str, Any]:
    """OpenFOAM's coefficients of the gases that radiate; nitrogen and oxygen do not."""
    found = {}
    for name, fit in ABSORPTION.items():
        if name in species_of(fuel):
            found[name] = {
                "Tcommon": 200,
                "Tlow": 200,
                "Thigh": 2500,
                "invTemp": "true" if fit["inverse"] else "false",
                "loTcoeffs": (0,) * 6,
                "hiTcoeffs": fit["c"],
            }
    return found
