"""Errors of the flow's rotation and of its expansion, where the flame shines. Ours beside DVE; as fluid papers ask.

A result answers at a place as in `gof.evaluate.emission`. Its gradient, and the truth's, is the central difference over
one cell of the true grid to each side; where no Gaussian is on one of the six sides, a result says nothing of how the
flow changes, and its gradient counts as zero.

    vorticity   sqrt( sum |w - W|^2 / sum |W|^2 )            w, W: curl of the result's and of the true velocity
    divergence  sqrt( sum (d - D)^2 / sum |grad V|^2 )       d, D: divergence; over the size of the true gradient, as a
                                                             true divergence is next to nothing outside the flame
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gof.core.fields import VelocitySequence
from gof.core.gaussians import MovingGaussians
from gof.evaluate.draws import own_generator
from gof.evaluate.emission import COVERED, FlameGrid, velocity_at
from gof.evaluate.sparse_grid import StoredField

POINTS = 256  # places per frame


@dataclass(frozen=True)
class GradientErrors:
    """Pooled over all frames; None where the true gradient is zero, or nothing shines.

    Attributes:
        still_divergence_l2: the divergence error of a flow that stands still (its vorticity error is 1).
        uncovered: share of the places without a Gaussian on one of their sides, 0..1.
    """

    vorticity_l2: float | None
    divergence_l2: float | None
    still_divergence_l2: float | None
    uncovered: float


def score_gradients(
    gaussians: MovingGaussians,
    truth: VelocitySequence,
    flame: FlameGrid,
    times_s: np.ndarray,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> GradientErrors:
    """Errors at POINTS places per frame, drawn from the true emission; the seed makes them the same for all results.

    Raises:
        DataFormatError: see `FlameGrid.places`.
    """
    rng = own_generator("places of gradients", seed)
    sums, uncovered, count = np.zeros(5), 0, 0
    for k, time_s in enumerate(map(float, times_s)):
        places = flame.places(time_s, POINTS, rng)
        if len(places):
            field = StoredField(truth, time_s)
            sides = six_sides(places, field.voxel_size)
            velocity, cover = velocity_at(sides, gaussians, time_s)
            known = (cover >= COVERED).reshape(6, -1).all(0)
            found = gradient(velocity, field.voxel_size) * known[:, None, None]
            true = gradient(field.sample(sides).astype(np.float64), field.voxel_size)
            sums += _squares(found, true)
            uncovered += int((~known).sum())
            count += len(places)
        if progress:
            progress(k + 1, len(times_s))
    rotation, true_rotation, expansion, true_expansion, size = sums
    return GradientErrors(
        vorticity_l2=float(np.sqrt(rotation / true_rotation)) if true_rotation > 0 else None,
        divergence_l2=float(np.sqrt(expansion / size)) if size > 0 else None,
        still_divergence_l2=float(np.sqrt(true_expansion / size)) if size > 0 else None,
        uncovered=uncovered / max(count, 1),
    )


def six_sides(places: np.ndarray, step: float) -> np.ndarray:
    """(6 M, 3): the places (M, 3) moved by a step along +x, +y, +z, -x, -y, -z."""
    moves = step * np.concatenate([np.eye(3), -np.eye(3)])
    return (moves[:, None] + places).reshape(-1, 3)


def gradient(values: np.ndarray, step: float) -> np.ndarray:
    """(M, 3, 3) of a vector's values (6 M, 3) at `six_sides`: [:, j, k] is the change of component k along axis j."""
    ahead, behind = values.reshape(2, 3, -1, 3)
    return np.moveaxis((ahead - behind) / (2 * step), 0, 1)


def curl(gradients: np.ndarray) -> np.ndarray:
    """(M, 3) 1/s of velocity gradients (M, 3, 3) with [:, j, k] = d v_k / d x_j."""
    spin = gradients - gradients.transpose(0, 2, 1)
    return np.stack([spin[:, 1, 2], spin[:, 2, 0], spin[:, 0, 1]], -1)


def _squares(found: np.ndarray, true: np.ndarray) -> np.ndarray:
    """(5,) sums of squares: error and size of the vorticity, error and size of the divergence, size of the gradient."""
    rotation, expansion = curl(true), np.trace(true, axis1=1, axis2=2)
    parts = (
        curl(found) - rotation,
        rotation,
        np.trace(found, axis1=1, axis2=2) - expansion,
        expansion,
        true,
    )
    return np.array([np.square(part).sum() for part in parts])
