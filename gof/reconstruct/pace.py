"""How fast a flame is as a whole: the mean speed of its gas, from the speed at which it is seen to move.

Texture lags behind the gas by a factor that is much the same all over one flame and differs from flame to flame: 0.8 to
4 on the benchmark's. A clip says little of it, and a hundred flames are not at hand to learn it from, so it is a
straight line in logarithms through two clues that physics names:

- what buoyancy would make of a flame of this length, if lengths are metres: hot gas cannot choose its speed;
- how slender the flame is: a jet is faster than buoyancy, and a squat flame that is fed from all sides slower.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gof.reconstruct.flame_axis import FlameAxis

GRAVITY = 9.81  # m/s2
LAW = 2.18  # of sqrt(g z): McCaffrey's 6.83 sqrt(z) on the axis of the continuous flame (NBSIR 79-1910)
USUAL = np.array([4.0, 0.14])  # of the clues; logarithms are taken from there
FARTHEST = np.log(4.0)  # a clue stranger than that counts no more: no flame of the benchmark is
STIFFNESS = 0.05  # of the fit: as much as a twentieth of a flame that says "both clues mean nothing"


def buoyant_speed(axis: FlameAxis) -> float:
    """Mean over the light of the law's speed at its height above the foot, along the flame's own axis. m/s."""
    height = (np.arange(axis.layers.count) * axis.layers.thickness - axis.foot).clip(0)
    return float((axis.mean_light * LAW * np.sqrt(GRAVITY * height)).sum() / axis.mean_light.sum())


def clues(axis: FlameAxis) -> np.ndarray:
    """(2,) buoyant over seen speed, and the flame's radius over its length; logarithms of both over the usual."""
    ratios = np.array([buoyant_speed(axis) / axis.seen_speed, axis.radius / axis.length])
    return np.clip(np.log(np.maximum(ratios, 1e-9) / USUAL), -FARTHEST, FARTHEST)


@dataclass(frozen=True)
class Pace:
    """A line: log of (mean speed of the gas over the seen one) = weights . (1, clue, clue).

    Attributes:
        metric: (3,) where lengths are metres and times seconds.
        unitless: (3,) where nobody knows that; nothing for buoyancy.
    """

    metric: np.ndarray
    unitless: np.ndarray

    def of(self, axis: FlameAxis, metres: bool = True) -> float:
        """Mean speed of the flame's gas, weighted by light, m/s."""
        weights = self.metric if metres else self.unitless
        return axis.seen_speed * float(np.exp(weights @ [1, *clues(axis)]))

    @classmethod
    def fit(cls, axes: Sequence[FlameAxis], speed: Sequence[float]) -> Pace:
        """The line through flames whose mean speed, m/s, is known (ridge regression; the constant is free)."""
        design = np.stack([[1, *clues(axis)] for axis in axes])
        factor = np.log([true / axis.seen_speed for true, axis in zip(speed, axes, strict=True)])
        return cls(_ridge(design, factor), _ridge(design * [1, 0, 1], factor))


def _ridge(design: np.ndarray, values: np.ndarray) -> np.ndarray:
    penalty = STIFFNESS * np.diag([1e-6, 1, 1])
    return np.linalg.solve(design.T @ design + penalty, design.T @ values)
