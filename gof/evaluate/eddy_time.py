"""The eddy time of a scene: how long the true velocity at a fixed place remembers itself.

It is the integral time scale of the velocity's fluctuation around its mean over the clip, at places of the flame: the
area under the autocorrelation up to its first zero. A clip of a few eddy times makes that area too small, because its
own mean is taken off; so the eddy time is the one for which a series with correlation exp(-t / eddy time), as long as
the clip, has on average the area that was found.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gof.core.errors import GofError
from gof.dataset import Dataset
from gof.evaluate.emission import flame_grid
from gof.evaluate.intervals import own_generator
from gof.evaluate.sparse_grid import StoredField

PLACES = 2048  # in all, drawn from the emission of all frames
LONGEST = 0.25  # of the clip: a longer eddy time cannot be told from a clip that is one eddy
SHORTEST = 0.3  # frames


@dataclass(frozen=True)
class EddyTime:
    """In seconds. `at_least`: the clip is too short to tell; it is this long or longer."""

    seconds: float
    at_least: bool


def eddy_time(dataset: Dataset, seed: int = 0) -> EddyTime:
    """Return that of a dataset with a true velocity. The places are drawn from the true light, else from the speed.

    Raises:
        GofError: fewer than 4 frames, or times that are not equally far apart.
    """
    truth = dataset.velocity
    steps = np.diff(truth.times_s)
    if len(steps) < 3 or np.ptp(steps) > 1e-3 * steps.mean():
        raise GofError(f"{dataset.path}: an eddy time needs 4 or more frames of true velocity, equally far apart")
    places = _places(dataset, own_generator("places of the eddy time", seed))
    history = np.stack([StoredField(truth, float(time_s)).sample(places) for time_s in truth.times_s])
    frames = integral_time(history.reshape(len(history), -1).astype(np.float64))
    longest = LONGEST * len(history)
    return EddyTime(float(min(frames, longest) * steps.mean()), frames >= longest)


def integral_time(history: np.ndarray) -> float:
    """In units of the time step, of values (T, N) over time at N places; inf where the clip is too short to tell.

    Below a third of a step neighbours are as good as uncorrelated, and it is 0.
    """
    found = _area(_autocovariance(history))
    if found <= 0:
        return 0.0
    count = len(history)
    candidates = np.geomspace(SHORTEST, count / 2, 200)
    areas = np.array([_area(_expected_autocovariance(count, frames)) for frames in candidates])
    rising = np.maximum.accumulate(areas)
    if found >= rising[-1]:
        return np.inf
    return float(np.interp(found, rising, candidates))


def _autocovariance(history: np.ndarray) -> np.ndarray:
    """Return (T,) by lag, mean over places, of what is left without each place's mean over time."""
    rest = history - history.mean(0)
    count = len(rest)
    return np.array([(rest[: count - lag] * rest[lag:]).sum(1).mean() for lag in range(count)])


def _expected_autocovariance(count: int, eddy_frames: float) -> np.ndarray:
    """Return the mean of `_autocovariance` for a series with correlation exp(-lag / eddy_frames)."""
    from scipy.linalg import toeplitz  # here: it takes long to load

    taken = np.eye(count) - 1 / count
    rest = taken @ toeplitz(np.exp(-np.arange(count) / eddy_frames)) @ taken
    return np.array([np.diagonal(rest, lag).mean() for lag in range(count)])


def _area(covariance: np.ndarray) -> float:
    """Sum of the correlation from lag 1 up to its first zero."""
    if covariance[0] <= 0:
        return 0.0  # nothing ever changes
    correlation = covariance / covariance[0]
    below = np.flatnonzero(correlation <= 0)
    end = below[0] if len(below) else len(correlation)
    return float(correlation[1:end].sum())


def _places(dataset: Dataset, rng: np.random.Generator) -> np.ndarray:
    """Return (M, 3) world m."""
    flame = flame_grid(dataset.path, dataset.datum)
    if flame is not None:
        each = -(-PLACES // len(flame.times_s))
        places = np.concatenate([flame.places(float(time_s), each, rng) for time_s in flame.times_s])
        if len(places):
            return places
    middle = dataset.velocity.at(float(dataset.velocity.times_s[len(dataset.velocity.times_s) // 2]))
    power = np.square(middle.velocity.astype(np.float64)).sum(-1).ravel()
    if not power.any():
        raise GofError(f"{dataset.path}: its true velocity is zero everywhere")
    cells = rng.choice(len(power), min(PLACES, np.count_nonzero(power)), replace=False, p=power / power.sum())
    return middle.cell_centers().reshape(-1, 3)[cells]
