"""Velocity fields with a known expectation under a Gaussian, in float64, and small sets of Gaussians."""

from __future__ import annotations

import numpy as np

from gof.core.gaussians import TransientGaussians
from gof.core.rotations import rotation_matrices


class Analytic:
    """A field given by a function of world points, in a box (default: everywhere)."""

    def __init__(self, function, low=-np.inf, high=np.inf, voxel_size=1.0, time_s=0.0):
        self.function, self.low, self.high, self.voxel_size, self.time_s = function, low, high, voxel_size, time_s

    def contains(self, points):
        return ((points >= self.low) & (points <= self.high)).all(-1)

    def sample(self, points):
        return np.where(self.contains(points)[:, None], self.function(np.asarray(points, np.float64)), 0.0)


class Sequence:
    """Fields over time with the interface of VelocitySequence."""

    def __init__(self, times_s, field_at):
        self.times_s, self.at = np.asarray(times_s, float), field_at


def waves(k):
    """name -> (V, E[V]) for sums of plane waves: a Gaussian damps each to exp(-variance along it / 2)."""

    def damp(vector, cov):
        return np.exp(-0.5 * np.einsum("i,nij,j->n", vector, cov, vector))

    def abc(x):
        return np.stack(
            [
                np.sin(k * x[:, 2]) + np.cos(k * x[:, 1]),
                np.sin(k * x[:, 0]) + np.cos(k * x[:, 2]),
                np.sin(k * x[:, 1]) + np.cos(k * x[:, 0]),
            ],
            1,
        )

    def abc_mean(x, cov):
        d = np.stack([damp(k * e, cov) for e in np.eye(3)], 1)
        return np.stack(
            [
                d[:, 2] * np.sin(k * x[:, 2]) + d[:, 1] * np.cos(k * x[:, 1]),
                d[:, 0] * np.sin(k * x[:, 0]) + d[:, 2] * np.cos(k * x[:, 2]),
                d[:, 1] * np.sin(k * x[:, 1]) + d[:, 0] * np.cos(k * x[:, 0]),
            ],
            1,
        )

    def taylor_green(x):  # sin(kx) cos(ky), -cos(kx) sin(ky), 0
        s, c = np.sin(k * x), np.cos(k * x)
        return np.stack([s[:, 0] * c[:, 1], -c[:, 0] * s[:, 1], 0 * c[:, 0]], 1)

    def taylor_green_mean(x, cov):  # products are sums of the waves (1, 1, 0) and (1, -1, 0)
        plus, minus = k * np.array([1.0, 1, 0]), k * np.array([1.0, -1, 0])
        a, b = damp(plus, cov), damp(minus, cov)
        sp, sm = np.sin(x @ plus), np.sin(x @ minus)
        return np.stack([(a * sp + b * sm) / 2, -(a * sp - b * sm) / 2, 0 * a], 1)

    return {"abc": (abc, abc_mean), "taylor_green": (taylor_green, taylor_green_mean)}


def covariance(scale, rotation):
    axes = rotation_matrices(rotation) * np.asarray(scale, np.float64)[:, None, :]
    return axes @ axes.transpose(0, 2, 1)


def make_gaussians(n=50, seed=0, **changes) -> TransientGaussians:
    """Random rotated, anisotropic Gaussians in a unit box around the origin, always on; `changes` replaces fields."""
    rng = np.random.default_rng(seed)
    values = dict(
        position=rng.uniform(-0.5, 0.5, (n, 3)),
        velocity=rng.normal(size=(n, 3)),
        t_mu=np.zeros(n),
        t_sigma=np.full(n, np.inf),
        scale=rng.uniform(0.02, 0.2, (n, 3)),
        rotation=rng.normal(size=(n, 4)),
        opacity=rng.uniform(0.1, 0.9, n),
        color=rng.uniform(size=(n, 3)),
        dynamic=np.ones(n, bool),
    )
    return TransientGaussians(**{name: np.asarray(value) for name, value in (values | changes).items()})
