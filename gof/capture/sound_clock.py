"""The offset of two films' clocks, from their sound: a clap, voices or the fire's crackle, heard by both.

Stretches of one track are sought in the other by the correlation of their phases (GCC-PHAT), which has a sharp peak
whatever the microphones' tone and level. All stretches together give the lag; a line through their own peaks refines it
and gives the drift of the clocks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter1d

from gof.core.errors import GofError

BAND = 150.0, 6000.0  # Hz: hum is below, what codecs leave out above
STRETCH_S = 4.0
DRIFTED_S = 0.003  # by which stretches may lie apart before a drift is fitted
LEAST_PEAK = 8.0  # standard deviations of the sum over the stretches; two tracks of other noise have 2 to 6
LEAST_HEARD = 0.5  # share of the stretches with a peak of their own near the line
FEWEST_FOR_DRIFT = 5


class NoSoundClock(GofError):
    """Two sounds do not tell how their clocks lie."""


@dataclass(frozen=True)
class SoundLag:
    """Offset of two films' clocks: a sound at t s of one film is at t + lag_s + drift * t of the other.

    Attributes:
        lag_s, drift: drift is a ratio; 0 where the sound is too short to tell.
        sigma_s: of the lag in the film's middle, by the scatter of its stretches.
        heard: how many stretches of `stretches` hold it.
    """

    lag_s: float
    drift: float
    sigma_s: float
    heard: int
    stretches: int


def find_lag(known: np.ndarray, other: np.ndarray, rate: float) -> SoundLag:
    """Return how the sound `other` (M,) lies in `known` (N,), both of `rate` samples per second.

    Raises:
        NoSoundClock: no lag at which they agree; most stretches say otherwise.
    """
    length = min(int(STRETCH_S * rate), len(other))
    count = max(len(other) // length, 1) if length else 0
    if count == 0 or len(known) < rate * 0.2 or len(other) < rate * 0.2:
        raise NoSoundClock("there is less than 0.2 s of sound")
    starts = np.linspace(0, len(other) - length, count).astype(int)
    # Lags run from minus the other's length to the known one's: in less room, some would come back as others.
    size = 1 << int(np.ceil(np.log2(len(known) + len(other))))
    lags = np.arange(size)
    lags[len(known) :] -= size
    correlations, together = [], np.zeros(size)
    near = int(DRIFTED_S * rate)
    for start in starts:
        found = _correlation(known, other[start : start + length], size, rate)
        found = np.roll(found, -start)  # by the lag of the whole track
        correlations.append(found)
        together += maximum_filter1d(found, 2 * near + 1, mode="wrap") if count > 1 else found
    meet = lags > -len(other)  # beyond, nothing of one is beside anything of the other
    usual = np.median(together[meet])
    spread = np.median(np.abs(together[meet] - usual)) * 1.4826
    peak = int(np.where(meet, together, -np.inf).argmax())
    height = (together[peak] - usual) / max(spread, 1e-12)
    if height < LEAST_PEAK:
        raise NoSoundClock(f"their sounds do not agree at any lag (peak {height:.1f} standard deviations)")
    middles, own = [], []
    for start, found in zip(starts, correlations, strict=True):
        window = (peak + np.arange(-2 * near, 2 * near + 1)) % size
        k = int(found[window].argmax())
        if found[window][k] > 5 and 0 < k < len(window) - 1:
            before, at, after = found[window[k - 1 : k + 2]]
            own.append((lags[peak] - 2 * near + k + 0.5 * (before - after) / (before - 2 * at + after)) / rate)
            middles.append((start + length / 2) / rate)
    if len(own) < max(LEAST_HEARD * count, 1):
        raise NoSoundClock(f"only {len(own)} of {count} stretches of their sounds agree")
    return _line(np.array(middles), np.array(own), count)


def _line(middles: np.ndarray, own: np.ndarray, count: int) -> SoundLag:
    """Fit lag and drift to the stretches' own lags (s), leaving out what is off."""
    kept = np.ones(len(own), bool)
    for _ in range(5):
        lag, drift = float(np.median(own[kept])), 0.0
        if kept.sum() >= FEWEST_FOR_DRIFT:
            drift, lag = map(float, np.polyfit(middles[kept], own[kept], 1))
        off = np.abs(own - lag - drift * middles)
        now = off <= max(4 * 1.4826 * float(np.median(off[kept])), 1e-4)
        if (now == kept).all():
            break
        kept = now
    if kept.sum() < LEAST_HEARD * count:
        raise NoSoundClock(f"only {kept.sum()} of {count} stretches of their sounds agree on one lag")
    sigma = float(off[kept].std() / np.sqrt(kept.sum())) if kept.sum() > 2 else 5e-4
    return SoundLag(lag, drift, max(sigma, 2e-5), int(kept.sum()), count)


def _correlation(known: np.ndarray, part: np.ndarray, size: int, rate: float) -> np.ndarray:
    """Return (size,) the phases' correlation at every lag, in its own standard deviations."""
    cross = np.fft.rfft(known, size) * np.conj(np.fft.rfft(part, size))
    frequency = np.fft.rfftfreq(size, 1 / rate)
    inside = (frequency > BAND[0]) & (frequency < min(BAND[1], 0.45 * rate))
    found = np.fft.irfft(np.where(inside, cross / np.maximum(np.abs(cross), 1e-12), 0), size)
    return found / max(found.std(), 1e-12)
