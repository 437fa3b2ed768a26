"""The logarithm of a flame's light on its voxels: what its slopes and changes say does not depend on exposure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter

from gof.reconstruct.flow_field import FlowField
from gof.reconstruct.voxels import FlameVoxels

DARK = 1e-2  # of the clip's brightest voxel: below, the logarithm no longer falls


@dataclass(frozen=True)
class LogLight:
    """Log light of every frame of a clip. At least one voxel must shine.

    Attributes:
        dark: light added everywhere, so that the logarithm has no bad point; > 0.
    """

    field: FlowField
    dark: float

    @classmethod
    def of(cls, field: FlowField) -> LogLight:
        return cls(field, DARK * max(float((frame.emission * frame.light).max()) for frame in field.frames))

    def grid(self, f: int, width: float) -> np.ndarray:
        """(X, Y, Z) of frame f, whose light is smoothed by a Gaussian with a std-dev of `width` voxels."""
        frame, voxels = self.field.frames[f], self.field.voxels
        light = np.zeros(voxels.resolution)
        light[tuple(voxels.index.T)] = frame.emission * frame.light
        return np.log(gaussian_filter(light, width) + self.dark)


def slope(grid: np.ndarray, voxels: FlameVoxels) -> np.ndarray:
    """(V, 3) 1/m, central differences of a grid (X, Y, Z) at the voxels; 0 along an axis of a single cell."""
    cells = tuple(voxels.index.T)
    flat = np.zeros(len(voxels.index))
    return np.stack(
        [np.gradient(grid, voxels.voxel_size, axis=i)[cells] if grid.shape[i] > 1 else flat for i in range(3)], -1
    )
