"""How fast a flame is as a whole: the mean speed of its gas, from the speed at which it is seen to move.

Texture lags behind the gas by a factor that is much the same all over one flame and differs from flame to flame: 0.8 to
4 on the benchmark's. A clip says little of it, and a hundred flames are not at hand to learn it from, so it is a
straight line in logarithms through three clues that physics names:

- what buoyancy would make of a flame of this length, if lengths are metres: hot gas cannot choose its speed;
- how slender the flame is: a jet is faster than buoyancy, and a squat flame that is fed from all sides slower;
- how much of the seen motion carries its texture with it: where light rather goes out and on again in place, optical
  flow reads much of that as motion, and the gas is slower than it looks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from gof.reconstruct.flame_axis import FlameAxis
from gof.reconstruct.log_light import LogLight, slope

GRAVITY = 9.81  # m/s2
LAW = 2.18  # of sqrt(g z): McCaffrey's 6.83 sqrt(z) on the axis of the continuous flame (NBSIR 79-1910)
BODY = 0.3, 0.9  # shares of the light below the ends of the part whose length counts
USUAL = np.array([4.5, 0.14, 0.6])  # of the clues; logarithms are taken from there
FARTHEST = np.log(4.0)  # a clue stranger than that counts no more: no flame of the benchmark is
STIFFNESS = 0.05  # of the fit: as much as a twentieth of a flame that says "all clues mean nothing"
UPRIGHT = 0.5  # cosine of a flame's tilt: below it up is likelier wrong than the flame blown down
TEXTURE = 1.5  # voxels, std-dev of the light that is looked at


@dataclass(frozen=True)
class SpeedClues:
    """Clues to the pace of a clip.

    Attributes:
        seen: RMS of the seen velocity, m/s; > 0.
        buoyant: what buoyancy would make of the flame, m/s, if its lengths are metres.
        carried: speed along the axis at which the texture of the light is carried, m/s.
        slenderness: the flame's radius over its length.
        energy: how much there is to see of it, > 0: its light times the square of its seen speed, in any unit.
    """

    seen: float
    buoyant: float
    carried: float
    slenderness: float
    energy: float

    @classmethod
    def of(cls, axis: FlameAxis, log_light: LogLight) -> SpeedClues:
        return cls(
            seen=axis.seen_speed,
            buoyant=buoyant_speed(axis),
            carried=carried_speed(axis, log_light),
            slenderness=axis.radius / axis.length,
            energy=float(axis.mean_light.sum()) * axis.seen_speed**2,
        )

    @property
    def logs(self) -> np.ndarray:
        """(3,) logarithms over the usual: buoyant over seen, slenderness, carried over seen."""
        ratios = np.array([self.buoyant / self.seen, self.slenderness, self.carried / self.seen])
        return np.clip(np.log(np.maximum(ratios, 1e-9) / USUAL), -FARTHEST, FARTHEST)


def buoyant_speed(axis: FlameAxis) -> float:
    """Return the law's rise over the length of the flame's body, along its own axis. m/s.

    The body lies between BODY of the light. Its length says more of the pace than height above the foot does, or than
    the whole length: on fires left out (notebook/motion.md).

    Wind carries gas sideways and leaves its rise as it is, so gas of a tilted flame is faster by 1 / cos(tilt). Beyond
    60 degrees that is believed less and less: a flame that lies, or hangs, counts as upright in a world that does not.
    """
    share = np.cumsum(axis.mean_light) / axis.mean_light.sum()
    low, high = np.interp(BODY, share, np.arange(axis.layers.count) * axis.layers.thickness)
    length = max(high - low, 2 * axis.layers.thickness)
    upright = float(np.clip(axis.layers.direction[2], 0, 1))
    upright = upright if stands(axis) else 1 - upright
    return LAW * float(np.sqrt(GRAVITY * upright * length)) / upright


def stands(axis: FlameAxis) -> bool:
    """Return whether a flame is tilted so little that its rise can be believed."""
    return bool(axis.layers.direction[2] >= UPRIGHT)


def carried_speed(axis: FlameAxis, log_light: LogLight) -> float:
    """Return the one speed along the axis, m/s, that explains most of how log light changes from frame to frame.

    Least squares over all voxels and pairs of frames, weighted by emission (Lucas and Kanade 1981, with the flame as
    the window). Light that goes out or on in place pulls it towards 0; optical flow looks for a match.
    Returns:
        0 where the light has no texture along the axis, or there is a single frame.
    """
    frames, voxels = log_light.field.frames, log_light.field.voxels
    cells = tuple(voxels.index.T)
    carried = texture = 0.0
    for f, (before, after) in enumerate(pairwise(frames)):
        first, second = log_light.grid(f, TEXTURE), log_light.grid(f + 1, TEXTURE)
        along = slope((first + second) / 2, voxels) @ axis.layers.direction
        change = (second - first)[cells] / (after.time_s - before.time_s)
        weight = before.emission + after.emission
        carried -= float((weight * along * change).sum())
        texture += float((weight * along**2).sum())
    return carried / texture if texture > 0 else 0.0


@dataclass(frozen=True)
class MeanSpeed:
    """A line: log of (mean speed of the gas over the seen one) = weights . (1, clues).

    Attributes:
        metric: (4,) where lengths are metres and times seconds.
        unitless: (4,) where that is unknown; nothing for buoyancy.
    """

    metric: np.ndarray
    unitless: np.ndarray

    def of(self, clues: SpeedClues, metres: bool = True) -> float:
        """Mean speed of the flame's gas, weighted by light, m/s."""
        weights = self.metric if metres else self.unitless
        return clues.seen * float(np.exp(weights @ [1, *clues.logs]))

    def side_by_side(self, clues: Sequence[SpeedClues], metres: bool = True) -> list[float]:
        """Mean speeds of the gas of flames that burn side by side, m/s.

        The same fuel burns in the same air, so their gas is the same multiple of what buoyancy would make of each of
        them: the mean, in logarithms, of what each says by itself, weighted by its energy, because a flame of smooth
        sheets is hardly seen to move and says little of its pace. Only the ratio of their lengths enters, which needs
        no metres. A single flame: what it says by itself.
        """
        buoyant = np.array([flame.buoyant for flame in clues])
        apart = np.array([self.of(flame, metres) for flame in clues])
        if len(clues) < 2 or not (buoyant > 0).all():
            return apart.tolist()
        energy = [flame.energy for flame in clues]
        return (buoyant * np.exp(np.average(np.log(apart / buoyant), weights=energy))).tolist()

    @classmethod
    def fit(cls, clues: Sequence[SpeedClues], speed: Sequence[float]) -> MeanSpeed:
        """Fit the line through flames whose mean speed, m/s, is known (ridge regression; the constant is free)."""
        design = np.stack([[1, *flame.logs] for flame in clues])
        factor = np.log([true / flame.seen for true, flame in zip(speed, clues, strict=True)])
        return cls(_ridge(design, factor), _ridge(design * [1, 0, 1, 1], factor))


def _ridge(design: np.ndarray, values: np.ndarray) -> np.ndarray:
    penalty = STIFFNESS * np.diag([1e-6] + [1] * (design.shape[1] - 1))
    return np.linalg.solve(design.T @ design + penalty, design.T @ values)
