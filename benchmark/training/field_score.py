"""Scores of a flow field before any optimisation, and the trivial baselines beside which they must be read."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gof.core.gaussians import TransientGaussians
from gof.dataset import Dataset
from gof.evaluate import dve
from gof.reconstruct.flame_axis import FlameAxis
from gof.reconstruct.flow_field import FlowField, seen_flow_field
from gof.reconstruct.flow_prior import VOXELS
from gof.reconstruct.mean_speed import GRAVITY, LAW
from gof.reconstruct.methods import OURS
from gof.reconstruct.observation import Observation
from gof.reconstruct.presets import PRESETS
from gof.reconstruct.shrink import shrink
from gof.reconstruct.voxels import FlameVoxels

HALF_WIDTH = (
    0.38  # of sqrt(radius x length), where the speed has fallen to a half; chosen on the demo and one pool fire
)


@dataclass(frozen=True)
class Score:
    """Means of DVE's figures over the frames of a flow field."""

    l2: float
    cos_sim: float
    speed_ratio: float


def score(field: FlowField, dataset: Dataset) -> Score:
    """Return the score of a flow field against the dataset's true velocity."""
    results = []
    for frame in field.frames:
        cloud = on_voxels(field.voxels, frame.velocity, frame.emission, frame.time_s)
        result = dve(cloud, dataset.velocity.at(frame.time_s), frame.time_s, order=1)
        results.append((result.l2, result.cos_sim, result.speed_ratio))
    return Score(*np.mean(results, 0).tolist())


def mean_speed(velocity: np.ndarray, emission: np.ndarray) -> float:
    """Return the mean speed of velocity (F, V, 3), weighted by emission (F, V)."""
    return float((emission * np.linalg.norm(velocity, axis=-1)).sum() / emission.sum())


def fluctuation_cos_sim(field: FlowField, dataset: Dataset) -> float:
    """Cosine of what is left of both velocities without the clip's mean of every height, weighted by emission."""
    layer, emission = field.voxels.index[:, 2], field.emission
    truth = np.stack([dataset.velocity.at(frame.time_s).sample(field.voxels.center) for frame in field.frames])
    light = np.bincount(layer, emission.sum(0))

    def fluctuation(velocity: np.ndarray) -> np.ndarray:
        momentum = (emission[..., None] * velocity).sum(0)
        mean = np.stack([np.bincount(layer, axis) for axis in momentum.T], -1) / np.maximum(light, 1e-12)[:, None]
        return velocity - mean[layer]

    found, true = fluctuation(field.velocity), fluctuation(truth)
    lengths = np.linalg.norm(found, axis=-1) * np.linalg.norm(true, axis=-1)
    cosine = np.where(lengths > 0, (found * true).sum(-1) / np.where(lengths > 0, lengths, 1), 0)
    return float((emission * cosine).sum() / emission.sum())


def within(field: FlowField, dataset: Dataset, deviations: float = 1) -> float:
    """Return share of the light whose velocity is within so many standard deviations of the truth, mean of the
    components."""
    inside = total = 0.0
    for frame in field.frames:
        truth = dataset.velocity.at(frame.time_s).sample(field.voxels.center)
        near = np.abs(frame.velocity - truth) <= deviations * frame.velocity_sd[:, None]
        inside += (frame.emission[:, None] * near).sum() / 3
        total += frame.emission.sum()
    return inside / total


def on_voxels(voxels: FlameVoxels, velocity: np.ndarray, emission: np.ndarray, time_s: float) -> TransientGaussians:
    """Return the fused field as point-like Gaussians, weighted by emission, so that DVE itself scores it."""
    n = len(voxels.center)
    return TransientGaussians(
        position=voxels.center,
        velocity=velocity,
        t_mu=np.full(n, time_s),
        t_sigma=np.full(n, np.inf),
        scale=np.full((n, 3), 1e-3 * voxels.voxel_size),
        rotation=np.tile([1.0, 0, 0, 0], (n, 1)),
        opacity=emission / emission.max(),
        color=np.ones((n, 3)),
        dynamic=np.ones(n, bool),
    )


# ---- Trivial baselines: scores of a prediction without skill, or of a textbook --------------------------------------


def best_constant(field: FlowField, dataset: Dataset) -> FlowField:
    """Return each frame's mean true velocity, weighted by emission, everywhere."""
    frames = []
    for frame in field.frames:
        truth = dataset.velocity.at(frame.time_s).sample(field.voxels.center)
        mean = (frame.emission[:, None] * truth).sum(0) / frame.emission.sum()
        frames.append(replace(frame, velocity=np.broadcast_to(mean, truth.shape)))
    return replace(field, frames=tuple(frames))


def mean_per_height(field: FlowField, dataset: Dataset) -> FlowField:
    """Return each frame's mean true velocity of every height, weighted by emission."""
    layer = field.voxels.index[:, 2]
    frames = []
    for frame in field.frames:
        truth = dataset.velocity.at(frame.time_s).sample(field.voxels.center)
        light = np.bincount(layer, frame.emission)
        sums = np.stack([np.bincount(layer, frame.emission * axis) for axis in truth.T], -1)
        frames.append(replace(frame, velocity=(sums / np.maximum(light, 1e-12)[:, None])[layer]))
    return replace(field, frames=tuple(frames))


def buoyant_law(field: FlowField) -> FlowField:
    """McCaffrey's speed of the axis, straight up, fading outward; knows metres, gravity and the vertical, no truth."""
    axis = FlameAxis.of(field)
    assert axis is not None
    height = (axis.layers.along * axis.layers.thickness - axis.foot).clip(0)
    return _straight(field, axis, LAW * np.sqrt(GRAVITY * height), np.array([0.0, 0.0, 1.0]))


def _straight(field: FlowField, axis: FlameAxis, speed: np.ndarray, direction: np.ndarray) -> FlowField:
    """Return speed (V,) m/s on the axis, along a direction, halved HALF_WIDTH away from the axis."""
    layers = axis.layers
    offset = layers.sideways(field.voxels.center - axis.sections.middle[layers.nearest])
    half = HALF_WIDTH * np.sqrt(axis.radius * axis.length)
    velocity = (speed * 0.5 ** ((offset**2).sum(1) / half**2))[:, None] * direction
    return replace(field, frames=tuple(replace(frame, velocity=velocity) for frame in field.frames))


# ----------------------------------------------------------------
# As `gof reconstruct --preset preview` goes with a dataset up to the flow field that is seen, before any prior.

EFFORT = PRESETS["preview"]


def open_small(path: Path) -> Dataset:
    """Return the dataset in a folder, its pictures no larger than the preset's."""
    return shrink(Dataset.open(path), EFFORT.longest_side)


def preview_field(observation: Observation) -> FlowField:
    """Return the fused flow on the flow prior's voxels, m/s."""
    return seen_flow_field(observation, OURS, VOXELS)
