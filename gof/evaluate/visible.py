"""How fast a result says that the gas moves at a place: the mean velocity of the Gaussians that are drawn there.

A Gaussian i is drawn at x where alpha_i(t) g_i(x) >= 1/255, with g_i(x) = exp(-d_i(x)^2 / 2) and d_i the Mahalanobis
distance: fainter than that no rasteriser draws it. It counts there as it counts in pictures, by its opacity per metre
of a ray through x,

    k_i(x) = alpha_i(t) g_i(x) / s_i,   s_i = (s_x s_y s_z)^(1/3),

so that a Gaussian counts in the velocity only if it shows in the picture, and a wide, faint Gaussian has next to none.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain
from typing import Any, TypeAlias

import numpy as np

from gof.core.gaussians import TransientGaussians
from gof.core.rotations import rotation_matrices
from gof.core.shining import DRAWN

BATCH = 4000  # Gaussians at a time: bounds memory where all are large
COMPILED_FROM = 5_000_000  # places times Gaussians; below, loading the compiler takes longer than numpy
Pairs: TypeAlias = tuple[np.ndarray, np.ndarray, np.ndarray]  # place (P,), Gaussian (P,), alpha g (P,)


@dataclass(frozen=True)
class Visible:
    """Which Gaussians are drawn at places, pair by pair.

    Attributes:
        places: M, their number.   place: (P,) 0..M-1.   gaussian: (P,) row of the state.
        per_metre: (P,) k, 1/m, > 0.
    """

    places: int
    place: np.ndarray
    gaussian: np.ndarray
    per_metre: np.ndarray

    def total(self) -> np.ndarray:
        """Return (M,) 1/m, the sum of k; zero where nothing is drawn."""
        return np.bincount(self.place, self.per_metre, self.places)

    def weighted(self, values: np.ndarray) -> np.ndarray:
        """Return (M,), the sum of k times the Gaussians' values (N,)."""
        return np.bincount(self.place, self.per_metre * values[self.gaussian], self.places)

    def mean_velocity(self, velocity: np.ndarray) -> np.ndarray:
        """Return (M, 3) m/s: the mean by k of the Gaussians' velocities (N, 3); zero where nothing is drawn."""
        total = self.total()
        sums = np.stack([self.weighted(column) for column in velocity.T.astype(np.float64)], 1)
        return sums / np.where(total > 0, total, 1)[:, None]


def opacity_per_metre(points: np.ndarray, state: TransientGaussians, time_s: float) -> Visible:
    """Return k at world points (M, 3) of the Gaussians of a state that are drawn there. Static ones count: they rest.

    Many pairs take a compiled kernel; the plain twin below agrees with it to rounding (tested).
    """
    position, alpha = state.at(time_s)
    place, gaussian, drawn = pairs(points, position, alpha, state.scale, state.rotation)
    size = np.cbrt(state.scale[gaussian].astype(np.float64).prod(1))
    return Visible(len(points), place, gaussian, drawn / size)


def pairs(
    points: np.ndarray, position: np.ndarray, alpha: np.ndarray, scale: np.ndarray, rotation: np.ndarray
) -> Pairs:
    """Return the pairs of points (M, 3) and Gaussians whose alpha g there is DRAWN or more."""
    if len(points) * len(position) >= max(COMPILED_FROM, 1):
        from gof.render.backend import kernels  # here: it loads the compiler

        if kernels().name == "native":
            from gof.render.native.inside import points_inside

            return points_inside(points, position, alpha, scale, rotation, DRAWN)
    return pairs_plain(points, position, alpha, scale, rotation)


def pairs_plain(
    points: np.ndarray, position: np.ndarray, alpha: np.ndarray, scale: np.ndarray, rotation: np.ndarray
) -> Pairs:
    """Compute `pairs` in numpy and a tree of the points."""
    from scipy.spatial import cKDTree  # here: a quarter of a second

    rows = np.flatnonzero(alpha >= DRAWN)
    reach = np.sqrt(2 * np.log(np.maximum(alpha[rows] / DRAWN, 1.0))) * scale[rows].max(1)
    low, high = points.min(0, initial=np.inf), points.max(0, initial=-np.inf)
    rows = rows[((position[rows] + reach[:, None] >= low) & (position[rows] - reach[:, None] <= high)).all(1)]
    tree = cKDTree(points) if len(rows) else None
    parts: list[Pairs] = [(np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0))]
    for start in range(0, len(rows), BATCH):
        some = rows[start : start + BATCH]
        near, owner, drawn = _of_some(points, tree, position[some], alpha[some], scale[some], rotation[some])
        parts.append((near, some[owner], drawn))
    place, gaussian, drawn = (np.concatenate(column) for column in zip(*parts, strict=True))
    return place, gaussian, drawn


def _of_some(
    points: np.ndarray, tree: Any, position: np.ndarray, alpha: np.ndarray, scale: np.ndarray, rotation: np.ndarray
) -> Pairs:
    """Return the pairs of some Gaussians alone."""
    scale, strength, every = scale.astype(np.float64), alpha.astype(np.float64), np.arange(len(alpha))
    limit = 2 * np.log(np.maximum(strength / DRAWN, 1.0))  # of the Mahalanobis distance, squared
    near = tree.query_ball_point(position, np.sqrt(limit) * scale.max(1), return_sorted=False)
    counts = np.fromiter(map(len, near), np.int64, len(near))
    place = np.fromiter(chain.from_iterable(near), np.int64, counts.sum())
    owner = np.repeat(every, counts)
    whiten = np.moveaxis(rotation_matrices(rotation) / scale[:, None, :], 2, 1)  # rows: own axes over sizes
    distance2 = np.zeros(len(owner))
    for k in np.argsort(scale, axis=1).T:  # along the thinnest axis most places are out of reach
        axis = whiten[every, k]
        along = np.einsum("pi,pi->p", points[place], axis[owner]) - np.einsum("ni,ni->n", position, axis)[owner]
        distance2 += along**2
        seen = distance2 <= limit[owner]
        place, owner, distance2 = place[seen], owner[seen], distance2[seen]
    return place, owner, strength[owner] * np.exp(-0.5 * distance2)
