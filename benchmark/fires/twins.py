"""Is a test fire one that the method was chosen on, with the numbers moved a little?

Two fires are near twins when one solver burns the same fuel in the same shape of burner, and radius, jet speed, wind,
eddies and frame rate all lie within a quarter of each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields

import numpy as np

from gof_benchmark.fires import BenchmarkFire
from gof_blender.pure.effects import name_of
from gof_blender.pure.spec import SceneSpec

ALIKE = 0.25  # of the larger of two numbers


@dataclass(frozen=True)
class Traits:
    """Traits that make a fire another fire than the next.

    Args:
        shape: of its burners, "square + round" where there are two.
        radius: m, of the largest burner (of a square one the circle of equal area).
        jet: m/s at which the fuel leaves the burner.
        wind: strength of Blender's wind field, or m/s of OpenFOAM's wind: only compared within one solver.
        eddies, flame_eddies: what vorticity confinement adds to the gas, and to the flame.
        fps: frames per second.
    """

    solver: str
    fuel: str
    shape: str
    radius: float
    jet: float
    wind: float
    eddies: float
    flame_eddies: float
    fps: float


@dataclass(frozen=True)
class Neighbour:
    """The fire most like another one, and in what they differ: nothing, and they are near twins."""

    name: str
    differs_in: tuple[str, ...]


def traits(fire: BenchmarkFire) -> Traits:
    """Return those of a fire of the benchmark; of OpenFOAM's from the solver's input."""
    if fire.foam is None:
        return simulated(fire.spec)
    burners = fire.foam.burners
    largest = max(burners, key=lambda burner: burner.area_m2)
    return Traits(
        solver="OpenFOAM",
        fuel=fire.foam.fuel,
        shape=" + ".join(burner.shape for burner in burners),
        radius=largest.diameter_m / 2,
        jet=largest.speed(fire.foam.gas),
        wind=float(np.hypot(*fire.foam.wind_m_s)),
        eddies=0.0,
        flame_eddies=0.0,
        fps=fire.spec.clip.fps,
    )


def simulated(spec: SceneSpec) -> Traits:
    """Return those of a scene whose fire we simulate, built-in scenes too."""
    effects = {name_of(effect): effect for effect in spec.effects}
    wind, vorticity = effects.get("wind"), effects.get("vorticity")
    return Traits(
        solver="Mantaflow",
        fuel=spec.fire.fuel,
        shape=spec.fire.shape,
        radius=spec.fire.radius,
        jet=spec.fire.jet_speed,
        wind=wind.strength if wind else 0.0,
        eddies=vorticity.gas if vorticity else 0.0,
        flame_eddies=vorticity.flame if vorticity else 0.0,
        fps=spec.clip.fps,
    )


def nearest(fire: Traits, others: dict[str, Traits]) -> Neighbour:
    """Return the one that differs in fewest traits; of several the one whose numbers are closest."""

    def order(name: str) -> tuple[int, float]:
        gaps = _gaps(fire, others[name])
        return sum(gap > ALIKE for gap in gaps), sum(gaps)

    name = min(others, key=order)
    return Neighbour(name, differences(fire, others[name]))


def differences(one: Traits, other: Traits) -> tuple[str, ...]:
    """In words; none for near twins."""
    rows = zip(fields(one), astuple(one), astuple(other), _gaps(one, other), strict=True)
    return tuple(f"{field.name.replace('_', ' ')} {_say(a)}, {_say(b)}" for field, a, b, gap in rows if gap > ALIKE)


def _gaps(one: Traits, other: Traits) -> list[float]:
    """Per trait: 0 the same to 1 something else."""
    return [_gap(a, b) for a, b in zip(astuple(one), astuple(other), strict=True)]


def _gap(a: str | float, b: str | float) -> float:
    if isinstance(a, str):
        return float(a != b)
    return abs(a - b) / max(abs(a), abs(b)) if a != b else 0.0


def _say(value: str | float) -> str:
    return value if isinstance(value, str) else f"{value:.3g}"


def twins_table(fires: dict[str, Traits], others: dict[str, Traits]) -> str:
    """Markdown: each fire, the one of the others that is most like it, and in what it differs (its own value first)."""
    lines = ["| fire | most like | differs in (its own, the other's) |", "|---|---|---|"]
    for name, neighbour in ((name, nearest(fire, others)) for name, fire in fires.items()):
        lines.append(f"| {name} | {neighbour.name} | {'; '.join(neighbour.differs_in) or '**NEAR TWINS**'} |")
    return "\n".join(lines)


def traits_by_name(fires: Sequence[BenchmarkFire]) -> dict[str, Traits]:
    return {fire.name: traits(fire) for fire in fires}
