"""Measures of a fire to be held beside the laws: on its grids, on its pictures, on records over time."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

VISIBLE = 0.05  # of the flame's brightest: what a picture still shows
# Above puffing (5 Hz, burner of 0.1 m) and what the window of a clip of a quarter of a second smears it over (8 Hz);
# below half of 100 Hz.
FLICKER_HZ = (15.0, 40.0)
LAGS = 3  # frames over which bright structures are followed
ALIKE = 0.3  # correlation below which a structure is not the same any more


def power_law(height_m: np.ndarray, speed_m_s: np.ndarray) -> tuple[float, float]:
    """Return (c, n) of speed = c z^n, least squares of the logarithms; NaN for fewer than two rising points."""
    height_m, speed_m_s = np.asarray(height_m, float), np.asarray(speed_m_s, float)
    good = (height_m > 0) & (speed_m_s > 0)
    if good.sum() < 2:
        return math.nan, math.nan
    exponent, logarithm = np.polyfit(np.log(height_m[good]), np.log(speed_m_s[good]), 1)
    return float(np.exp(logarithm)), float(exponent)


def axis_columns(
    x: np.ndarray, y: np.ndarray, place: tuple[float, float], diameter_m: float
) -> tuple[np.ndarray, np.ndarray]:
    """Cell numbers of the columns within a cell or a tenth of the burner of its axis, at least the nearest.

    Args:
        x, y: (X,), (Y,) m, centres of the cells.   place: (x, y) m of the axis.
    """
    gx, gy = np.meshgrid(x, y, indexing="ij")
    distance = np.hypot(gx - place[0], gy - place[1])
    return np.nonzero(distance <= max(distance.min() + 1e-9, x[1] - x[0], 0.1 * diameter_m))


def mean_over_time(time_s: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return (P,) mean of (N, P) values over an uneven clock: a time step counts by its length."""
    return np.diff(time_s) @ (values[1:] + values[:-1]) / 2 / (time_s[-1] - time_s[0])


def light_speed(velocity: Iterable[np.ndarray], light: Iterable[np.ndarray]) -> np.ndarray:
    """Return (Z,) m/s: mean vertical speed of the shining gas at each height, weighted by (X, Y, Z) light; NaN in the
    dark."""
    total = moved = 0.0
    for v, e in zip(velocity, light, strict=True):
        total = total + e.sum((0, 1), dtype=float)
        moved = moved + (e * v[..., 2]).sum((0, 1), dtype=float)
    return np.divide(moved, total, out=np.full_like(total, np.nan), where=total > 1e-6 * np.max(total))


def heat_release_kw(heat_release: np.ndarray, voxel_m: float) -> float:
    """kW of a frame's (X, Y, Z) W/m3."""
    return float(heat_release.sum(dtype=float)) * voxel_m**3 / 1e3


def flame_height(brightest: np.ndarray, height: np.ndarray) -> float:
    """Return height below which the visible flame stands at least half of the time.

    Args:
        brightest: (T, Z) of the brightest line of sight at each height; lit where it reaches VISIBLE of the clip's
            brightest. height: (Z,) of them above the burner, rising.
    """
    if not brightest.max() > 0:
        return 0.0
    share = (brightest > VISIBLE * np.quantile(brightest.max(1), 0.9)).mean(0)
    lit = np.nonzero(share >= 0.5)[0]
    return float(height[lit[-1]] + (height[1] - height[0]) / 2) if len(lit) else 0.0


def spectrum(time_s: np.ndarray, signal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (frequency Hz, power density 1/Hz) of an unevenly sampled signal, 8 times finer than its resolution 1 /
    duration.

    Straight trend removed, Hann's window; one-sided, so that its integral is the signal's variance.
    """
    step = float(np.median(np.diff(time_s)))
    even = time_s[0] + step * np.arange(round((time_s[-1] - time_s[0]) / step) + 1)
    values = np.interp(even, time_s, signal)
    values = values - np.polyval(np.polyfit(even - even[0], values, 1), even - even[0])
    window = np.hanning(len(even))
    count = 8 * len(even)
    power = 2 * step * np.abs(np.fft.rfft(values * window, count)) ** 2 / (window**2).sum()
    return np.fft.rfftfreq(count, step), power


def puffing_frequency(time_s: np.ndarray, signals: np.ndarray) -> float:
    """Hz of the strongest swing that the signals (N, P) share; NaN where there is none.

    Looked for from two periods in the record up to 30 Hz. Signals are weighed equally: each one's spectrum is divided
    by its own total.
    """
    duration = time_s[-1] - time_s[0] if len(time_s) > 16 else 0.0
    if duration <= 0:
        return math.nan
    shared = 0.0
    for signal in signals.T:
        frequency, power = spectrum(time_s, signal)
        band = (frequency >= 2 / duration) & (frequency <= 30)
        if not band.any() or not power[band].sum() > 0:
            continue
        shared = shared + power[band] / power[band].sum()
    return float(frequency[band][np.argmax(shared)]) if np.ndim(shared) else math.nan


def flicker(time_s: np.ndarray, light: np.ndarray) -> tuple[float, float]:
    """Return (share, slope) of a flame's flicker between 15 and 40 Hz.

    Args:
        light: (T,) of the whole flame.
    Returns:
        share: root mean square of the light's changes at those frequencies over its mean. slope: n of power ~ f^n
            there. NaN where the frame rate is too low to see them, or the clip too short (0.15 s).
    """
    low, high = FLICKER_HZ
    if len(light) < 4 or np.median(np.diff(time_s)) > 0.5 / high or time_s[-1] - time_s[0] < 0.15:
        return math.nan, math.nan
    frequency, power = spectrum(time_s, light / light.mean())
    band = (frequency >= low) & (frequency <= high)
    share = math.sqrt(power[band].sum() * (frequency[1] - frequency[0]))
    return share, power_law(frequency[band], power[band])[1]


def rise_speed(time_s: np.ndarray, height: np.ndarray, light: np.ndarray, band: tuple[float, float]) -> float:
    """Return speed at which bright structures rise through a band of heights, in units of `height` a second.

    A height's light, over its own mean in time and without its straight trend, is compared with that of a later frame
    higher up: the speed at which the two are most alike, over one to LAGS frames at once.

    Args:
        time_s: (T,) evenly spaced.   height: (Z,) evenly spaced, rising.   light: (T, Z), 0 or more.
        band: lowest and highest height.
    Returns:
        NaN where no speed gives a correlation of ALIKE, or the best one lies at the end of what was tried: from 0 to
        what crosses the band in a frame and a half.
    """
    changes, step = _changes(time_s, light), float(np.median(np.diff(time_s)))
    rows = np.nonzero((height >= band[0]) & (height <= band[1]))[0]
    if len(rows) < 4 or len(time_s) < LAGS + 3:
        return math.nan
    fastest = (height[rows[-1]] - height[rows[0]]) / (1.5 * step)
    speeds = np.linspace(0, fastest, 121)
    scores = np.array([_likeness(changes, height, rows, speed * step) for speed in speeds])
    best = int(np.argmax(scores))
    if not scores[best] >= ALIKE or best in (0, len(speeds) - 1):
        return math.nan
    a, b, c = scores[best - 1 : best + 2]
    bend = a - 2 * b + c
    return float(speeds[best] + (speeds[1] * 0.5 * (a - c) / bend if bend < 0 else 0.0))


def _changes(time_s: np.ndarray, light: np.ndarray) -> np.ndarray:
    """Return (T, Z) of light over its mean, without its straight trend; 0 where a height is dark."""
    mean = light.mean(0)
    lit = mean > 1e-3 * mean.max()
    relative = np.divide(light, mean, out=np.ones_like(light, dtype=float), where=lit)
    clock = time_s - time_s.mean()
    trend = clock @ relative / (clock @ clock)
    return relative - relative.mean(0) - clock[:, None] * trend


def _likeness(changes: np.ndarray, height: np.ndarray, rows: np.ndarray, per_frame: float) -> float:
    """Correlation of the changes at some rows with later ones, so much higher a frame; below the top only."""
    product = below2 = above2 = 0.0
    for lag in range(1, LAGS + 1):
        higher = height[rows] + lag * per_frame
        inside = rows[higher <= height[-1]]
        place = (height[inside] + lag * per_frame - height[0]) / (height[1] - height[0])
        low = np.minimum(place.astype(int), len(height) - 2)
        part = place - low
        below = changes[:-lag, inside]
        above = changes[lag:, low] * (1 - part) + changes[lag:, low + 1] * part
        product, below2, above2 = product + (below * above).sum(), below2 + (below**2).sum(), above2 + (above**2).sum()
    return product / math.sqrt(below2 * above2) if below2 > 0 and above2 > 0 else 0.0


# ----------------------------------------------------------------
# Laws measured on real fires, all of free fires in still air: jets leave the first where their own momentum carries
# them, wind leaves all of them.
#
# - McCaffrey, *Purely Buoyant Diffusion Flames: Some Experimental Results*, NBSIR 79-1910, 1979: speed and
# temperature on the axis of a 0.3 m square natural-gas burner of 14 to 58 kW, in three zones of height.
# - Heskestad, *Luminous heights of turbulent diffusion flames*, Fire Safety Journal 5, 1983: mean visible height.
# - Cetegen and Ahmed, *Experiments on the periodic instability of buoyant plumes and pool fires*, Combustion and
# Flame 93, 1993: puffing frequency of pool fires of 0.03 to 60 m.

# McCaffrey's zones: up to z / Q^(2/5) in m/kW^(2/5), k, and exponent eta of u / Q^(1/5) = k (z / Q^(2/5))^eta.
ZONES = ((0.08, 6.8, 0.5), (0.20, 1.9, 0.0), (math.inf, 1.1, -1 / 3))


def _zone(height_m: np.ndarray, heat_release_kw: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return (scaled height, k, eta) at heights above the burner."""
    scaled = np.maximum(np.asarray(height_m, float), 1e-9) / heat_release_kw**0.4
    limits = [limit for limit, _, _ in ZONES]
    k, eta = np.array([zone[1:] for zone in ZONES])[np.searchsorted(limits, scaled)].T
    return scaled, k, eta


def mccaffrey_speed(height_m: np.ndarray, heat_release_kw: float) -> np.ndarray:
    """Return mean vertical speed on the axis (m/s) at heights (m) above the burner: continuous flame, intermittent,
    plume."""
    scaled, k, eta = _zone(height_m, heat_release_kw)
    return heat_release_kw**0.2 * k * scaled**eta


def heskestad_height(heat_release_kw: float, diameter_m: float) -> float:
    """Return mean height of the visible flame (m): 0.235 Q^(2/5) - 1.02 D, at least 0."""
    return max(0.0, 0.235 * heat_release_kw**0.4 - 1.02 * diameter_m)


def heskestad_heat(height_m: float, diameter_m: float) -> float:
    """Return heat release (kW) of a fire whose visible flame has this mean height (m): Heskestad's law, solved for
    Q."""
    return ((height_m + 1.02 * diameter_m) / 0.235) ** 2.5


def puffing_law(diameter_m: float) -> float:
    """Frequency (Hz) at which a pool fire sheds its vortices: 1.5 / sqrt(D)."""
    return 1.5 / math.sqrt(diameter_m)
