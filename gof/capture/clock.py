"""The camera's clock: which frames follow each other, which were dropped or repeated, and one steady line through them.

Time unit: microseconds.
"""

from __future__ import annotations

import numpy as np

from gof.capture.strips import NotDecodable


def estimate_interval(count: np.ndarray, phase_us: np.ndarray, period: float) -> float:
    """Time between frames from counter and strips, by the median over pairs eight frames apart: single wrong reads, drops
    and repeats do not move it.

    Raises:
        NotDecodable: fewer than four frames, or the counter stands still.
    """
    if len(count) < 4:
        raise NotDecodable(f"{len(count)} frames are too few; at least four are needed, a second is good")
    lag = min(8, len(count) // 2)
    counts, phases = (count[lag:] - count[:-lag]) * period, phase_us[lag:] - phase_us[:-lag]
    # A Gray code read without its upper bits runs backwards in every second cycle.
    steps = np.maximum(phases + counts, phases - counts) / lag
    interval = float(np.median(steps))
    # The mean of the steps that agree is finer than their median.
    near = np.abs(steps - interval) < 0.35 * period / lag + 0.02 * interval
    interval = float(steps[near].mean()) if near.any() else interval
    if interval <= 0:
        raise NotDecodable("the period counter does not advance; is the board running? Give the capture rate with --fps")
    return interval


def unwrap(phase_us: np.ndarray, interval: float, period: float) -> np.ndarray:
    """Times from phases alone: each step is the interval plus the small difference that the phases show."""
    step = interval + wrap(np.diff(phase_us) - interval, period)
    return phase_us[0] + np.concatenate([[0.0], np.cumsum(step)])


def wrap(time: np.ndarray, period: float) -> np.ndarray:
    """To -period/2 .. period/2."""
    return (np.asarray(time) + period / 2) % period - period / 2


def link_coarse(time: np.ndarray, interval: float, duplicate: np.ndarray, window: int = 8) -> np.ndarray:
    """(T,) position of every frame on a steady clock of the given interval, from coarse times.

    Repeated frames take the position of the frame before. A drop is a lasting step of the times against the clock by whole
    intervals; medians over `window` frames on both sides make single wrong times harmless.
    """
    index = np.cumsum(np.concatenate([[0], np.where(duplicate[1:], 0, 1)]))
    for _ in range(len(time)):
        rest = time - interval * index
        n = len(rest)
        steps = np.zeros(n)
        for k in range(2, n - 1):
            steps[k] = np.median(rest[k : k + window]) - np.median(rest[max(0, k - window) : k])
        missing = np.rint(steps / interval)
        if not (missing > 0).any():
            return index
        # The place: where one clean cut explains most.
        k = max(np.flatnonzero(missing == missing.max()), key=lambda k: _cut_gain(rest, k, window, missing.max() * interval))
        index[k:] += int(missing.max())
    return index


def _cut_gain(rest, k, window, step):
    before, after = rest[max(0, k - window) : k], rest[k : k + window]
    base = np.median(before)
    return -np.abs(before - base).sum() - np.abs(after - base - step).sum()


def link_fine(time: np.ndarray, index: np.ndarray, interval: float, period: float, tolerance: float) -> np.ndarray:
    """Check positions against fine times (right modulo the period): a step between neighbours that misses the clock by
    more than `tolerance`, and fits it with up to eight frames more or fewer, moves all later frames."""
    index = index.copy()
    for k in range(1, len(time)):
        step = time[k] - time[k - 1]
        q = index[k] - index[k - 1]
        error = abs(wrap(step - q * interval, period))
        if error <= tolerance:
            continue
        options = [c for c in range(max(0, q - 8), q + 9) if abs(wrap(step - c * interval, period)) < tolerance / 2]
        # The frame after must agree: a single wrong time is not a drop.
        options = [c for c in options if k + 1 >= len(time) or
                   abs(wrap(time[k + 1] - time[k - 1] - (c + index[k + 1] - index[k]) * interval, period)) < tolerance / 2]
        if options:
            index[k:] += min(options, key=lambda c: abs(c - q)) - q
    return index


def unwrap_to(time: np.ndarray, index: np.ndarray, interval: float, period: float) -> np.ndarray:
    """Times (right modulo the period) placed nearest to a steady clock through them."""
    z = np.exp(2j * np.pi * (time - index * interval) / period)
    start = np.angle(z.mean()) / (2 * np.pi) * period
    line = start + index * interval
    line += np.rint(np.median(time - line) / period) * period
    return line + wrap(time - line, period)
