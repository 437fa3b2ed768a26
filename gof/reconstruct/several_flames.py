"""Separate flames that burn side by side: each has an axis, a radius and a pace of its own.

Seen along the direction in which it moves, a flame is one bright spot, and two are two with a dark gap between them.
The space between two flames is not the core of anything.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import distance_transform_edt, gaussian_filter, label

from gof.reconstruct.flame_axis import FlameAxis
from gof.reconstruct.flow_field import FlowField

GAP = 0.5  # of the fainter one's brightest spot: how dark it must become on the way from flame to flame
LEAST = 0.1  # of all light, in the bright part of each; a spark or a detached tongue has less
FAINTEST = 1 / 256  # of the brightest spot: below this nothing is looked for
SMOOTH = 1.5  # voxels, std-dev


def several_flames(field: FlowField) -> np.ndarray:
    """Return the flame that each voxel belongs to.

    Returns:
        (V,) int from 0 on; all 0 where there is one flame, or nothing moves or shines.
    """
    axis = FlameAxis.of(field)
    if axis is None:
        return np.zeros(len(field.voxels.center), np.int64)
    cell, spots = _seen_along(field, axis.layers.direction)
    flames = _spots(spots)
    if flames.max() == 1:
        return np.zeros(len(cell), np.int64)
    nearest = distance_transform_edt(flames == 0, return_distances=False, return_indices=True)
    return flames[tuple(nearest)][tuple(cell.T)] - 1


def alone(field: FlowField, own: np.ndarray) -> FlowField:
    """Return the field with no other light than that of some voxels (V,) bool."""
    frames = [replace(frame, emission=np.where(own, frame.emission, 0)) for frame in field.frames]
    return replace(field, frames=tuple(frames))


def _seen_along(field: FlowField, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return each voxel's place (V, 2) in the picture (H, W) of the clip's light, looked at along the direction."""
    across = np.linalg.svd(direction[None])[2][1:]
    place = field.voxels.center @ across.T / field.voxels.voxel_size
    margin = round(4 * SMOOTH)
    cell = np.rint(place - place.min(0)).astype(np.int64) + margin
    light = np.mean([frame.emission * frame.light for frame in field.frames], axis=0)
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
