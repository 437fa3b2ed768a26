"""From the motion that is seen to that of the gas: a small learned correction of the fused flow, with its uncertainty.

Optical flow follows texture. A flame's texture sits in its slow outer layer, the core has none, and the inflow at the
foot moves nothing that could be seen, so the fused flow is too slow by a factor that changes over the flame and from
flame to flame. Two questions are answered apart:

- How fast is the flame as a whole? One number a clip, so there are as many examples as flames: a line (`pace`).
- How is that speed spread over the flame? Hundreds of thousands of voxels are examples: a small network, which reads
  the fused flow and the light around a voxel, all of it relative.

Both are fitted to simulated flames of two solvers (`benchmark/training/flow_prior.py`; none of them is a scene or a
test fire of the benchmark). A network that answers both at once learns its few flames' paces by heart.

The network gives the coefficients of five vectors that turn with the flame and its axis, so that the result
is the same for any heading, and without knowing which way is up. Gravity, up and metres enter through the pace alone;
with `metres=False` the result is the same in any unit of length or time, and on its side.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from gof.core.errors import DataFormatError, GofError
from gof.core.npz import read_npz
from gof.host.threads import map_on_cores
from gof.reconstruct.flame_axis import CrossSections, FlameAxis
from gof.reconstruct.flow_field import FlowField, FrameField
from gof.reconstruct.log_light import LogLight, slope
from gof.reconstruct.mean_speed import USUAL, MeanSpeed, SpeedClues
from gof.reconstruct.several_flames import alone, several_flames

WEIGHTS = Path(__file__).with_name("flow_prior.npz")
FEATURES = (
    "height",
    "radius",
    "radius_in_widths",
    "radius_now",
    "width_now",
    "width",
    "seen_along",
    "seen_out",
    "seen_sideways",
    "mean_seen_along",
    "mean_seen_out",
    "layer_seen_along",
    "brightness_in_layer",
    "mean_brightness_in_layer",
    "brightening_along",
    "brightening_out",
    "coarse_brightening_along",
    "coarse_brightening_out",
    "brightening_in_time",
    "widening",
)
"""Inputs of the network for a voxel in a frame. Lengths are over the flame's length or radius, speeds over the mean
seen speed, times over the time in which what is seen crosses a radius. Nothing is the same all over a clip: by such
numbers a network would know its flames again."""
VOXELS = 72  # along the longest side of the flame's box: the flow fields that it learns from, and corrects
VECTORS = 5
LIMIT = 6.0  # features beyond this say no more; a strange flame must not drive the network far outside its training
FINE, COARSE = 1.5, 4.0  # voxels, std-dev of the brightness whose slopes are features

Network = Sequence[tuple[np.ndarray, np.ndarray]]
"""Weights (M, in, out) and biases (M, 1, out) of M members, layer by layer; tanh between the layers."""


def evaluate_network(network: Network, x: np.ndarray) -> np.ndarray:
    """(M, N, out) float32 of scaled features (N, K)."""
    h = x.astype(np.float32)[None]
    for weight, bias in network[:-1]:
        h = np.tanh(h @ weight + bias)
    weight, bias = network[-1]
    return h @ weight + bias


@dataclass(frozen=True)
class FlowPrior:
    """An ensemble of small networks from `FEATURES` to the coefficients of the vectors of `FlameDescriber`.

    Attributes:
        mean, deviation: (K,) of the training features.
        velocity: the ensemble; its last layer gives `VECTORS` coefficients.
        uncertainty: one network; log of the standard deviation of a velocity component, over the pace, learned from
            flames that neither pace nor ensemble had been fitted to.
        pace: how fast flames are as a whole.
    """

    mean: np.ndarray
    deviation: np.ndarray
    velocity: Network
    uncertainty: Network
    pace: MeanSpeed

    @classmethod
    def load(cls, path: Path = WEIGHTS) -> FlowPrior:
        """Read weights written by `save`.

        Raises:
            DataFormatError: not such a file, or one trained for other features.
        """
        data = read_npz(path)
        try:
            features = [str(f) for f in data["features"]]
            prior = cls(
                data["mean"],
                data["deviation"],
                _network(data, "velocity"),
                _network(data, "uncertainty"),
                MeanSpeed(data["pace_metric"], data["pace_unitless"]),
            )
        except KeyError as missing:
            raise DataFormatError(f"{path}: not the weights of a flow prior ({missing} is missing)") from missing
        if features != list(FEATURES) or len(prior.pace.metric) != 1 + len(USUAL):
            raise DataFormatError(
                f"{path}: trained for other features than this version's; run benchmark/training/flow_prior.py"
            )
        return prior

    def save(self, path: Path) -> None:
        """Write plain arrays (no pickle) to `path`."""
        arrays = {}
        for name, network in (("velocity", self.velocity), ("uncertainty", self.uncertainty)):
            arrays[f"{name}_layers"] = np.array(len(network))
            for i, (weight, bias) in enumerate(network):
                arrays |= {f"{name}_weight_{i}": weight, f"{name}_bias_{i}": bias}
        arrays |= {"pace_metric": self.pace.metric, "pace_unitless": self.pace.unitless}
        np.savez_compressed(path, features=np.array(FEATURES), mean=self.mean, deviation=self.deviation, **arrays)

    def correct(self, field: FlowField, metres: bool = True) -> FlowField:
        """Return the same clip with the velocity of the gas, and its uncertainty, from the apparent motion.

        Args:
            field: fused and smoothed flow, as `seen_flow_field` makes it.
            metres: whether its lengths are metres and its times seconds, so that gravity says how fast hot gas rises.
        Returns:
            a new field; all 0 and without any certainty when nothing in the clip moves or shines.
        Raises:
            GofError: the result is not finite.
        """
        flame = several_flames(field)
        apart = {k: FlameDescriber.of(alone(field, flame == k)) for k in range(flame.max() + 1)}
        flames = {k: describer for k, describer in apart.items() if describer is not None}
        clues = [SpeedClues.of(describer.axis, describer.log_light) for describer in flames.values()]
        paces = self.pace.side_by_side(clues, metres)

        def correct_frame(f: int) -> FrameField:  # all features of a clip at once would take gigabytes
            frame = field.frames[f]
            velocity, sd = np.zeros(frame.velocity.shape), np.full(len(flame), np.inf)
            for (k, describer), pace in zip(flames.items(), paces, strict=True):
                gas, uncertainty = self._gas(describer, pace, f)
                velocity[flame == k], sd[flame == k] = gas[flame == k], uncertainty[flame == k]
            return replace(frame, velocity=velocity, velocity_sd=sd)

        return replace(field, frames=tuple(map_on_cores(correct_frame, range(len(field.frames)))))

    def _gas(self, describer: FlameDescriber, pace: float, f: int) -> tuple[np.ndarray, np.ndarray]:
        """Velocity (V, 3) of the gas in frame f and its standard deviation (V,), m/s."""
        features, vectors = describer.describe(f)
        x = (features - self.mean) / self.deviation
        members = np.einsum("mvk,vki->mvi", evaluate_network(self.velocity, x), vectors)
        sd = pace * np.exp(evaluate_network(self.uncertainty, x)[0, :, 0])
        velocity = pace * members.mean(0, dtype=np.float64)
        if not (np.isfinite(velocity).all() and np.isfinite(sd).all()):
            raise GofError("the flow prior gave NaN or Inf; are velocity and emission finite?")
        return velocity, sd.astype(np.float64)


def _network(data: dict[str, np.ndarray], name: str) -> Network:
    return [(data[f"{name}_weight_{i}"], data[f"{name}_bias_{i}"]) for i in range(int(data[f"{name}_layers"]))]


@dataclass(frozen=True)
class FlameDescriber:
    """Inputs of the network, and the vectors that it weighs.

    Attributes:
        mean_velocity: (V, 3) seen, m/s.    mean_brightness: (V,) log, relative to the layer.
        layer_seen: (S,) seen speed along the axis, m/s.
    """

    field: FlowField
    axis: FlameAxis
    log_light: LogLight
    mean_velocity: np.ndarray
    mean_brightness: np.ndarray
    layer_seen: np.ndarray

    @classmethod
    def of(cls, field: FlowField) -> FlameDescriber | None:
        """None where nothing moves or shines at all."""
        axis = FlameAxis.of(field)
        if axis is None:
            return None
        emission = field.emission
        total = emission.sum(0, dtype=np.float64)
        momentum = (emission[..., None] * field.velocity).sum(0)
        layers = axis.layers
        light = layers.pooled(total)
        return cls(
            field=field,
            axis=axis,
            log_light=LogLight.of(field),
            mean_velocity=momentum / (total + 1e-3 * total.mean())[:, None],
            mean_brightness=_brightness_in_layer(axis, total / len(emission)),
            layer_seen=layers.pooled(momentum @ layers.direction) / (light + 1e-9 * light.max()),
        )

    def describe(self, f: int) -> tuple[np.ndarray, np.ndarray]:
        """Features (V, K) and vectors (V, 5, 3) of frame f; lengths of vectors are over the pace of the flame.

        The vectors: along the axis; outward from the frame's own axis; the seen motion across the axis; along the lean
        of the clip's axis; outward from the clip's axis.
        """
        from scipy.ndimage import gaussian_filter1d  # here: it takes long to load

        axis, layers, layer, speed = self.axis, self.axis.layers, self.axis.layers.nearest, self.axis.seen_speed
        frame = self.field.frames[f]
        emission = frame.emission
        now = CrossSections.of(layers, self.field.voxels, emission) if emission.any() else axis.sections
        outward, radius = self._outward_of_clip
        outward_now, radius_now = self._outward(now)
        across = layers.sideways(frame.velocity)
        fine, coarse = (slope(self.log_light.grid(f, width), self.field.voxels) for width in (FINE, COARSE))
        length, width = axis.length, axis.radius
        features = (
            (layers.along * layers.thickness - axis.foot) / length,
            radius / width,
            radius / np.sqrt(width * length),
            radius_now / now.radius[layer],
            np.log(now.radius / width)[layer],
            np.log(axis.sections.radius / width)[layer],
            frame.velocity @ layers.direction / speed,
            (across * outward_now).sum(1) / speed,
            np.linalg.norm(across, axis=1) / speed,
            self.mean_velocity @ layers.direction / speed,
            (self.mean_velocity * outward).sum(1) / speed,
            self.layer_seen[layer] / speed,
            _brightness_in_layer(axis, emission),
            self.mean_brightness,
            0.1 * length * (fine @ layers.direction),
            0.3 * width * (fine * outward_now).sum(1),
            0.1 * length * (coarse @ layers.direction),
            0.3 * width * (coarse * outward_now).sum(1),
            0.3 * self._brightening_in_time(f) * width / speed,
            layers.slope(gaussian_filter1d(axis.sections.radius, 3))[layer],
        )
        vectors = np.zeros((len(layer), VECTORS, 3))
        vectors[:, 0] = layers.direction
        vectors[:, 1] = outward_now
        vectors[:, 2] = across / speed
        vectors[:, 3] = self._lean[layer]
        vectors[:, 4] = outward
        return np.clip(np.stack(features, -1), -LIMIT, LIMIT).astype(np.float32), vectors.astype(np.float32)

    @cached_property
    def _lean(self) -> np.ndarray:
        """(S, 3) how far the clip's axis goes sideways per m of itself."""
        from scipy.ndimage import gaussian_filter1d  # here: it takes long to load

        tangent = gaussian_filter1d(self.axis.layers.slope(self.axis.sections.middle), 4, axis=0)
        length = np.linalg.norm(tangent, axis=1, keepdims=True)
        return self.axis.layers.sideways(tangent / np.maximum(length, 1e-9))

    @cached_property
    def _outward_of_clip(self) -> tuple[np.ndarray, np.ndarray]:
        """Return `_outward` from the clip's axis."""
        return self._outward(self.axis.sections)

    def _outward(self, sections: CrossSections) -> tuple[np.ndarray, np.ndarray]:
        """Direction (V, 3) away from the axis, shrinking to 0 within half a voxel of it, and distance (V,) m."""
        layers = self.axis.layers
        offset = layers.sideways(self.field.voxels.center - sections.middle[layers.nearest])
        radius = np.linalg.norm(offset, axis=1)
        return offset / np.maximum(radius, 0.5 * layers.thickness)[:, None], radius

    def _brightening_in_time(self, f: int) -> np.ndarray:
        """(V,) 1/s, between the frames before and after."""
        before, after = max(f - 1, 0), min(f + 1, len(self.field.frames) - 1)
        if before == after:
            return np.zeros(len(self.field.voxels.center))
        seconds = self.field.frames[after].time_s - self.field.frames[before].time_s
        change = self.log_light.grid(after, COARSE) - self.log_light.grid(before, COARSE)
        return change[tuple(self.field.voxels.index.T)] / seconds


def _brightness_in_layer(axis: FlameAxis, emission: np.ndarray) -> np.ndarray:
    """(V,) log of the emission relative to the light's own mean in its layer; 0 in a dark frame."""
    floor = 1e-3 * emission.max(initial=0)
    if floor == 0:
        return np.zeros(len(emission))
    light, square = axis.layers.sums(emission), axis.layers.sums(emission**2)
    mean = square / np.where(light > 0, light, 1)
    return np.log((emission + floor) / (mean[axis.layers.nearest] + floor))
