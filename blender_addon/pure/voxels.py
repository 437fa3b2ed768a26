"""Gaussians at an instant as grids: what a renderer of volumes shows, and the velocity of what is seen.

A Gaussian of opacity alpha and colour c, seen alone, adds alpha * c to a picture at its centre. So it shines with

    e(x) = alpha(t) c g(x) / (sqrt(2 pi) s)        per metre,   g(x) = exp(-0.5 |R^T (x - x(t)) / scale|^2)

where s is the geometric mean of its three standard deviations: along a ray through the centre of a round one the
integral is alpha * c; of others it is in the mean. Gaussians add up and hide nothing, as fire does. Velocity is a mean
of the Gaussians' at a voxel, weighted by alpha g / s.
"""

from __future__ import annotations

import numpy as np

from ..core.rotations import rotation_matrices
from .io.cloud import GaussianCloud

REACH = 3.0  # standard deviations; what is farther away is left out
FAINT = 1 / 255
MOST_VOXELS = 2**27  # of the whole box: two grids of three floats are 3 GB


class VoxelError(ValueError):
    """No grid can be made; the message says what to change."""


def linear(display: np.ndarray) -> np.ndarray:
    """Display sRGB in [0, 1] as linear light."""
    display = np.clip(display, 0, None)
    return np.where(display <= 0.04045, display / 12.92, ((display + 0.055) / 1.055) ** 2.4)


def state_at(cloud: GaussianCloud, time_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Places (N, 3) float64 and opacities (N,) at a time."""
    age = np.where(cloud.dynamic, time_s - cloud.t_mu.astype(np.float64), 0.0)
    opacity = cloud.opacity * np.exp(-0.5 * (age / cloud.t_sigma.astype(np.float64)) ** 2)  # age / inf is 0
    if cloud.begin is not None:
        opacity = opacity * ((cloud.begin <= time_s) & (time_s < cloud.end))
    return cloud.position + age[:, None] * cloud.velocity.astype(np.float64), opacity


def box_of(cloud: GaussianCloud, times_s: np.ndarray, voxel_m: float) -> tuple[np.ndarray, tuple[int, int, int]]:
    """Return the box around all that is seen at some times: its lowest corner, a multiple of the voxel, and its voxels.

    Raises VoxelError: nothing is seen, or more voxels than MOST_VOXELS.
    """
    lows, highs = [], []
    for time_s in times_s:
        place, opacity = state_at(cloud, float(time_s))
        seen = opacity >= FAINT
        if seen.any():
            reach = REACH * cloud.scale[seen].max(axis=1, keepdims=True)
            lows.append(np.percentile(place[seen] - reach, 0.1, axis=0))  # without the runaways
            highs.append(np.percentile(place[seen] + reach, 99.9, axis=0))
    if not lows:
        raise VoxelError("nothing is visible in these frames; fit the scene's frame range to the clip")
    low = np.floor(np.min(lows, axis=0) / voxel_m)
    count = np.ceil(np.max(highs, axis=0) / voxel_m) - low
    if not np.isfinite(count).all() or count.prod() > MOST_VOXELS:
        size = (count * voxel_m).prod() if np.isfinite(count).all() else np.inf
        raise VoxelError(
            f"{count.prod():.3g} voxels are too many; make them {np.cbrt(size / MOST_VOXELS):.2g} m or more"
        )
    return low * voxel_m, tuple(int(side) for side in np.maximum(count, 1))


def grids_at(
    cloud: GaussianCloud, time_s: float, low: np.ndarray, shape: tuple[int, int, int], voxel_m: float
) -> dict[str, np.ndarray]:
    """Grids at voxel centres: "emission" (X, Y, Z, 3) linear light per metre, "density" (X, Y, Z) opacity per metre,
    "velocity" (X, Y, Z, 3) m/s, 0 where nothing is seen.

    Gaussians thinner than a voxel are widened to half of one, with as much light as before.
    """
    place, opacity = state_at(cloud, time_s)
    emission, density = np.zeros((*shape, 3)), np.zeros(shape)
    momentum, colour = np.zeros((*shape, 3)), linear(cloud.color.astype(np.float64))
    velocity = cloud.moving_gas
    for row in np.flatnonzero(opacity >= FAINT):
        scale = cloud.scale[row].astype(np.float64)
        wide = np.maximum(scale, voxel_m / 2)
        turn = rotation_matrices(cloud.rotation[row][None])[0]
        half = REACH * np.sqrt((turn**2 * wide**2).sum(axis=1))
        first = np.maximum(np.floor((place[row] - half - low) / voxel_m), 0).astype(int)
        last = np.minimum(np.ceil((place[row] + half - low) / voxel_m), shape).astype(int)
        if (first >= last).any():
            continue
        axes = [low[a] + voxel_m * (np.arange(first[a], last[a]) + 0.5) - place[row, a] for a in range(3)]
        squared = sum(
            ((turn[0, k] * axes[0][:, None, None] + turn[1, k] * axes[1][:, None] + turn[2, k] * axes[2]) / wide[k])
            ** 2
            for k in range(3)
        )
        thinned = scale.prod() / wide.prod()
        weight = opacity[row] * thinned / (np.sqrt(2 * np.pi) * np.cbrt(scale.prod())) * np.exp(-0.5 * squared)
        weight[squared > REACH**2] = 0.0
        window = tuple(slice(a, b) for a, b in zip(first, last, strict=True))
        density[window] += weight
        emission[window] += weight[..., None] * colour[row]
        momentum[window] += weight[..., None] * velocity[row]
    mean = np.divide(momentum, density[..., None], out=np.zeros_like(momentum), where=density[..., None] > 0)
    return {
        name: grid.astype(np.float32)
        for name, grid in (("emission", emission), ("density", density), ("velocity", mean))
    }


def index_to_world(low: np.ndarray, voxel_m: float) -> np.ndarray:
    """Return (4, 4) continuous voxel index (voxel i spans [i, i + 1]) to the recording's world, metres."""
    matrix = np.diag([voxel_m, voxel_m, voxel_m, 1.0])
    matrix[:3, 3] = low
    return matrix
