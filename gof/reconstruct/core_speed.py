"""How fast the core of a flame moves along its axis: the slope of its light in space and time.

Optical flow follows texture, which sits in a flame's slow outer sheet and slides along it (the aperture problem). The
light of a whole layer knows nothing of texture: a bulge that the core carries upwards brightens one layer after the
other. Correlating the layers' light with that of later frames and farther layers gives the speed at which such changes
travel. They go at the speed of the core where the flame is turbulent, and slower where they are large coherent puffs;
`agreement` tells the two apart.

Two things are taken out first because they travel nowhere: the slow part of every layer's light, which is the flame's
standing shape, and what all layers do at once, which is a camera's exposure or a flame that swells as a whole.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from gof.reconstruct.flame_axis import FlameAxis

# In the time that what is seen takes to cross the flame's radius, so that a candle and a pool are told alike:
SLOW = 0.4  # std-dev of the running mean that is taken out; a flame puffs slower
LONGEST_LAG = 0.3  # after which eddies have turned over
LAGS = 6  # at most so many time differences are looked at
SPEEDS = np.geomspace(0.5, 8, 48)  # candidates, in seen speeds
STIFFNESS = 1.0  # price of a change of log speed from layer to layer
USUAL = np.log(2.0)  # log of core over seen speed; decides only where nothing else does
DARK = 0.02  # of a layer's mean light, below which a change of it says nothing


@dataclass(frozen=True)
class CoreSpeed:
    """Speed (S,) m/s along the axis in every layer; and how well the layers' light agrees with it, (S,) -1..1."""

    speed: np.ndarray
    agreement: np.ndarray


def core_speed(axis: FlameAxis, time_s: np.ndarray) -> CoreSpeed:
    """The path of speeds along the axis that the light agrees with best, changing smoothly (Viterbi 1967).

    Args:
        time_s: (F,) of the frames, increasing.
    Returns:
        finite values always; where the light says nothing (one frame, a dark layer, a standing flame) agreement is 0
        and the speed that of the neighbouring layers, at last twice the seen one.
    """
    crossing_s = axis.radius / axis.seen_speed
    changes = apart(fast_changes(axis.light, time_s, SLOW * crossing_s), axis.mean_light)
    lags = pairs(time_s, LONGEST_LAG * crossing_s)
    speeds = axis.seen_speed * SPEEDS
    layer, window = axis.layers.thickness, axis.radius / axis.layers.thickness
    agreement = np.stack([_agreement(changes, time_s, lags, speed / layer, window) for speed in speeds], -1)
    weight = axis.mean_light / axis.mean_light.mean()
    path = smoothest_path(np.maximum(agreement, -0.2) * weight[:, None], np.log(SPEEDS))
    speed = gaussian_filter1d(speeds[path], 2.0)
    return CoreSpeed(speed, agreement[np.arange(len(path)), path])


Lag = tuple[np.ndarray, np.ndarray]
"""Numbers of frames, (P,) and (P,), as far from each other in time."""


def fast_changes(light: np.ndarray, time_s: np.ndarray, slow_s: float) -> np.ndarray:
    """(F, S) log of the light (F, S) >= 0 minus its own running mean over time, mean 0 in every layer.

    The mean reaches over two frame times at least, or nothing would be left.
    """
    mean = light.mean(0)
    log = np.log(light + DARK * mean + 1e-9 * light.max(initial=1e-30))
    width = max(slow_s, 2 * _frame_time(time_s))
    weight = np.exp(-0.5 * ((time_s[:, None] - time_s) / width) ** 2)
    fast = log - weight @ log / weight.sum(1, keepdims=True)
    return fast - fast.mean(0)


def apart(changes: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Changes (F, S) without what the layers, weighed by (S,), have in common in each frame."""
    return changes - (changes @ weight / weight.sum())[:, None]


def _agreement(
    changes: np.ndarray, time_s: np.ndarray, lags: list[Lag], layers_per_s: float, window: float
) -> np.ndarray:
    """(S,) correlation of changes (F, S) between layers and times that the speed connects, over `window` layers."""
    together, alone = np.zeros((2, changes.shape[1]))
    for first, second in lags:
        half = 0.5 * layers_per_s * (time_s[second] - time_s[first]).mean()
        below, above = _shifted(changes[first], -half), _shifted(changes[second], half)
        together += (below * above).sum(0)
        alone += 0.5 * (below**2 + above**2).sum(0)
    together, alone = gaussian_filter1d(together, window), gaussian_filter1d(alone, window)
    return together / np.maximum(alone, 1e-12)  # changes are logarithms: 1e-12 is a millionth of the light


def _shifted(rows: np.ndarray, by: float) -> np.ndarray:
    """(F, S) rows at places `by` layers farther along, linear in between; the end layers go on for ever."""
    count = rows.shape[1]
    at = np.clip(np.arange(count) + by, 0, count - 1)
    low = np.minimum(at.astype(np.int64), max(count - 2, 0))
    high = np.minimum(low + 1, count - 1)
    return rows[:, low] * (1 - (at - low)) + rows[:, high] * (at - low)


def pairs(time_s: np.ndarray, longest_s: float) -> list[Lag]:
    """Frames whose times differ by one frame time, by two, ... up to `longest_s`, but by one in any case.

    Gaps are stepped over. Differences in between are left out when they would be more than `LAGS`.
    """
    step = _frame_time(time_s)
    if not step > 0:
        return []
    longest = max(1, round(longest_s / step))
    found = []
    for lag in np.unique(np.rint(np.geomspace(1, longest, min(longest, LAGS)))):
        late = np.abs(time_s[None] - time_s[:, None] - lag * step)
        second = late.argmin(1)
        first = np.flatnonzero((late.min(1) < 0.25 * step) & (second > np.arange(len(time_s))))
        if len(first):
            found.append((first, second[first]))
    return found


def smoothest_path(gain: np.ndarray, log_speed: np.ndarray) -> np.ndarray:
    """(S,) candidate of each layer that gives the largest sum of gain (S, N) minus `STIFFNESS` x squared changes."""
    step = STIFFNESS * (log_speed[:, None] - log_speed) ** 2
    gain = gain - 1e-3 * (log_speed - USUAL) ** 2
    best, came_from = gain[0], []
    for layer in gain[1:]:
        options = best - step
        came_from.append(options.argmax(1))
        best = options.max(1) + layer
    path = [int(best.argmax())]
    for origin in reversed(came_from):
        path.append(int(origin[path[-1]]))
    return np.array(path[::-1])


def _frame_time(time_s: np.ndarray) -> float:
    return float(np.median(np.diff(time_s))) if len(time_s) > 1 else 0.0
