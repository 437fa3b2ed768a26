"""How fast a result says that the gas moves at a place: the mean velocity of the Gaussians that are drawn there.

A Gaussian i is drawn at x where alpha_i(t) g_i(x) >= 1/255, with g_i(x) = exp(-d_i(x)^2 / 2) and d_i the Mahalanobis
distance: fainter than that no rasteriser draws it. It counts there as it counts in pictures, by its opacity per metre
of a ray through x,

    k_i(x) = alpha_i(t) g_i(x) / s_i,   s_i = (s_x s_y s_z)^(1/3),

so that whoever wants a say in the velocity must show in the picture, and a wide, faint Gaussian has next to none.
"""

from __future__ import annotations

from itertools import chain

import numpy as np
from scipy.sparse import csr_matrix
from scipy.spatial import cKDTree

from gof.core.gaussians import TransientGaussians
from gof.core.rotations import rotation_matrices

DRAWN = 1 / 255  # alpha below which nothing is drawn
BATCH = 4000  # Gaussians at a time: bounds memory where all are large


def opacity_per_metre(points: np.ndarray, state: TransientGaussians, time_s: float) -> csr_matrix:
    """Return k (M, N) 1/m at world points (M, 3) of the N Gaussians of a state; zero where one is not drawn.

    `k @ velocity / k.sum(1)` is what they say there, for any velocities (N, 3). Static ones count: they rest.
    """
    position, alpha = state.at(time_s)
    rows = np.flatnonzero(alpha >= DRAWN)
    reach = np.sqrt(2 * np.log(np.maximum(alpha[rows] / DRAWN, 1.0))) * state.scale[rows].max(1)
    low, high = points.min(0, initial=np.inf), points.max(0, initial=-np.inf)
    rows = rows[((position[rows] + reach[:, None] >= low) & (position[rows] - reach[:, None] <= high)).all(1)]
    parts = [csr_matrix((len(points), len(state)))]
    tree = cKDTree(points) if len(rows) else None
    for start in range(0, len(rows), BATCH):
        parts.append(_of_some(points, tree, state, position, alpha, rows[start : start + BATCH]))
    return sum(parts[1:], parts[0])


def _of_some(
    points: np.ndarray,
    tree: cKDTree,
    state: TransientGaussians,
    position: np.ndarray,
    alpha: np.ndarray,
    rows: np.ndarray,
) -> csr_matrix:
    """Return `opacity_per_metre` of some rows alone."""
    scale, strength = state.scale[rows].astype(np.float64), alpha[rows].astype(np.float64)
    limit = 2 * np.log(np.maximum(strength / DRAWN, 1.0))  # of the Mahalanobis distance, squared
    near = tree.query_ball_point(position[rows], np.sqrt(limit) * scale.max(1), return_sorted=False)
    counts = np.fromiter(map(len, near), np.int64, len(near))
    place = np.fromiter(chain.from_iterable(near), np.int64, counts.sum())
    owner = np.repeat(np.arange(len(rows)), counts)
    whiten = np.moveaxis(rotation_matrices(state.rotation[rows]) / scale[:, None, :], 2, 1)  # rows: own axes over sizes
    order = np.argsort(scale, axis=1)  # along the thinnest axis most places are out of reach
    distance2 = np.zeros(len(owner))
    for k in order.T:
        axis = whiten[np.arange(len(rows)), k]
        along = np.einsum("pi,pi->p", points[place], axis[owner]) - np.einsum("ni,ni->n", position[rows], axis)[owner]
        distance2 += along**2
        seen = distance2 <= limit[owner]
        place, owner, distance2 = place[seen], owner[seen], distance2[seen]
    per_metre = strength[owner] * np.exp(-0.5 * distance2) / np.cbrt(scale.prod(1))[owner]
    return csr_matrix((per_metre, (place, rows[owner])), (len(points), len(state)))


def mean_velocity(k: csr_matrix, velocity: np.ndarray) -> np.ndarray:
    """Return (M, 3) m/s: the mean of velocities (N, 3) by their opacity per metre k (M, N); zero where k is."""
    total = np.asarray(k.sum(1)).ravel()
    return np.asarray(k @ velocity.astype(np.float64)) / np.where(total > 0, total, 1)[:, None]
