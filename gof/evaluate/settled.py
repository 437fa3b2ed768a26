"""Two checks of a DVE: what more nodes change, and whether its velocities are the motion of its Gaussians.

The paper takes three nodes per axis. More of them are tried on a sample of the Gaussians, drawn by weight, until the
digits that are printed hold; the difference on the sample moves the score of all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gof.core.gaussians import MovingGaussians
from gof.evaluate.dve_frame import DVEResult, Samples, Sums, agreement_sums
from gof.evaluate.expectation import expected_velocity
from gof.evaluate.intervals import own_generator
from gof.evaluate.quadrature import ORDERS
from gof.evaluate.sparse_grid import fields_of

SAMPLE = 1000  # Gaussians per frame
HOLDS = 0.0005  # change of a figure that three printed digits do not show
STEP_S = 1e-3  # to each side, of the motion


@dataclass(frozen=True)
class Settled:
    """DVE at the order where its digits hold; `l2_off`, `cos_sim_off`: the last change, that may still be missing."""

    order: int
    l2: float
    cos_sim: float
    l2_off: float
    cos_sim_off: float


def settle(
    gaussians: MovingGaussians, sequence, frames: Sequence[Samples], scored: DVEResult, order: int
) -> Settled | None:
    """Return the DVE `scored` of `frames` with as many nodes as its printed digits need; None where it is undefined.

    Args:
        sequence: the truth, as in `dve_sequence`.   order: of `scored`.
    """
    orders = [order, *(more for more in ORDERS if more > order)]
    if scored.l2 is None or scored.cos_sim is None or len(orders) < 2:
        return None
    rng, fields = own_generator("sample of the quadrature"), fields_of(sequence)
    picked = [_by_weight(frame, rng) for frame in frames]
    found: list[tuple[float, float]] = []
    for nodes in orders:
        sums = Sums()
        for frame, rows in zip(frames, picked, strict=True):
            truth = frame.truth[rows] if nodes == order else _truth(gaussians, fields, frame, rows, nodes)
            share = np.full(len(rows), frame.weight.sum() / max(len(rows), 1))
            sums = sums + agreement_sums(share, frame.velocity[rows], truth)
        result = DVEResult.from_sums(sums)
        if result.l2 is None or result.cos_sim is None:
            return None
        found.append((result.l2, result.cos_sim))
        if len(found) > 1 and max(np.abs(np.subtract(found[-1], found[-2]))) < HOLDS:
            break
    l2, cos_sim = np.subtract(found[-1], found[0]) + (scored.l2, scored.cos_sim)
    l2_off, cos_sim_off = np.abs(np.subtract(found[-1], found[-2]))
    return Settled(orders[len(found) - 1], float(l2), float(cos_sim), float(l2_off), float(cos_sim_off))


def _by_weight(frame: Samples, rng: np.random.Generator) -> np.ndarray:
    """Return rows of a frame, drawn evenly from its weight."""
    if len(frame.weight) == 0:
        return np.zeros(0, np.int64)
    total = np.cumsum(frame.weight)
    level = (np.arange(SAMPLE) + rng.random(SAMPLE)) / SAMPLE * total[-1]
    return np.minimum(np.searchsorted(total, level, side="right"), len(total) - 1)


def _truth(gaussians: MovingGaussians, fields, frame: Samples, rows: np.ndarray, order: int) -> np.ndarray:
    state, index = gaussians.state_at(frame.time_s), frame.index[rows]
    scale = state.scale[index].astype(np.float64)
    return expected_velocity(fields.at(frame.time_s), frame.position[rows], scale, state.rotation[index], order).mean


def against_motion(gaussians: MovingGaussians, frames: Sequence[Samples]) -> DVEResult:
    """Compare the scored velocities with the motion of the Gaussians' centres, by DVE's formulas and weights.

    L2 0 and CosSim 1 say that the velocity is the motion; a result whose velocities are of the gas differs from it.
    """
    first, last = gaussians.covered_s
    sums = Sums()
    for frame in frames:
        before, after = max(frame.time_s - STEP_S, first), min(frame.time_s + STEP_S, last)
        places = [gaussians.state_at(t).at(t)[0][frame.index].astype(np.float64) for t in (before, after)]
        sums = sums + agreement_sums(frame.weight, frame.velocity, (places[1] - places[0]) / (after - before))
    return DVEResult.from_sums(sums)
