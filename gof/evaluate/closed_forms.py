"""Flows whose expected value under any Gaussian is known exactly: what the quadrature is judged against."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Flow:
    """velocity(points (M, 3) m) -> (M, 3) m/s; mean(position (M, 3), covariance (M, 3, 3)) -> expectation (M, 3)."""

    name: str
    velocity: Callable[[np.ndarray], np.ndarray]
    mean: Callable[[np.ndarray, np.ndarray], np.ndarray]


def linear() -> Flow:
    """V = A x + b: the expectation is the value at the centre."""
    A, b = np.array([[0.3, -2, 0], [2, 0.3, 0], [0.5, 0, -0.6]]), np.array([0.1, 0, 1.5])
    return Flow("linear", lambda x: x @ A.T + b, lambda m, C: m @ A.T + b)


def taylor_green(k: float) -> Flow:
    """V = (sin kx cos ky, -cos kx sin ky, 0): two plane waves, each damped by exp(-(k sigma)^2 / 2) along itself."""

    def velocity(x):
        s, c = np.sin(k * x), np.cos(k * x)
        return np.stack([s[:, 0] * c[:, 1], -c[:, 0] * s[:, 1], 0 * c[:, 0]], 1)

    def mean(m, C):
        a, b = (_damped(m, C, k * np.array([1.0, sign, 0]), np.sin) for sign in (1, -1))
        return np.stack([(a + b) / 2, (b - a) / 2, 0 * a], 1)

    return Flow("Taylor-Green", velocity, mean)


def abc(k: float) -> Flow:
    """Arnold-Beltrami-Childress with A = B = C = 1: six plane waves along the axes."""

    def velocity(x):
        s, c = np.sin(k * x), np.cos(k * x)
        return np.stack([s[:, 2] + c[:, 1], s[:, 0] + c[:, 2], s[:, 1] + c[:, 0]], 1)

    def mean(m, C):
        s, c = (np.stack([_damped(m, C, k * e, f) for e in np.eye(3)], 1) for f in (np.sin, np.cos))
        return np.stack([s[:, 2] + c[:, 1], s[:, 0] + c[:, 2], s[:, 1] + c[:, 0]], 1)

    return Flow("ABC", velocity, mean)


def gaussian_vortex(width: float) -> Flow:
    """V = (w x X + u) exp(-|X|^2 / (2 width^2)): two Gaussians multiply to a Gaussian, so the mean is closed too."""
    spin = np.array([[0, -3.0, 1], [3, 0, 0.5], [-1, -0.5, 0]])
    u = np.array([0, 0, 0.4])

    def velocity(x):
        return (x @ spin.T + u) * np.exp(-0.5 * np.sum(x**2, 1) / width**2)[:, None]

    def mean(m, C):
        M = np.eye(3) + C / width**2
        centre = np.linalg.solve(M, m[:, :, None])[:, :, 0]
        factor = np.exp(-0.5 * np.sum(m * centre, 1) / width**2) / np.sqrt(np.linalg.det(M))
        return factor[:, None] * (centre @ spin.T + u)

    return Flow("Gaussian vortex", velocity, mean)


def _damped(m, C, wave, function):
    return np.exp(-0.5 * np.einsum("i,nij,j->n", wave, C, wave)) * function(m @ wave)
