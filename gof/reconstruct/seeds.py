"""First Gaussians from the fused flow field (paper, "Dynamic Scene" and "Implementation Details")."""

from __future__ import annotations

import numpy as np

from gof.errors import DataFormatError
from gof.gaussians import TransientGaussians
from gof.reconstruct.voxels import FlameVoxels

SCALE_MIN, SCALE_MAX = 0.1, 3.0  # bounds of a dynamic Gaussian's std-dev, in voxels (paper)
SCALE_INITIAL = 0.7  # in voxels: neighbouring seeds overlap
LIFETIME_FRAMES = 4.0  # t_sigma in frame times (paper)


def sample_seeds(
    voxels: FlameVoxels, frames: list[dict], frame_time_s: float, budget: int, opacity: float, rng: np.random.Generator
) -> TransientGaussians:
    """Gaussians placed where each frame's emission is, moving with the fused flow.

    Args:
        frames: per training frame {"time_s", "density" (V,) of seeds, any unit, >= 0, "velocity" (V, 3) m/s, "known" (V,) bool,
            "image" (C, H, W, 3) display values}.
        frame_time_s: time between frames, > 0 (sets the lifetime).
        budget: number of Gaussians in all, shared among the frames by how many voxels their density fills.
        opacity: initial opacity, 0..1.
    Raises:
        DataFormatError: no frame has a voxel with density and a known velocity.
    """
    chance = [np.where(f["known"], f["density"], 0.0) for f in frames]
    # Effective number of filled voxels (inverse participation ratio): a large flame needs more seeds than a small one.
    extent = np.array([c.sum() ** 2 / (c**2).sum() if c.any() else 0.0 for c in chance])
    if not extent.any():
        raise DataFormatError(
            "no voxel has both emission and a known velocity; are the cameras' frames of the same instants?"
        )
    share = np.floor(budget * extent / extent.sum()).astype(int)
    parts = []
    for frame, c, n in zip(frames, chance, share, strict=True):
        if n == 0:
            continue
        chosen = rng.choice(len(c), n, p=c / c.sum())
        position = voxels.center[chosen] + rng.uniform(-0.5, 0.5, (n, 3)) * voxels.voxel_size
        sampled = voxels.sample(frame["image"], outside=np.nan)[:, chosen]
        parts.append(
            TransientGaussians(
                position=position,
                velocity=frame["velocity"][chosen],
                t_mu=np.full(n, frame["time_s"]),
                t_sigma=np.full(n, LIFETIME_FRAMES * frame_time_s),
                scale=np.full((n, 3), SCALE_INITIAL * voxels.voxel_size),
                rotation=np.tile([1.0, 0, 0, 0], (n, 1)),
                opacity=np.full(n, opacity),
                color=np.nanmean(sampled, axis=0),
                dynamic=np.ones(n, bool),
            )
        )
    return TransientGaussians.concatenate(parts)
