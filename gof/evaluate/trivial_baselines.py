"""Trivial baselines: what velocities without skill score on the very same Gaussians, beside which a DVE must be read.

A flame mostly rises, so one constant vector already scores well; only what a result gains over these counts.
None of them is part of the paper's metric.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gof.core.gaussians import MovingGaussians
from gof.evaluate.dve_frame import DVEResult, DVESequence, Samples, Sums, largest, score_sequence, weighted_sums
from gof.evaluate.intervals import own_generator
from gof.host.threads import map_on_cores

HEIGHT_BINS = 32
MIN_PER_BIN = 64  # fewer Gaussians in a layer and the layer's mean would follow single Gaussians

TRIVIAL_BASELINES = {
    "zero": "nothing moves",
    "random": "each Gaussian keeps its speed, in a random direction",
    "shuffled": "the result's own velocities, dealt out at random",
    "light": "the Gaussians' own motion, where the result also states a velocity of the gas",
    "constant": "one vector for everything: the mean true velocity",
    "height_mean": "the mean true velocity of each height",
    "true_centre": "the true velocity at each centre: the best a point-wise method can do",
}
BOUNDS = ("true_centre",)  # knows the truth at every place: not there to be beaten


def score_trivial_baselines(
    gaussians: MovingGaussians, frames: Sequence[Samples], layer: np.ndarray, seed: int = 0
) -> dict[str, DVESequence]:
    """Score every trivial baseline on the samples of `dve_frame.probe`.

    `random` and `shuffled` draw once per Gaussian, so a Gaussian keeps its drawn velocity through all frames;
    `constant` and `height_mean` are weighted means of the truth over all frames together.

    Args:
        layer: (M,) of `layers` of these frames.
    Returns:
        name (as in TRIVIAL_BASELINES) -> DVESequence; "light" only where gas and light have a velocity each.
    """
    rng = own_generator("directions and order of the baselines", seed)
    direction = rng.standard_normal((len(gaussians), 3))
    direction /= np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-300)
    scored = np.unique(np.concatenate([f.index for f in frames]))
    donor = np.arange(len(gaussians))
    donor[scored] = rng.permutation(scored)

    def own(frame: Samples) -> np.ndarray:
        return gaussians.state_at(frame.time_s).moving_gas

    def light(frame: Samples) -> np.ndarray | None:
        state = gaussians.state_at(frame.time_s)
        return None if state.gas_velocity is None else np.where(state.dynamic[:, None], state.velocity, 0)

    weight = np.concatenate([f.weight for f in frames])
    truth = np.concatenate([f.truth for f in frames])
    constant = np.einsum("n,nk->k", weight / weight.sum(), truth)
    height = _height_means(layer, truth, weight)
    velocities = {
        "zero": [np.zeros_like(f.truth) for f in frames],
        "random": [direction[f.index] * np.linalg.norm(f.velocity, axis=1, keepdims=True) for f in frames],
        "shuffled": [own(f)[donor[f.index]].astype(np.float64) for f in frames],
        "light": [v[f.index].astype(np.float64) for f in frames if (v := light(f)) is not None],
        "constant": [np.broadcast_to(constant, f.truth.shape) for f in frames],
        "height_mean": _split(height, frames),
        "true_centre": [f.truth_centre for f in frames],
    }
    return {name: score_sequence(frames, v) for name, v in velocities.items() if v}


def fluctuation(frames: Sequence[Samples], layer: np.ndarray) -> DVEResult:
    """DVE of what is left when the weighted mean per height is taken from the estimated and the true velocity.

    Pooled over frames: the paper's formulas on v - mean_z(v) and vbar - mean_z(vbar). Zero velocity, a constant vector
    and a mean per height all score L2 = 1 and CosSim = 0 here. Not part of the paper's metric. `layer`: (M,) of
    `layers`.
    """
    weight = np.concatenate([f.weight for f in frames])
    velocity = np.concatenate([f.velocity for f in frames])
    truth = np.concatenate([f.truth for f in frames])
    v = velocity - _height_means(layer, velocity, weight)
    t = truth - _height_means(layer, truth, weight)
    noise = 1e-12  # rounding left by the subtraction is no fluctuation
    v[largest(np.abs(v)) <= noise * np.abs(velocity).max(initial=0)] = 0
    t[largest(np.abs(t)) <= noise * np.abs(truth).max(initial=0)] = 0
    parts = zip(frames, _split(v, frames), _split(t, frames), strict=True)
    result = DVEResult.from_sums(sum(map_on_cores(lambda of: weighted_sums(*of), parts), Sums()))
    if result.l2 is None and result.weight > 0:
        return replace(result, undefined="the true velocity is the same everywhere at each height")
    return result


def skill(score: DVEResult, trivial_baseline: DVEResult) -> float | None:
    """1 - (L2 / L2 of the trivial baseline)^2: 1 is perfect, 0 no better than the trivial baseline, negative worse;
    None if undefined."""
    if score.l2 is None or trivial_baseline.l2 is None or trivial_baseline.l2 == 0:
        return None
    return 1 - (score.l2 / trivial_baseline.l2) ** 2


def layers(frames: Sequence[Samples]) -> np.ndarray:
    """Return the number of each Gaussian's layer of height, (M,) for those of all frames; layers hold equally many."""
    height = np.concatenate([f.position[:, 2] for f in frames])
    bins = int(np.clip(len(height) // MIN_PER_BIN, 1, HEIGHT_BINS))
    edges = np.quantile(height, np.linspace(0, 1, bins + 1)[1:-1]) if len(height) else []
    return np.searchsorted(edges, height)


def _height_means(layer: np.ndarray, values: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Weighted mean of values (M, 3) in layers (M,), given back per Gaussian (M, 3)."""
    total = np.bincount(layer, weight)
    mean = np.stack([np.bincount(layer, weight * values[:, k]) for k in range(3)], 1)
    return (mean / np.where(total > 0, total, 1)[:, None])[layer]


def _split(values: np.ndarray, frames: Sequence[Samples]) -> list[np.ndarray]:
    return np.split(values, np.cumsum([len(f.weight) for f in frames])[:-1])
