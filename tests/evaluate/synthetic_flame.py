"""A small dataset whose reconstruction is known: a swirling plume of Gaussians, drawn into every picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gof.core.fields import VelocityField
from gof.core.gaussians import TransientGaussians
from gof.render import render
from tests.conftest import arc, write_dataset


def plume(points: np.ndarray) -> np.ndarray:
    """A rising, swirling flow, m/s: (M, 3) world metres to (M, 3)."""
    x, y, z = points.T
    return np.stack([-2 * y - 0.2 * x, 2 * x - 0.2 * y, 0.6 + 0.8 * z * np.exp(-4 * (x**2 + y**2))], 1)


def flame_gaussians(n=300, duration_s=0.08, seed=0) -> TransientGaussians:
    rng = np.random.default_rng(seed)
    height = rng.uniform(0.5, 1.5, n)
    position = np.stack([*(rng.normal(0, 0.12, (2, n)) * (1.8 - height)), height], 1)
    warmth = np.clip((1.6 - height) + rng.normal(0, 0.1, n), 0.1, 1)
    return TransientGaussians(
        position=position,
        velocity=plume(position),
        t_mu=rng.uniform(0, duration_s, n),
        t_sigma=np.full(n, 0.02),
        scale=rng.uniform(0.015, 0.04, (n, 3)),
        rotation=rng.normal(size=(n, 4)),
        opacity=rng.uniform(0.2, 0.6, n),
        color=np.stack([0.6 + 0.4 * warmth, 0.25 + 0.6 * warmth, 0.05 + 0.3 * warmth**2], 1),
        dynamic=np.ones(n, bool),
    )


def flame_dataset(folder: Path, frames=9, velocity=True, masks=True) -> TransientGaussians:
    """Write the dataset (2 cameras, 9 frames, frame 4 held out) and return the Gaussians that made its pictures."""
    times = 0.01 * np.arange(frames)
    truth = flame_gaussians()
    cameras = arc(2, width=48, height=80, focal_px=110.0)
    rng = np.random.default_rng(1)
    plates = [np.clip(np.linspace(0.1, 0.3, 80)[:, None, None] + 0.05 * rng.random((80, 48, 3)), 0, 1) for _ in cameras]
    drawn = [
        [render(truth, c, t, background=np.round(p * 255) / 255) for c, p in zip(cameras, plates, strict=True)]
        for t in times
    ]
    size, low = 0.05, np.array([-0.8, -0.8, 0.2])
    grid = VelocityField.from_array(np.zeros((32, 32, 32, 3), np.float32), low, size)
    flow = plume(grid.cell_centers().reshape(-1, 3)).reshape(32, 32, 32, 3).astype(np.float32)
    fields = [VelocityField.from_array(flow, low, size, float(t)) for t in times] if velocity else None
    write_dataset(
        folder,
        cameras,
        [[d["color"] for d in row] for row in drawn],
        plates,
        times,
        fields,
        masks=[[d["alpha"] > 0.02 for d in row] for row in drawn] if masks else None,
        test_frames=[k for k in range(frames) if k % 8 == 4],
    )
    return truth
