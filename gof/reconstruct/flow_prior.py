"""From the motion that is seen to the motion of the gas: a small learned correction of the fused flow.

Optical flow follows texture. A flame's texture sits in its slow outer layer, the core has none, and the inflow at the
foot moves nothing that could be seen, so the fused flow is too slow by a factor that changes over the flame. How it
changes is much the same from flame to flame. A small network, trained on simulated flames
(`benchmark/training/flow_prior.py`; none of them is a scene of the benchmark), reads it off the shape of the flame and
of the seen flow.

Everything the network sees is a ratio, and what it gives are the coefficients of five vectors that turn with the flame,
so that the result is the same in any unit of length or time and for any heading. The world's z axis must point up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from zipfile import BadZipFile

import numpy as np
from scipy.ndimage import gaussian_filter, gaussian_filter1d

from gof.errors import DataFormatError, GofError
from gof.reconstruct.flow_field import FlowField, FrameField
from gof.reconstruct.voxels import FlameLayers, FlameVoxels, flame_radius

WEIGHTS = Path(__file__).with_name("flow_prior.npz")
FEATURES = (
    "height",
    "radius",
    "radius_here",
    "up",
    "out",
    "sideways_speed",
    "mean_up",
    "mean_out",
    "layer_up",
    "layer_acceleration",
    "brightness_in_layer",
    "mean_brightness_in_layer",
    "brightening_up",
    "brightening_out",
    "widening",
    "slenderness",
)
"""What the network reads of a voxel in a frame. Lengths are over the flame's height or radius, speeds over the RMS of
the seen flow."""
LIMIT = 6.0  # features beyond this say no more; a strange flame must not drive the network far outside its training


@dataclass(frozen=True)
class FlowPrior:
    """An ensemble of two-layer networks from `FEATURES` to the coefficients of the vectors of `describe`.

    Attributes:
        mean, deviation: (K,) of the training features.
        layers: per layer weights (M, in, out) and biases (M, 1, out) of the M members.
    """

    mean: np.ndarray
    deviation: np.ndarray
    layers: Sequence[tuple[np.ndarray, np.ndarray]]

    @classmethod
    def load(cls, path: Path = WEIGHTS) -> FlowPrior:
        """Read weights written by `save`.

        Raises:
            DataFormatError: not such a file, or one trained for other features.
        """
        try:
            data = dict(np.load(path, allow_pickle=False))
        except (OSError, ValueError, BadZipFile) as error:
            raise DataFormatError(f"{path}: cannot read the flow prior's weights ({error})") from error
        try:
            features, count = [str(f) for f in data["features"]], int(data["layers"])
            layers = [(data[f"weight_{i}"], data[f"bias_{i}"]) for i in range(count)]
            prior = cls(data["mean"], data["deviation"], layers)
        except KeyError as missing:
            raise DataFormatError(f"{path}: not the weights of a flow prior ({missing} is missing)") from missing
        if features != list(FEATURES):
            raise DataFormatError(
                f"{path}: trained for other features than this version's; run benchmark/training/flow_prior.py"
            )
        return prior

    def save(self, path: Path) -> None:
        """Write plain arrays (no pickle) to `path`."""
        arrays = {f"weight_{i}": w for i, (w, _) in enumerate(self.layers)}
        arrays |= {f"bias_{i}": b for i, (_, b) in enumerate(self.layers)}
        np.savez_compressed(
            path,
            features=np.array(FEATURES),
            layers=len(self.layers),
            mean=self.mean,
            deviation=self.deviation,
            **arrays,
        )

    def coefficients(self, features: np.ndarray) -> np.ndarray:
        """(..., K) features -> (..., 5) coefficients of the vectors of `describe`, the mean over the ensemble."""
        x = ((features.reshape(-1, features.shape[-1]) - self.mean) / self.deviation).astype(np.float32)[None]
        for weight, bias in self.layers[:-1]:
            x = np.tanh(x @ weight + bias)
        weight, bias = self.layers[-1]
        return (x @ weight + bias).mean(0).reshape(*features.shape[:-1], -1)

    def correct(self, field: FlowField) -> FlowField:
        """The same clip with the velocity of the gas, from the velocity of its texture.

        Args:
            field: fused and smoothed flow, as `seen_flow_field` makes it.
        Returns:
            a new field; velocities are all 0 when nothing in the clip moves or shines.
        Raises:
            GofError: the result is not finite.
        """
        scene = _Scene.of(field)
        frames = []
        for frame in field.frames:  # frame by frame: all features of a clip at once would take gigabytes
            frames.append(replace(frame, velocity=self._gas_velocity(scene, frame)))
        return replace(field, frames=tuple(frames))

    def _gas_velocity(self, scene: _Scene | None, frame: FrameField) -> np.ndarray:
        """(V, 3) m/s."""
        if scene is None:
            return np.zeros_like(frame.velocity)
        features, vectors = scene.describe(frame)
        velocity = np.einsum("vk,vki->vi", self.coefficients(features), vectors)
        if not np.isfinite(velocity).all():
            raise GofError("the flow prior gave NaN or Inf; are velocity and emission finite?")
        return velocity.astype(np.float64)


def describe(field: FlowField) -> tuple[np.ndarray, np.ndarray] | None:
    """What the network reads, and the vectors that it weighs; None where nothing moves or shines at all.

    Returns:
        features (F, V, 16); and vectors (F, V, 5, 3) in m/s: up, outward from the clip's axis, the seen sideways flow,
        along the axis' lean, outward from the frame's axis.
    """
    scene = _Scene.of(field)
    if scene is None:
        return None
    features, vectors = zip(*map(scene.describe, field.frames), strict=True)
    return np.stack(features), np.stack(vectors)


@dataclass(frozen=True)
class _Scene:
    """What a clip has one of: its scales, its mean flow, its axis."""

    voxels: FlameVoxels
    speed: float  # RMS of the seen flow, m/s
    height: np.ndarray  # (V,) over the foot of the flame, in flame heights
    flame_height: float  # m
    flame_radius: float  # m
    layers: FlameLayers
    mean_velocity: np.ndarray  # (V, 3) m/s
    mean_brightness: np.ndarray  # (V,) log, relative to the layer
    layer_up: np.ndarray  # (Z,) m/s
    widening: np.ndarray  # (Z,) d radius / d height
    lean: np.ndarray  # (Z, 2) d axis / d height

    @classmethod
    def of(cls, field: FlowField) -> _Scene | None:
        """None where nothing moves or shines at all."""
        voxels, emission, velocity = field.voxels, field.emission, field.velocity
        total = emission.sum(0, dtype=np.float64)
        energy = (emission[..., None] * velocity**2).sum()
        if not total.any() or energy <= 0:
            return None
        layer, size = voxels.index[:, 2], voxels.voxel_size
        light = np.bincount(layer, total, voxels.resolution[2])
        z = voxels.center[0, 2] + (np.arange(len(light)) - layer[0]) * size
        foot, tip = np.interp((0.02, 0.95), np.cumsum(light) / light.sum(), z)
        flame_height = max(tip - foot, 2 * size)
        layers = FlameLayers.of(voxels, total)
        momentum = (emission[..., None] * velocity).sum(0)
        smooth_light = gaussian_filter1d(light, 2) + 1e-9 * light.max()
        layer_up = gaussian_filter1d(np.bincount(layer, momentum[:, 2], len(light)), 2) / smooth_light
        return cls(
            voxels=voxels,
            speed=float(np.sqrt(energy / total.sum())),
            height=(voxels.center[:, 2] - foot) / flame_height,
            flame_height=flame_height,
            flame_radius=flame_radius(voxels, total),
            layers=layers,
            mean_velocity=momentum / (total + 1e-3 * total.mean())[:, None],
            mean_brightness=_brightness_in_layer(voxels, total / len(emission)),
            layer_up=layer_up,
            widening=_slope(gaussian_filter1d(layers.radius, 3), size),
            lean=_slope(gaussian_filter1d(layers.axis, 3, axis=0), size),
        )

    def describe(self, frame: FrameField) -> tuple[np.ndarray, np.ndarray]:
        """Features (V, 16) and vectors (V, 5, 3) m/s of one frame."""
        voxels, emission, velocity = self.voxels, frame.emission, frame.velocity
        speed, layer = self.speed, voxels.index[:, 2]
        now = FlameLayers.of(voxels, emission) if emission.any() else self.layers
        outward, radius = self._outward(self.layers)
        outward_now, radius_now = self._outward(now)
        gradient = self._log_brightness_gradient(emission)
        sideways = velocity[:, :2]
        features = (
            self.height,
            radius / self.flame_radius,
            radius_now / now.radius[layer],
            velocity[:, 2] / speed,
            (sideways * outward_now).sum(1) / speed,
            np.linalg.norm(sideways, axis=1) / speed,
            self.mean_velocity[:, 2] / speed,
            (self.mean_velocity[:, :2] * outward).sum(1) / speed,
            self.layer_up[layer] / speed,
            _slope(self.layer_up, voxels.voxel_size)[layer] * self.flame_height / speed,
            _brightness_in_layer(voxels, emission),
            self.mean_brightness,
            0.1 * gradient[:, 2] * self.flame_height,
            0.3 * (gradient[:, :2] * outward_now).sum(1) * self.flame_radius,
            self.widening[layer],
            np.full(len(layer), np.log(self.flame_radius / self.flame_height)),
        )
        vectors = np.zeros((len(layer), 5, 3))
        vectors[:, 0, 2] = speed
        vectors[:, 1, :2] = speed * outward
        vectors[:, 2, :2] = sideways
        vectors[:, 3, :2] = self.layer_up[layer, None] * self.lean[layer]
        vectors[:, 4, :2] = speed * outward_now
        return np.clip(np.stack(features, -1), -LIMIT, LIMIT).astype(np.float32), vectors.astype(np.float32)

    def _outward(self, layers: FlameLayers) -> tuple[np.ndarray, np.ndarray]:
        """Direction (V, 2) away from the axis, shrinking to 0 within half a voxel of it, and distance (V,) m."""
        offset = self.voxels.center[:, :2] - layers.axis[self.voxels.index[:, 2]]
        radius = np.linalg.norm(offset, axis=1)
        return offset / np.maximum(radius, 0.5 * self.voxels.voxel_size)[:, None], radius

    def _log_brightness_gradient(self, emission: np.ndarray) -> np.ndarray:
        """(V, 3) 1/m, of the emission smoothed by 1.5 voxels."""
        cells = tuple(self.voxels.index.T)
        grid = np.zeros(self.voxels.resolution)
        grid[cells] = emission
        grid = gaussian_filter(grid, 1.5)
        floor = 1e-2 * grid.max(initial=0)
        if floor == 0:
            return np.zeros((len(emission), 3))
        return np.stack([_slope(np.log(grid + floor), self.voxels.voxel_size, i)[cells] for i in range(3)], -1)


def _slope(values: np.ndarray, step: float, axis: int = 0) -> np.ndarray:
    """Central differences; 0 along an axis of a single cell."""
    return np.gradient(values, step, axis=axis) if values.shape[axis] > 1 else np.zeros_like(values)


def _brightness_in_layer(voxels: FlameVoxels, emission: np.ndarray) -> np.ndarray:
    """(V,) log of the emission relative to the light's own mean in its layer; 0 in a dark frame."""
    floor = 1e-3 * emission.max(initial=0)
    if floor == 0:
        return np.zeros(len(emission))
    layer = voxels.index[:, 2]
    light = np.bincount(layer, emission, voxels.resolution[2])
    square = np.bincount(layer, emission**2, voxels.resolution[2])
    mean = square / np.where(light > 0, light, 1)
    return np.log((emission + floor) / (mean[layer] + floor))
