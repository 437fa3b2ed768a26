"""The flame along its own axis: layers across the direction in which it is seen to move.

A free flame's axis is the vertical; wind tilts it, a jet points anywhere, and a camera rig may be wrong about where up
is. The direction comes from the pictures alone: it is the mean seen velocity of the light.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from gof.reconstruct.flow_field import FlowField
from gof.reconstruct.voxels import LAYERS_POOLED, FlameVoxels

FOOT, TIP = 0.02, 0.95  # shares of the light below them


@dataclass(frozen=True)
class Layers:
    """Layers as thick as a voxel, across a direction.

    Attributes:
        direction: (3,) unit vector.
        along: (V,) place of each voxel along it, in layers, >= 0.
        nearest: (V,) int, the layer that each voxel is nearest to.
        count: S.    thickness: m.
    """

    direction: np.ndarray
    along: np.ndarray
    nearest: np.ndarray
    count: int
    thickness: float

    @classmethod
    def across(cls, direction: np.ndarray, voxels: FlameVoxels) -> Layers:
        """Return the layers that hold all voxels; direction (3,) of length 1."""
        along = voxels.center @ direction / voxels.voxel_size
        along -= along.min()
        nearest = np.rint(along).astype(np.int64)
        return cls(direction, along, nearest, int(along.max()) + 2, voxels.voxel_size)

    def sums(self, values: np.ndarray) -> np.ndarray:
        """(S,) of values (V,), each shared between the two layers that its voxel lies between."""
        low = self.along.astype(np.int64)
        upper = (self.along - low) * values
        return np.bincount(low, values - upper, self.count) + np.bincount(low + 1, upper, self.count)

    def pooled(self, values: np.ndarray) -> np.ndarray:
        """(S,) as `sums`, smoothed along the axis."""
        return gaussian_filter1d(self.sums(values), LAYERS_POOLED)

    def slope(self, values: np.ndarray) -> np.ndarray:
        """d/dm along the axis of (S, ...)."""
        return np.gradient(values, self.thickness, axis=0)

    def sideways(self, vectors: np.ndarray) -> np.ndarray:
        """(..., 3) without their part along the axis."""
        return vectors - (vectors @ self.direction)[..., None] * self.direction


@dataclass(frozen=True)
class CrossSections:
    """Middle (S, 3) and RMS radius (S,) of the light in every layer, m."""

    middle: np.ndarray
    radius: np.ndarray

    @classmethod
    def of(cls, layers: Layers, voxels: FlameVoxels, emission: np.ndarray) -> CrossSections:
        """Emission (V,) must not be all 0. Dark layers take the nearest lit ones' values."""
        light = layers.pooled(emission)
        lit = np.flatnonzero(light > 1e-6 * light.max())
        at = np.arange(layers.count)

        def mean(values: np.ndarray) -> np.ndarray:
            return np.interp(at, lit, layers.pooled(emission * values)[lit] / light[lit])

        middle = np.stack([mean(axis) for axis in voxels.center.T], -1)
        offset = layers.sideways(voxels.center - middle[layers.nearest])
        radius = np.sqrt(np.maximum(mean((offset**2).sum(1)), 0))
        return cls(middle, np.maximum(radius, 0.5 * layers.thickness))


@dataclass(frozen=True)
class FlameAxis:
    """A clip's flame along its axis.

    Attributes:
        layers: across the mean seen velocity.    sections: of the clip's light.
        mean_light: (S,) of every layer over the frames, any unit.
        foot, length: where the flame begins and how far it reaches, m along the axis from the lowest layer.
        radius: RMS distance of the light from the middle of its layer, m.
        seen_speed: RMS of the seen velocity, weighted by emission, m/s.
    """

    layers: Layers
    sections: CrossSections
    mean_light: np.ndarray
    foot: float
    length: float
    radius: float
    seen_speed: float

    @classmethod
    def of(cls, field: FlowField) -> FlameAxis | None:
        """None where nothing moves or shines, or where what is seen to move goes nowhere in the mean."""
        voxels, emission, velocity = field.voxels, field.emission, field.velocity
        momentum = (emission[..., None] * velocity).sum((0, 1))
        energy = (emission[..., None] * velocity**2).sum()
        speed = float(np.linalg.norm(momentum))
        if not energy > 0 or not speed > 1e-6 * np.sqrt(energy * emission.sum()):
            return None
        layers = Layers.across(momentum / speed, voxels)
        total = emission.sum(0, dtype=np.float64)
        sections = CrossSections.of(layers, voxels, total)
        mean_light = layers.sums(np.mean([frame.emission * frame.light for frame in field.frames], axis=0))
        share = np.cumsum(mean_light) / mean_light.sum()
        foot, tip = np.interp((FOOT, TIP), share, np.arange(layers.count) * layers.thickness)
        return cls(
            layers=layers,
            sections=sections,
            mean_light=mean_light,
            foot=float(foot),
            length=float(max(tip - foot, 2 * layers.thickness)),
            radius=float(np.sqrt((mean_light * sections.radius**2).sum() / mean_light.sum())),
            seen_speed=float(np.sqrt(energy / emission.sum())),
        )
