"""First Gaussians from the fused flow field (paper, "Dynamic Scene" and "Implementation Details")."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gof.core.errors import DataFormatError
from gof.core.gaussians import TransientGaussians
from gof.core.morton import morton_order
from gof.reconstruct.flame_axis import FlameAxis
from gof.reconstruct.flow_field import FlowField, FrameField
from gof.reconstruct.methods import Seeding

SCALE_MIN, SCALE_MAX = 0.1, 3.0  # bounds of a dynamic Gaussian's std-dev, in voxels (paper)
MIDDLE_GREY = 0.5
HALF = 0.5  # of the voxels of a frame get a seed where they are not drawn by emission (authors of the paper)
LIFETIME_FRAMES = 1.25, 4.0  # bounds of t_sigma in frame times; the paper's is the upper one
CROSSED = 0.4  # of the flame's radius: how far gas goes in a lifetime


def lifetime_s(field: FlowField, frame_time_s: float) -> float:
    """How long the gas goes straight: as long as it takes to cross a good third of the flame's radius.

    A Gaussian that lives longer than the eddies do must be wrong for a part of its life, however its velocity is
    chosen; one that lives much shorter than the time between two frames explains one of them and nothing in between.
    The paper has four frame times always.

    Args:
        frame_time_s: time between frames, s, > 0.
    Returns:
        t_sigma in s, within `LIFETIME_FRAMES` frame times; the longest where nothing known moves or shines.
    """
    shortest, longest = (n * frame_time_s for n in LIFETIME_FRAMES)
    known = replace(field, frames=tuple(replace(f, emission=f.emission * f.known) for f in field.frames))
    axis = FlameAxis.of(known)
    if axis is None:
        return longest
    return float(np.clip(CROSSED * axis.radius / axis.seen_speed, shortest, longest))


def sample_seeds(
    field: FlowField,
    seeding: Seeding,
    t_sigma: float,
    budget: int,
    rng: np.random.Generator,
    light: np.ndarray | None = None,
) -> TransientGaussians:
    """Return Gaussians placed where the velocity is known, moving with the light and given the gas' velocity.

    Args:
        seeding: how many in which voxel, and what they look like.
        t_sigma: of every seed, s, > 0.
        budget: most Gaussians in all, shared among the frames by how many voxels their seeds fill.
        light: (F, V) >= 0, by which seeds are placed instead of the field's emission, in frames that have any: nearer
            together along the rays, it leaves no grains around the flame's foot that are seen from the side alone.
    Raises:
        DataFormatError: no frame has a voxel to seed with a known velocity.
    """
    voxels = field.voxels
    chances = [_chances(frame, seeding, None if light is None else light[f]) for f, frame in enumerate(field.frames)]
    # Effective number of filled voxels (inverse participation ratio): a large flame needs more seeds than a small one.
    extent = np.array([c.sum() ** 2 / (c**2).sum() if c.any() else 0.0 for c in chances])
    if not extent.any():
        raise DataFormatError(
            "no voxel has both emission and a known velocity; are the cameras' frames of the same instants?"
        )
    share = np.floor(budget * extent / extent.sum()).astype(int)
    if not seeding.by_emission:
        share = np.minimum(share, (HALF * extent).astype(int))
    parts = []
    for frame, chance, n in zip(field.frames, chances, share, strict=True):
        if n == 0:
            continue
        chosen = rng.choice(len(chance), n, replace=seeding.by_emission, p=chance / chance.sum())
        position = voxels.center[chosen] + rng.uniform(-0.5, 0.5, (n, 3)) * voxels.voxel_size
        order = morton_order(position)  # within the frame, as those of a frame are drawn together: speed only
        chosen, position = chosen[order], position[order]
        color = np.full((n, 3), MIDDLE_GREY)
        if seeding.seen_color:
            color = np.nanmean(voxels.sample(frame.image, outside=np.nan)[:, chosen], axis=0)
        parts.append(
            TransientGaussians(
                position=position,
                velocity=frame.light_velocity[chosen],
                gas_velocity=frame.velocity[chosen],
                velocity_sd=frame.velocity_sd[chosen],
                t_mu=np.full(n, frame.time_s),
                t_sigma=np.full(n, t_sigma),
                scale=np.full((n, 3), seeding.scale * voxels.voxel_size),
                rotation=np.tile([1.0, 0, 0, 0], (n, 1)),
                opacity=np.full(n, seeding.opacity),
                color=color,
                dynamic=np.ones(n, bool),
            )
        )
    return TransientGaussians.concatenate(parts)


def _chances(frame: FrameField, seeding: Seeding, light: np.ndarray | None) -> np.ndarray:
    """Return (V,) >= 0 how likely each voxel of a frame gets a seed, in any unit."""
    known = frame.known * 1.0
    if not seeding.by_emission:
        return known
    if light is not None and (known * light).any():
        return known * light
    return known * frame.emission
