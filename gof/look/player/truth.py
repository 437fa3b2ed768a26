"""The true velocity where a result's Gaussians are."""

from __future__ import annotations

import numpy as np

from gof.core.fields import VelocitySequence
from gof.core.gaussians import TransientGaussians


def true_velocity(gaussians: TransientGaussians, truth: VelocitySequence) -> np.ndarray:
    """(N, 3) m/s of the gas at each Gaussian's centre at its own time t_mu; 0 outside the field.

    Linear between the stored frames, the first or last one beyond them: as `VelocitySequence.at`, a frame read once.
    """
    clock = np.asarray(truth.times_s, np.float64)
    out = np.zeros((len(gaussians), 3))
    place = np.interp(gaussians.t_mu.astype(np.float64), clock, np.arange(len(clock)))
    for k in range(len(clock)):
        weight = np.clip(1 - np.abs(place - k), 0, 1)
        near = np.flatnonzero(weight > 0)
        if len(near):
            out[near] += weight[near, None] * truth.frame(k).sample(gaussians.position[near])
    return out
