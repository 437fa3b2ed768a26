"""What burns, how it shines and who looks: all of a fire from its number."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil

import numpy as np

from gof_benchmark.training.factory.light import LAWS, Law
from gof_blender.pure.effects import vorticity, wind
from gof_blender.pure.fires import Domain, Fire
from gof_blender.pure.spec import SceneSpec
from gof_blender.pure.timing import Clip

KINDS = ("pool", "jet", "ball", "wind", "logs")
FUELS = ("propane_high", "propane_low", "wood", "gasoline", "paper")
FRAMES = 13
LEAST_HZ, MOST_HZ = 25.0, 400.0
LONGEST_STEP = 0.05  # of the flame's length that the gas may go in a step of the solver
WARM_UP = 2.4  # lengths of the flame that the gas goes before the clip begins
ROOM = {"pool": (0.5, 0.5), "jet": (0.42, 0.42), "ball": (0.5, 0.5), "wind": (0.85, 0.5), "logs": (0.58, 0.58)}
"""Width and depth of the box over its height."""


@dataclass(frozen=True)
class Draw:
    """A fire before it burns.

    Attributes:
        number: which one.    kind: of `KINDS`.    law: of `light.LAWS`.
        spec: what the generator bakes; its cameras and background are not looked at.
        azimuth_deg, height_deg: (C,) where the cameras stand.    away, longest_px: as of `pictures.around`.
        exposure: linear light of the picture's bright parts.    thickness: optical depth there.
        colour: (3,) of the light.    plate: its brightness, linear.    plate_fire: of the mean flame left in the plate.
        noise: std-dev, display values.
    """

    number: int
    kind: str
    law: Law
    spec: SceneSpec
    azimuth_deg: np.ndarray
    height_deg: np.ndarray
    away: float
    longest_px: int
    exposure: float
    thickness: float
    colour: np.ndarray
    plate: float
    plate_fire: float
    noise: float

    @classmethod
    def of(cls, number: int) -> Draw:
        """Return the fire of a number >= 0; kinds and laws take turns, so that any few dozen in a row hold them all."""
        rng = np.random.default_rng([2209, number])
        kind, law = KINDS[number % len(KINDS)], LAWS[sum(divmod(number, len(KINDS))) % len(LAWS)]
        spec = _spec(number, kind, law, rng)
        count = int(rng.choice([2, 3, 4, 5], p=[0.12, 0.64, 0.14, 0.1]))
        return cls(
            number=number,
            kind=kind,
            law=law,
            spec=spec,
            azimuth_deg=rng.uniform(0, 360) + rng.uniform(40, 130) * np.linspace(-0.5, 0.5, count),
            height_deg=rng.uniform(-5, 28) + rng.normal(0, 2, count),
            away=float(rng.uniform(1.4, 3)),
            longest_px=int(rng.integers(150, 215)),
            exposure=_log(rng, 0.4, 3),
            thickness=float(rng.choice([0.0, _log(rng, 0.2, 3)])),
            colour=np.array([1.0, rng.uniform(0.3, 0.6), rng.uniform(0.04, 0.2)]),
            plate=float(rng.uniform(0.002, 0.05)),
            plate_fire=float(rng.choice([0.0, rng.uniform(0.0, 0.15)], p=[0.8, 0.2])),
            noise=float(rng.uniform(0.001, 0.008)),
        )


def _log(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _spec(number: int, kind: str, law: Law, rng: np.random.Generator) -> SceneSpec:
    """Return what the generator bakes: a burner of 5 cm to 1 m, in a box as high as its flame needs (Heskestad)."""
    diameter = _log(rng, 0.05, 1.0)
    jet = 0.0
    if kind == "jet":
        diameter = _log(rng, 0.05, 0.3)
        height = diameter / _log(rng, 0.052, 0.1)
        jet = float(np.clip(rng.uniform(0.2, 1.6) * (9.81 * height) ** 0.5, 0.5, 6.0))
    else:
        height = 1.6 * (diameter / 0.26) ** 0.8 * rng.uniform(0.85, 1.25)
    diameter = float(np.clip(diameter, 0.052 * height, 0.3 * height))
    fast = (9.81 * height) ** 0.5
    if kind == "wind" and rng.random() < 0.3:
        jet, diameter = float(rng.uniform(0.2, 1.0) * fast), 0.65 * diameter
    shape = {"ball": "sphere", "logs": "logs"}.get(kind, "disc")
    if kind == "wind" and not jet and rng.random() < 0.4:
        shape = "sphere"
    fire = Fire(
        fuel=str(rng.choice(FUELS)),
        shape=shape,
        radius=diameter / 2,
        jet_speed=jet,
        light="reaction" if law == "glow" else law,
    )
    fire = replace(fire, position=(0.0, 0.0, 0.05 * height + fire.half_size[2]))
    effects = [vorticity.Settings(gas=float(rng.uniform(0, 1.3)), flame=float(rng.uniform(0.2, 2.2)))]
    if kind == "wind":
        push = float(rng.uniform(0.1, 0.5) * 0.5 * fast)
        effects.append(wind.Settings(push, float(rng.uniform(-35, 35)), gusts=float(rng.uniform(0, 0.9))))
    wide, deep = (share * height for share in ROOM[kind])
    low = (-0.3 * wide if kind == "wind" else -wide / 2, -deep / 2, 0.0)
    return SceneSpec(
        name=f"fire_{number:05d}",
        seed=number,
        clip=_clip(height, 3.0 * height**0.5 * (1 + 0.35 * jet / fast), rng),
        domain=Domain(low, (wide, deep, height), 40 if kind == "jet" else 32),
        fire=fire,
        background="ground",
        effects=tuple(effects),
        ground_truth=("grids",),
    )


def _clip(height: float, speed: float, rng: np.random.Generator) -> Clip:
    """Return the clip of a fire in a box of a height, whose gas is roughly as fast as said."""
    flame = 0.65 * height
    rate = float(np.clip(speed / (_log(rng, 0.015, 0.085) * flame), LEAST_HZ, MOST_HZ))
    goes = speed / (rate * flame)
    steps = ceil(goes / LONGEST_STEP)
    return Clip(FRAMES, rate, ceil(min(WARM_UP / goes, 90 / steps)), steps_per_frame=steps)
