"""Which flame each voxel belongs to, where several burn side by side.

Seen along the direction in which it moves, a flame is one bright spot, and two are two with a dark gap between them.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import distance_transform_edt, gaussian_filter, label

from gof.reconstruct.voxels import FlameVoxels

GAP = 0.5  # of the fainter one's brightest spot: how dark it must become on the way from flame to flame
LEAST = 0.1  # of all light, in the bright part of each; a spark or a detached tongue has less
FAINTEST = 1 / 256  # of the brightest spot: below this nothing is looked for
SMOOTH = 1.5  # voxels, std-dev


def part_flames(voxels: FlameVoxels, light: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Return the flame that each voxel belongs to, (V,) int from 0 on; all 0 where there is one, or no light.

    Args:
        light: (V,) >= 0, any unit.   direction: (3,) of length 1, along which the flames burn.
    """
    cell, spots = _seen_along(voxels, light, direction)
    flames = _spots(spots)
    if flames.max() <= 1:
        return np.zeros(len(cell), np.int64)
    nearest = distance_transform_edt(flames == 0, return_distances=False, return_indices=True)
    return flames[tuple(nearest)][tuple(cell.T)] - 1


def _seen_along(voxels: FlameVoxels, light: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return each voxel's place (V, 2) in the picture (H, W) of the light, looked at along the direction."""
    across = np.linalg.svd(direction[None])[2][1:]
    place = voxels.center @ across.T / voxels.voxel_size
    margin = round(4 * SMOOTH)
    cell = np.rint(place - place.min(0)).astype(np.int64) + margin
    size = cell.max(0) + margin + 1
    picture = np.bincount(np.ravel_multi_index(tuple(cell.T), size), light, size.prod()).reshape(size)
    return cell, gaussian_filter(picture, SMOOTH)


def _spots(picture: np.ndarray) -> np.ndarray:
    """(H, W) int: 1, 2, ... on the bright parts of the most flames that some level parts, 0 elsewhere."""
    best = (picture > 0).astype(np.int64)
    level = GAP * picture.max()
    while level > FAINTEST * picture.max():
        parts, count = label(picture > level)
        bright = [parts == k for k in range(1, count + 1)]
        flames = [p for p in bright if picture[p].max() * GAP >= level and picture[p].sum() >= LEAST * picture.sum()]
        if len(flames) > best.max():
            best = sum(k * p for k, p in enumerate(flames, 1))
        level /= np.sqrt(2)
    return best
