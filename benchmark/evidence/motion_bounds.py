"""How well could the motion of a flame be known from these cameras?

    python -m gof_benchmark.evidence.motion_bounds DATASET...

Takes about 30 s a dataset.

Fused fields before any optimisation, weighted by emission, against the truth: L2 and CosSim of all frames together, and
the parts of L2^2. A flame's velocity can be wrong in the mean of a layer over the clip ("layers"), in
how that mean is spread within the layer ("standing"), or in how a frame differs from the clip's mean ("passing"): the
squares of the three add up to L2^2. The last row says how much of the true velocity each part holds. Rows whose name
begins with "true" know a part of the truth.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro
from scipy.ndimage import gaussian_filter

from gof.dataset import Dataset
from gof.reconstruct.flow_field import FlowField
from gof.reconstruct.flow_prior import FlameDescriber, FlowPrior
from gof.reconstruct.fusion import fuse_frame
from gof.reconstruct.methods import OURS
from gof.reconstruct.observation import observe
from gof.reconstruct.voxels import FlameVoxels
from gof_benchmark.training.field_score import open_small, preview_field

BLUR = 1.5  # px, std-dev with which voxels are drawn into a picture: they are about as large as a pixel


@dataclass(frozen=True)
class MotionBounds:
    """Measure how much of a flame's motion is missed, and by whom."""

    datasets: tyro.conf.Positional[tuple[Path, ...]]
    """Datasets with true velocity."""


@dataclass(frozen=True)
class ClipFields:
    """A clip's fields on its voxels: velocities (F, V, 3) m/s, emission (F, V); `layer` (V,) across the axis."""

    layer: np.ndarray
    emission: np.ndarray
    truth: np.ndarray

    def score(self, velocity: np.ndarray) -> str:
        """L2, CosSim and the parts of L2^2, as a row's cells."""
        weight = self.emission[..., None]
        energy = (weight * self.truth**2).sum()
        parts = self.parts(velocity - self.truth) / energy
        lengths = np.linalg.norm(velocity, axis=-1) * np.linalg.norm(self.truth, axis=-1)
        cosine = np.where(lengths > 0, (velocity * self.truth).sum(-1) / np.where(lengths > 0, lengths, 1), 0)
        cos_sim = (self.emission * cosine).sum() / self.emission.sum()
        return f"{np.sqrt(parts.sum()):.3f} | {cos_sim:.3f} | " + " | ".join(f"{part:.3f}" for part in parts)

    def parts(self, velocity: np.ndarray) -> np.ndarray:
        """Return (3,) sums of squares: means of layers, standing within them, passing."""
        light = self.emission.sum(0)
        standing = (self.emission[..., None] * velocity).sum(0) / np.maximum(light, 1e-30)[:, None]
        of_layer = np.maximum(np.bincount(self.layer, light), 1e-30)
        mean = np.stack([np.bincount(self.layer, light * axis) for axis in standing.T], -1) / of_layer[:, None]
        squares = [
            (of_layer[:, None] * mean**2).sum(),
            (light[:, None] * (standing - mean[self.layer]) ** 2).sum(),
            (self.emission[..., None] * (velocity - standing) ** 2).sum(),
        ]
        return np.array(squares)


def true_flow(voxels: FlameVoxels, velocity: np.ndarray, emission: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the gas' motion in every picture: mean over a pixel's ray of the projected velocity, weighted by emission.

    Args:
        velocity: (V, 3) m/s.    emission: (V,) >= 0.
    Returns:
        flow (C, H, W, 2) px/s, NaN where nothing shines; mask (C, H, W).
    """
    width, height = (np.nanmax(voxels.pixel, axis=(0, 1)) + 2).astype(int)
    flows, masks = [], []
    for pixel, jacobian in zip(voxels.pixel, voxels.jacobian, strict=True):
        inside = np.isfinite(pixel).all(-1) & (pixel >= 0).all(-1)
        column, row = pixel[inside].astype(int).T
        projected = np.einsum("vij,vj->vi", jacobian[inside], velocity[inside])
        drawn = _drawer(row * width + column, (height, width))
        light = drawn(emission[inside])
        lit = light > 1e-4 * light.max()
        momentum = [drawn(emission[inside] * axis) for axis in projected.T]
        flows.append(np.stack([np.where(lit, m / np.where(lit, light, 1), np.nan) for m in momentum], -1))
        masks.append(lit)
    return np.stack(flows), np.stack(masks)


def _drawer(place: np.ndarray, shape: tuple[int, int]) -> Callable[[np.ndarray], np.ndarray]:
    def drawn(values: np.ndarray) -> np.ndarray:
        return gaussian_filter(np.bincount(place, values, shape[0] * shape[1]).reshape(shape), BLUR)

    return drawn


def with_speed_of(speed: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Vectors (..., 3) as long as the first and along the second; 0 where the second is 0."""
    length = np.linalg.norm(direction, axis=-1, keepdims=True)
    return np.linalg.norm(speed, axis=-1, keepdims=True) * direction / np.where(length > 0, length, 1)


def rows(field: FlowField, metres: bool, dataset: Dataset) -> dict[str, str]:
    """Return the score of each kind of knowledge."""
    voxels, emission, seen = field.voxels, field.emission, field.velocity
    truth = np.stack([dataset.velocity.at(frame.time_s).sample(voxels.center) for frame in field.frames])
    describer = FlameDescriber.of(field)
    assert describer is not None, f"{dataset.path}: nothing moves"
    clip = ClipFields(describer.axis.layers.nearest, emission, truth)
    gas = FlowPrior.load().correct(field, metres).velocity

    def speed(velocity: np.ndarray) -> float:
        return float((emission * np.linalg.norm(velocity, axis=-1)).sum())

    def fused(smooth_voxels: float) -> np.ndarray:
        flows = [true_flow(voxels, v, e) for v, e in zip(truth, emission, strict=True)]
        parts = zip(flows, emission, strict=True)
        return np.stack([fuse_frame(voxels, *flow, e, "full", smooth_voxels)[0] for flow, e in parts])

    found = {
        "as seen": seen,
        "with the prior": gas,
        "true mean speed, prior": gas * (speed(truth) / speed(gas)),
        "true speed, seen direction": with_speed_of(truth, seen),
        "true speed, prior's direction": with_speed_of(truth, gas),
        "true direction, prior's speed": with_speed_of(gas, truth),
        "true gas flow in every picture, fused": fused(0),
        "the same, smoothed as ours": fused(OURS.smooth_voxels),
        "the truth has": np.zeros_like(truth),
    }
    return {name: clip.score(velocity) for name, velocity in found.items()}


def main(argv: list[str] | None = None) -> None:
    """Print the tables."""
    config = tyro.cli(MotionBounds, prog="python -m gof_benchmark.evidence.motion_bounds", args=argv)
    print("| dataset | known | L2 | CosSim | layers | standing | passing |")
    print("|---|---|---|---|---|---|---|")
    for path in config.datasets:
        dataset = open_small(path)
        field = preview_field(observe(dataset))
        field = replace(field, frames=tuple(replace(frame, image=frame.image[:0]) for frame in field.frames))
        for name, cells in rows(field, dataset.description.in_metres, dataset).items():
            print(f"| {path.name} | {name} | {cells} |", flush=True)


if __name__ == "__main__":
    main()
