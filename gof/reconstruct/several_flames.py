"""Separate flames that burn side by side: each has an axis, a radius and a pace of its own.

The space between two flames is not the core of anything.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gof.reconstruct.flame_axis import FlameAxis
from gof.reconstruct.flow_field import FlowField
from gof.reconstruct.spots import part_flames


def several_flames(field: FlowField) -> np.ndarray:
    """Return the flame that each voxel belongs to.

    Returns:
        (V,) int from 0 on; all 0 where there is one flame, or nothing moves or shines.
    """
    axis = FlameAxis.of(field)
    if axis is None:
        return np.zeros(len(field.voxels.center), np.int64)
    light = np.mean([frame.emission * frame.light for frame in field.frames], axis=0)
    return part_flames(field.voxels, light, axis.layers.direction)


def alone(field: FlowField, own: np.ndarray) -> FlowField:
    """Return the field with no other light than that of some voxels (V,) bool."""
    frames = [replace(frame, emission=np.where(own, frame.emission, 0)) for frame in field.frames]
    return replace(field, frames=tuple(frames))
