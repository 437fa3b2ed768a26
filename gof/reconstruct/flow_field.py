"""The flow field of a clip: per training frame and voxel, how brightly it shines and how fast it moves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gof.host.threads import map_on_cores
from gof.reconstruct.fusion import fuse_frame
from gof.reconstruct.methods import Method
from gof.reconstruct.observation import Observation
from gof.reconstruct.tomography import tomography
from gof.reconstruct.voxels import FlameVoxels, carve


@dataclass(frozen=True)
class FrameField:
    """One training frame on V voxels. Functions that add evidence to it return a new one.

    Attributes:
        time_s: on the dataset clock.
        emission: (V,) >= 0, mean 1 over the frame's hull and 0 outside; all 0 where no flame is seen.
        light: how much the frame's flame shines for each unit of its emission, in a unit of the clip's own.
        light_velocity: (V, 3) world m/s, at which what shines is seen to move; 0 where it is not known.
        velocity: (V, 3) world m/s, of the gas; where that is not known, of the light.
        velocity_sd: (V,) m/s, standard deviation of each component of the gas' velocity; inf where that is unknown.
        known: (V,) bool, where the views say something of the velocity.
        image: (C, H, W, 3) the frame's pictures, display sRGB.
    """

    time_s: float
    emission: np.ndarray
    light: float
    light_velocity: np.ndarray
    velocity: np.ndarray
    velocity_sd: np.ndarray
    known: np.ndarray
    image: np.ndarray


@dataclass(frozen=True)
class FlowField:
    """The training frames of a clip, in order of time, all on the same voxels."""

    voxels: FlameVoxels
    frames: tuple[FrameField, ...]

    @property
    def emission(self) -> np.ndarray:
        """(F, V), a copy."""
        return np.stack([frame.emission for frame in self.frames])

    @property
    def velocity(self) -> np.ndarray:
        """(F, V, 3) m/s, a copy."""
        return np.stack([frame.velocity for frame in self.frames])


def seen_flow_field(
    observation: Observation,
    method: Method,
    longest_side: int,
    progress: Callable[..., None] | None = None,
) -> FlowField:
    """Return the visible motion: hull, emission by tomography, and the cameras' optical flows fused in 3D.

    Args:
        longest_side: voxels along the longest side of the flame's box.
        progress: called with (done, total) after every frame.
    Raises:
        DataFormatError: the flame cannot be placed in space; see `carve`.   GofError: see `fuse_frame`.
    """
    voxels = carve(
        observation.cameras, observation.mask, longest_side, blocked=observation.blocked, vetoes=method.vetoes
    )
    light = frame_light(observation)

    def see(f: int) -> FrameField:
        mask = observation.mask[f]
        emission = tomography(voxels, observation.intensity[f], mask, method.round_flame)
        velocity, known = fuse_frame(voxels, observation.flow[f], mask, emission, method.fusion, method.smooth_voxels)
        unit = float(light[f] / max(emission.sum(), 1.0))
        unsure = np.full(len(emission), np.inf)
        time_s = float(observation.time_s[f])
        return FrameField(time_s, emission, unit, velocity, velocity, unsure, known, observation.image[f])

    return FlowField(voxels, tuple(map_on_cores(see, range(len(observation.frames)), progress)))


def frame_light(observation: Observation) -> np.ndarray:
    """(F,) how bright the flame is in each frame, 1 in the mean; every camera counts alike, a dim one too."""
    seen = observation.intensity.sum((2, 3), dtype=np.float64)
    delivered = observation.delivered
    mean = np.where(delivered, seen, 0).sum(0) / np.maximum(delivered.sum(0), 1)
    relative = np.where(delivered & (mean > 0), seen / np.where(mean > 0, mean, 1), np.nan)
    count = np.isfinite(relative).sum(1)
    return np.where(count > 0, np.nansum(relative, 1) / np.maximum(count, 1), 0)
