"""Uncertainty of a mean over a clip's frames, and whether two methods differ significantly.

Neighbouring frames show the same eddies, so the frames of a clip are not so many independent measurements. Blocks of
one eddy time are drawn again and again in their place (the circular block bootstrap of Politis and Romano, 1992). For a
mean, the limit of infinitely many drawings has a closed form, so nothing here is random.

Blocks that short see too little of the scatter: on series of known correlation an interval made from them alone holds
the true mean in 54 to 81 % of cases, not in 95 %. The factor that is missing is known for a series whose correlation
falls as exp(-t / eddy time): the standard error is multiplied by it, and the interval's width is that of Student's t
with as many degrees of freedom as the clip has independent stretches (two eddy times each), less one.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from gof.core.errors import GofError, require_finite

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Estimate:
    """A mean and how sure it is.

    Attributes:
        standard_error: None for fewer than two values, which do not tell.
        degrees: of freedom, for Student's t; 0 where there is no standard error.
    """

    mean: float
    standard_error: float | None
    degrees: float

    @property
    def half_width(self) -> float | None:
        """Return half the width of the interval that holds the true mean in CONFIDENCE of all cases."""
        from scipy.stats import t

        if self.standard_error is None:
            return None
        return float(t.ppf(0.5 + CONFIDENCE / 2, self.degrees) * self.standard_error)

    @property
    def p_value(self) -> float:
        """The chance of a mean this far from zero, or farther, where the true one is zero; 1 where it is unknown."""
        from scipy.stats import t

        if self.standard_error is None:
            return 1.0
        if self.standard_error == 0:
            return 1.0 if self.mean == 0 else 0.0
        return float(2 * t.sf(abs(self.mean) / self.standard_error, self.degrees))


def over_frames(values: Sequence[float], eddy_frames: float) -> Estimate:
    """Return mean over the frames of one clip.

    Args:
        values: one per frame, equally far apart in time, in their order.
        eddy_frames: the eddy time in units of the time between two values, >= 0 (`gof.evaluate.eddy_time`).
    Raises:
        GofError: no value, or no eddy time.   NonFiniteError: NaN or Inf among the values.
    """
    series = np.asarray(values, np.float64)
    require_finite("values", series)
    if len(series) == 0 or not 0 <= eddy_frames < np.inf:
        raise GofError(f"a mean needs values and an eddy time, got {len(series)} values and {eddy_frames}")
    count = len(series)
    mean = float(series.mean())
    if count < 2:
        return Estimate(mean, None, 0)
    block = block_length(count, eddy_frames)
    eddy_frames = min(eddy_frames, count / 2)  # beyond, the clip is one stretch, and its scatter says nothing
    variance = block_variance(series, block) * missing_share(count, block, eddy_frames)
    return Estimate(mean, float(np.sqrt(variance)), max(count / max(block, 2 * eddy_frames) - 1, 1.0))


def block_length(count: int, eddy_frames: float) -> int:
    """Return frames of a block: one eddy time, at least 1, and no more than a third of the clip."""
    return int(np.clip(np.ceil(eddy_frames), 1, max(count // 3, 1)))


def block_variance(series: np.ndarray, block: int) -> float:
    """Variance of the mean of blocks drawn with replacement: that of all circular blocks' means over their number."""
    around = np.concatenate([series, series[: block - 1]])
    sums = np.cumsum(np.concatenate([[0.0], around - series.mean()]))
    means = (sums[block:] - sums[:-block]) / block
    return float(means.var() * block / len(series))


@lru_cache(maxsize=64)
def missing_share(count: int, block: int, eddy_frames: float) -> float:
    """Return the true variance of the mean over what `block_variance` gives on average, for exponential correlation."""
    covariance = _covariance(count, eddy_frames)
    whole = covariance.mean()
    blocks = (np.arange(count)[:, None] + np.arange(block)) % count
    part = np.mean([covariance[np.ix_(frames, frames)].mean() for frames in blocks])
    return float(whole / ((block / count) * (part - whole)))


def _covariance(count: int, eddy_frames: float) -> np.ndarray:
    """Return (count, count) of values of variance 1."""
    lag = np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
    return np.exp(-lag / eddy_frames) if eddy_frames > 0 else np.eye(count)


# ---------------------------------------------------------------- seeds and scenes


def over_runs(runs: Sequence[Sequence[float]], eddy_frames: float) -> Estimate:
    """Return mean over the frames of one clip and over the runs (seeds) of a method, each (T,) values of the same
    frames.

    Runs share the clip: its frames' scatter is that of the runs' mean. The seed adds the runs' spread over
    the root of their number; for a single run it is not known, and left out.
    """
    table = np.asarray(runs, np.float64)
    frames = over_frames(table.mean(0), eddy_frames)
    if len(table) < 2 or frames.standard_error is None:
        return frames
    seeds = table.mean(1).var(ddof=1) / len(table)
    return Estimate(frames.mean, float(np.sqrt(frames.standard_error**2 + seeds)), frames.degrees)


def over_scenes(scenes: Sequence[Estimate]) -> Estimate:
    """Return mean over scenes.

    From three scenes on, the scenes are a sample of all fires: their spread gives the uncertainty of the mean, and
    includes that of frames and seeds. With one or two it comes from frames and seeds alone, and holds for these scenes.
    """
    means = np.array([scene.mean for scene in scenes])
    if len(scenes) >= 3:
        return Estimate(float(means.mean()), float(means.std(ddof=1) / np.sqrt(len(means))), len(means) - 1)
    errors = [scene.standard_error for scene in scenes if scene.standard_error is not None]
    if len(errors) < len(scenes):
        return Estimate(float(means.mean()), None, 0)
    error = float(np.linalg.norm(errors)) / len(scenes)
    return Estimate(float(means.mean()), error, min(scene.degrees for scene in scenes))


# ---------------------------------------------------------------- who is better


def ranks(means: Sequence[float], p_values: np.ndarray, better: int) -> list[tuple[int, int]]:
    """Return each method's rank as an interval of places: it excludes only methods that are significantly better or
    worse. Methods that do not differ significantly share places.

    Args:
        means: of each method.
        p_values: (M, M) symmetric, the chance that a difference as large as theirs is none (`Estimate.p_value` of the
            paired differences).
        better: 1 where high values win, -1 where low ones do.
    """
    differ = apart(p_values)
    ahead = better * np.subtract.outer(np.asarray(means, np.float64), means) > 0  # [i, j]: i is better than j
    surely_ahead = differ & ahead
    best, worst = 1 + surely_ahead.sum(0), len(means) - surely_ahead.sum(1)
    return list(zip(best.tolist(), worst.tolist(), strict=True))


def apart(p_values: np.ndarray) -> np.ndarray:
    """Return (M, M) bool: which pairs differ significantly, with at most 1 - CONFIDENCE of a wrong one among all (Holm,
    1979)."""
    first, second = np.triu_indices(len(p_values), 1)
    order = np.argsort(p_values[first, second], kind="stable")
    differ = np.zeros(np.shape(p_values), bool)
    for place, pair in enumerate(order):
        i, j = first[pair], second[pair]
        if p_values[i, j] > (1 - CONFIDENCE) / (len(order) - place):
            break
        differ[i, j] = differ[j, i] = True
    return differ


# ---------------------------------------------------------------- weighted values


def weighted_quantile(values: np.ndarray, weight: np.ndarray, q: float) -> float:
    """Return the smallest of values (N,) up to which at least the share q of weight (N,) >= 0 lies; 0 <= q <= 1, N >=
    1."""
    if (counts := weight > 0).any():  # most pixels of a flame's picture have none: they need no sorting
        values, weight = values[counts], weight[counts]
    order = np.argsort(values)
    total = np.cumsum(weight[order])
    reached = np.searchsorted(total, q * total[-1])
    return float(values[order][min(reached, len(values) - 1)])


# ----------------------------------------------------------------
# Random numbers of our own: none that a user's script may have drawn already.


def own_generator(purpose: str, seed: int = 0) -> np.random.Generator:
    """Return the generator of one purpose, the same in every run.

    Everybody writes `default_rng(0)`. Numbers of the same generator are not independent of a user's data: "random"
    directions would be those in which a script placed its Gaussians.

    Args:
        purpose: what is drawn, such as "directions of the random baseline"; each has numbers of its own.
        seed: of this purpose.
    """
    word = int.from_bytes(hashlib.sha256(f"gof {purpose}".encode()).digest()[:16], "big")
    return np.random.default_rng([word, seed])
