"""First Gaussians from the fused flow field (paper, "Dynamic Scene" and "Implementation Details")."""

from __future__ import annotations

import numpy as np

from gof.errors import DataFormatError
from gof.gaussians import TransientGaussians
from gof.reconstruct.flow_prior import flame_radius
from gof.reconstruct.voxels import FlameVoxels

SCALE_MIN, SCALE_MAX = 0.1, 3.0  # bounds of a dynamic Gaussian's std-dev, in voxels (paper)
SCALE_INITIAL = 0.7  # in voxels: neighbouring seeds overlap
LIFETIME_FRAMES = 1.25, 4.0  # bounds of t_sigma in frame times; the paper's is the upper one
CROSSING = 0.4  # of the flame's radius: how far gas goes in a lifetime


def lifetime_s(voxels: FlameVoxels, frames: list[dict], frame_time_s: float) -> float:
    """How long the gas goes straight: as long as it takes to cross a good third of the flame's radius.

    A Gaussian that lives longer than the eddies do must be wrong for a part of its life, however its velocity is chosen; one that
    lives much shorter than the time between two frames holds for one of them, and for nothing in between. The paper has four frame
    times always.

    Args:
        frames: per training frame {"emission" (V,) >= 0, "velocity" (V, 3) m/s, "known" (V,) bool}.
        frame_time_s: time between frames, s, > 0.
    Returns:
        t_sigma in s, within `LIFETIME_FRAMES` frame times; the longest where nothing known moves or shines.
    """
    emission = np.stack([f["emission"] * f["known"] for f in frames])
    energy = sum((e[:, None] * f["velocity"] ** 2).sum() for e, f in zip(emission, frames, strict=True))
    low, high = (n * frame_time_s for n in LIFETIME_FRAMES)
    if not energy > 0:
        return high
    speed = np.sqrt(energy / emission.sum())
    return float(np.clip(CROSSING * flame_radius(voxels, emission.sum(0)) / speed, low, high))


def sample_seeds(
    voxels: FlameVoxels, frames: list[dict], t_sigma: float, budget: int, opacity: float, rng: np.random.Generator
) -> TransientGaussians:
    """Gaussians placed where each frame's emission is, moving with the fused flow.

    Args:
        frames: per training frame {"time_s", "density" (V,) of seeds, any unit, >= 0, "velocity" (V, 3) m/s, "known" (V,) bool,
            "image" (C, H, W, 3) display values}.
        t_sigma: of every seed, s, > 0.
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
                t_sigma=np.full(n, t_sigma),
                scale=np.full((n, 3), SCALE_INITIAL * voxels.voxel_size),
                rotation=np.tile([1.0, 0, 0, 0], (n, 1)),
                opacity=np.full(n, opacity),
                color=np.nanmean(sampled, axis=0),
                dynamic=np.ones(n, bool),
            )
        )
    return TransientGaussians.concatenate(parts)
