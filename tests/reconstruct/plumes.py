"""Flow fields of made-up plumes, on voxels that no camera carved."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gof.reconstruct.flow_field import FlowField, FrameField
from gof.reconstruct.voxels import FlameVoxels


def box_of_voxels(resolution: tuple[int, int, int], voxel_m: float) -> FlameVoxels:
    """All voxels of an upright box whose floor is z = 0 and whose middle stands on the z axis."""
    index = np.stack(np.meshgrid(*map(np.arange, resolution), indexing="ij"), -1).reshape(-1, 3)
    center = (index + 0.5 - [resolution[0] / 2, resolution[1] / 2, 0]) * voxel_m
    return FlameVoxels(center, voxel_m, index, np.array(resolution), np.empty(0), np.empty(0), np.empty(0))


def field_of(voxels, velocity, emission, frame_s: float = 0.01) -> FlowField:
    """Frames of velocity (F, V, 3) and emission (F, V), without pictures; a unit of emission shines alike in all."""
    known = np.ones(len(voxels.center), bool)
    unsure = np.full(len(voxels.center), np.inf)
    frames = [
        FrameField(frame_s * f, emission[f], 1.0, velocity[f], velocity[f], unsure, known, np.empty(0))
        for f in range(len(velocity))
    ]
    return FlowField(voxels, tuple(frames))


def plume(size: float = 1.0) -> FlowField:
    """A leaning, swirling, accelerating plume on 12 x 12 x 30 voxels, three frames; lengths times `size`."""
    voxels = box_of_voxels((12, 12, 30), 0.05 * size)
    x, y, z = voxels.center.T / size
    emission = [np.exp(-((x - 0.1 * z - 0.02 * f) ** 2 + y**2) / 0.02 - (z - 0.5) ** 2 / 0.2) for f in range(3)]
    velocity = np.stack([-y - 0.1 * x, x - 0.1 * y, 0.5 + z], -1) * size
    return field_of(voxels, [velocity * (1 + 0.1 * f) for f in range(3)], emission)


def changed(field: FlowField, **by) -> FlowField:
    """The field with functions applied to values of its frames and, by "voxels", to its voxels."""
    voxels = by.pop("voxels", lambda same: same)(field.voxels)
    frames = [replace(frame, **{name: f(getattr(frame, name)) for name, f in by.items()}) for frame in field.frames]
    return FlowField(voxels, tuple(frames))
