"""The random flame that renderer measurements use: a tapering column of anisotropic, faint Gaussians."""

from __future__ import annotations

import numpy as np

from gof.core.cameras import Camera
from gof.core.gaussians import TransientGaussians


def flame(n: int, seed: int = 0) -> TransientGaussians:
    """N static-in-time Gaussians, 1.2 m high; their size shrinks with N so that the cover stays."""
    r = np.random.default_rng(seed)
    height = r.random(n) ** 0.7
    radius = 0.55 * (1 - height) ** 0.6 * (0.35 + height)
    angle, rho = 2 * np.pi * r.random(n), np.sqrt(r.random(n)) * radius
    position = np.stack([rho * np.cos(angle), rho * np.sin(angle), 1.2 * height], -1)
    scale = np.exp(r.normal(np.log(0.0085 * (20_000 / n) ** 0.5), 0.45, (n, 3)))
    return TransientGaussians(
        position,
        np.zeros((n, 3)),
        np.zeros(n),
        np.full(n, np.inf),
        scale,
        r.normal(size=(n, 4)),
        r.uniform(0.02, 0.25, n),
        r.random((n, 3)),
        np.ones(n, bool),
    )


def camera(width: int, height: int) -> Camera:
    """Square pixels; the flame fills the height of the picture."""
    W = np.array([[1, 0, 0, 0], [0, 0, -1, 0.58], [0, 1, 0, 1.5], [0, 0, 0, 1.0]])
    f = 1.2 * height
    return Camera("bench", width, height, [[f, 0, width / 2], [0, f, height / 2], [0, 0, 1]], W)
