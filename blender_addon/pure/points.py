"""Gaussians at an instant as plain points: what programs take that know points with attributes, and nothing of ours.

Names of splats' attributes are those that Blender 5.3 reads (its release notes of November 2026): "scale", "rotation"
and "radiance:base", which holds the constant spherical harmonic and the opacity.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..core.harmonics import C0
from .io.cloud import GaussianCloud
from .voxels import FAINT, linear, state_at


@dataclass(frozen=True)
class Points:
    """M Gaussians that are seen at an instant; float32 unless said otherwise.

    Attributes:
        row: (M,) int64, the Gaussian's number in its file: the same at all times.
        position: (M, 3) m.     velocity: (M, 3) m/s, of the light: how the point moves.
        gas_velocity: (M, 3) m/s, of the gas that shines there.
        scale: (M, 3) m, standard deviations.     rotation: (M, 4) unit quaternion wxyz.
        color: (M, 3) linear light.     opacity: (M,) at this instant.
        radiance: (M, 4) constant spherical harmonic of display red, green and blue, and the opacity.
    """

    row: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    gas_velocity: np.ndarray
    scale: np.ndarray
    rotation: np.ndarray
    color: np.ndarray
    opacity: np.ndarray
    radiance: np.ndarray

    def __len__(self) -> int:
        return len(self.row)

    @property
    def width(self) -> np.ndarray:
        """(M,) m, diameter of the ball of one standard deviation and the Gaussian's volume."""
        return 2 * np.cbrt(self.scale.prod(axis=1, dtype=np.float64)).astype(np.float32)


def at(cloud: GaussianCloud, time_s: float, least: float = FAINT, time_scale: float = 1.0) -> Points:
    """Return the Gaussians of which at least an opacity `least` is left at a time.

    Args:
        time_scale: how many seconds of the recording pass in one of whoever looks; velocities are on that clock.
    """
    place, opacity = state_at(cloud, time_s)
    seen = np.flatnonzero((opacity >= least) & np.isfinite(place).all(axis=1))
    moving = cloud.dynamic[seen, None] * np.float32(time_scale)
    color, left = cloud.color[seen].astype(np.float64), opacity[seen]
    return Points(
        seen,
        place[seen].astype(np.float32),
        cloud.velocity[seen] * moving,
        cloud.moving_gas[seen] * np.float32(time_scale),
        cloud.scale[seen],
        cloud.rotation[seen],
        linear(color).astype(np.float32),
        left.astype(np.float32),
        np.column_stack([(color - 0.5) / C0, left]).astype(np.float32),
    )
