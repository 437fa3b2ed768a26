"""Is a fire real? Laws measured on real fires, and the same figures taken from a fire's truth.

Laws, all of free fires in still air (a jet leaves McCaffrey's where its own momentum carries it, wind all of them):

- McCaffrey, *Purely Buoyant Diffusion Flames: Some Experimental Results*, NBSIR 79-1910, 1979: speed and temperature on
  the axis of a 0.3 m square natural-gas burner of 14 to 58 kW, in three zones of height.
- Heskestad, *Luminous heights of turbulent diffusion flames*, Fire Safety Journal 5, 1983: mean visible height.
- Cetegen and Ahmed, *Experiments on the periodic instability of buoyant plumes and pool fires*, Combustion and
  Flame 93, 1993: puffing frequency of pool fires of 0.03 to 60 m.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from gof_benchmark.solvers.grids import FireGrids, FireHistory, Hearth

GRAVITY, AMBIENT_K = 9.81, 293.15
# McCaffrey's zones: up to z / Q^(2/5) in m/kW^(2/5), k, and exponent eta of u / Q^(1/5) = k (z / Q^(2/5))^eta.
ZONES = ((0.08, 6.8, 0.5), (0.20, 1.9, 0.0), (math.inf, 1.1, -1 / 3))
VISIBLE = 0.05  # of the flame's brightest: what a picture still shows


def mccaffrey_speed(height_m: np.ndarray, heat_release_kw: float) -> np.ndarray:
    """Mean vertical speed on the axis (m/s) at heights (m) above the burner: continuous flame, intermittent, plume."""
    scaled = np.maximum(np.asarray(height_m, float), 1e-9) / heat_release_kw**0.4
    limits = [limit for limit, _, _ in ZONES]
    k, eta = np.array([zone[1:] for zone in ZONES])[np.searchsorted(limits, scaled)].T
    return heat_release_kw**0.2 * k * scaled**eta


def mccaffrey_excess(height_m: np.ndarray, heat_release_kw: float) -> np.ndarray:
    """Mean temperature above ambient on the axis (K), with McCaffrey's constant 0.9."""
    scaled = np.maximum(np.asarray(height_m, float), 1e-9) / heat_release_kw**0.4
    limits = [limit for limit, _, _ in ZONES]
    k, eta = np.array([zone[1:] for zone in ZONES])[np.searchsorted(limits, scaled)].T
    return (k / (0.9 * math.sqrt(2 * GRAVITY))) ** 2 * scaled ** (2 * eta - 1) * AMBIENT_K


def heskestad_height(heat_release_kw: float, diameter_m: float) -> float:
    """Mean height of the visible flame (m): 0.235 Q^(2/5) - 1.02 D, at least 0."""
    return max(0.0, 0.235 * heat_release_kw**0.4 - 1.02 * diameter_m)


def puffing_law(diameter_m: float) -> float:
    """Frequency (Hz) at which a pool fire sheds its vortices: 1.5 / sqrt(D)."""
    return 1.5 / math.sqrt(diameter_m)


def power_law(height_m: np.ndarray, speed_m_s: np.ndarray) -> tuple[float, float]:
    """(c, n) of speed = c z^n, least squares of the logarithms; NaN for fewer than two rising points."""
    good = (np.asarray(height_m) > 0) & (np.asarray(speed_m_s) > 0)
    if good.sum() < 2:
        return math.nan, math.nan
    exponent, logarithm = np.polyfit(np.log(height_m[good]), np.log(speed_m_s[good]), 1)
    return float(np.exp(logarithm)), float(exponent)


def axis_speed(velocity: Iterable[np.ndarray], columns: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """(Z,) m/s: vertical speed averaged over the frames' (X, Y, Z, 3) velocities and the columns of `axis_columns`."""
    x, y = columns
    return np.mean([frame[x, y, :, 2].mean(0) for frame in velocity], axis=0, dtype=float)


def axis_columns(fire: FireGrids, hearth: Hearth) -> tuple[np.ndarray, np.ndarray]:
    """(x, y) cell numbers of the columns within a voxel or a tenth of the burner of its axis, at least the nearest."""
    x, y = np.meshgrid(fire.centers(0), fire.centers(1), indexing="ij")
    distance = np.hypot(x - hearth.position_m[0], y - hearth.position_m[1])
    return np.nonzero(distance <= max(distance.min() + 1e-9, fire.voxel_m, 0.1 * hearth.diameter_m))


def light_speed(velocity: Iterable[np.ndarray], light: Iterable[np.ndarray]) -> np.ndarray:
    """(Z,) m/s: mean vertical speed of the shining gas at each height, weighted by (X, Y, Z) light; NaN in the dark."""
    total = moved = 0.0
    for v, e in zip(velocity, light, strict=True):
        total = total + e.sum((0, 1), dtype=float)
        moved = moved + (e * v[..., 2]).sum((0, 1), dtype=float)
    return np.divide(moved, total, out=np.full_like(total, np.nan), where=total > 1e-6 * np.max(total))


def flame_height(light: Iterable[np.ndarray], height_m: np.ndarray) -> float:
    """Height (m) below which the visible flame stands at least half of the time.

    Seen from the side: a height is lit when some horizontal line of sight through it shines with at least VISIBLE of
    the brightest such line of the whole clip.

    Args:
        light: per frame (X, Y, Z) emission. height_m: (Z,) of the cells' centres above the burner.
    """
    seen = np.array([np.concatenate([e.sum(0), e.sum(1)]).max(0) for e in light])
    if not seen.max() > 0:
        return 0.0
    share = (seen > VISIBLE * np.quantile(seen.max(1), 0.9)).mean(0)
    lit = np.nonzero(share >= 0.5)[0]
    return float(height_m[lit[-1]] + (height_m[1] - height_m[0]) / 2) if len(lit) else 0.0


def spectrum(time_s: np.ndarray, signal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(frequency Hz, power) of an unevenly sampled signal: its straight trend removed, Hann's window, 8 times finer
    than the record's own resolution 1 / duration."""
    step = np.median(np.diff(time_s))
    even = np.arange(time_s[0], time_s[-1], step)
    values = np.interp(even, time_s, signal)
    values = (values - np.polyval(np.polyfit(even, values, 1), even)) * np.hanning(len(even))
    count = 8 * len(even)
    return np.fft.rfftfreq(count, step), np.abs(np.fft.rfft(values, count)) ** 2


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


def heat_release_kw(heat_release: np.ndarray, voxel_m: float) -> float:
    """kW of a frame's (X, Y, Z) W/m3."""
    return float(heat_release.sum(dtype=float)) * voxel_m**3 / 1e3


@dataclass(frozen=True)
class Plausibility:
    """One fire beside the laws, measured on its truth; NaN (None in JSON) where it cannot be said.

    Args:
        heat_kw, heat_nominal_kw: burnt in the grids' box, mean of the clip; what the burners' fuel would give.
        rise_ratio: axis speed over McCaffrey's 6.8 sqrt(z), mean between 0.02 and 0.08 Q^(2/5).
        rise_exponent: of the axis speed in that zone; 0.5.
        plateau_ratio: axis speed over McCaffrey's in the intermittent zone, 0.08 to 0.20 Q^(2/5).
        light_ratio, light_exponent: as the first two for the shining gas, wherever it is.
        height_m, height_law_m: visible flame; Heskestad's.
        puffing_hz, puffing_law_hz, puffing_resolution_hz: from the history's probes up to two diameters.
        hottest_k: of any cell and frame. fastest_m_s: likewise.
        cpu_s: seconds of one core that the fire took.
    """

    name: str
    heat_kw: float
    heat_nominal_kw: float
    rise_ratio: float
    rise_exponent: float
    plateau_ratio: float
    light_ratio: float
    light_exponent: float
    height_m: float
    height_law_m: float
    puffing_hz: float
    puffing_law_hz: float
    puffing_resolution_hz: float
    hottest_k: float
    fastest_m_s: float
    cpu_s: float


def plausibility(fire: FireGrids) -> Plausibility:
    """Take every figure from a fire; its first hearth is the one whose axis is looked at.

    Raises:
        DataFormatError: a frame is damaged.
        ValueError: the fire names no hearth.
    """
    if not fire.description.hearths:
        raise ValueError(f"{fire.path}: no hearth in fire.json, so there is no law to compare with")
    hearth, total_kw = fire.description.hearths[0], sum(h.heat_release_kw for h in fire.description.hearths)
    frames = range(len(fire.times_s))

    def velocity():
        return (fire.velocity.frame(k).velocity for k in frames)

    def light():
        return (fire.grids["emission"].frame(k).sum(-1) for k in frames)

    z = fire.centers(2) - hearth.position_m[2]
    scaled = z / hearth.heat_release_kw**0.4
    low, middle = (scaled > 0.02) & (scaled < ZONES[0][0]), (scaled >= ZONES[0][0]) & (scaled < ZONES[1][0])
    law = mccaffrey_speed(z, hearth.heat_release_kw)
    axis, shining = axis_speed(velocity(), axis_columns(fire, hearth)), light_speed(velocity(), light())
    heat = fire.grids.get("heat_release")
    hot = fire.grids.get("temperature")
    puffing, resolution = _puffing(fire.history, hearth)
    return Plausibility(
        name=fire.description.name,
        heat_kw=float(np.mean([heat_release_kw(heat.frame(k), fire.voxel_m) for k in frames])) if heat else math.nan,
        heat_nominal_kw=total_kw,
        rise_ratio=_mean(axis[low] / law[low]),
        rise_exponent=power_law(z[low], axis[low])[1],
        plateau_ratio=_mean(axis[middle] / law[middle]),
        light_ratio=_mean(shining[low] / law[low]),
        light_exponent=power_law(z[low], shining[low])[1],
        height_m=flame_height(light(), z),
        height_law_m=heskestad_height(hearth.heat_release_kw, hearth.diameter_m),
        puffing_hz=puffing,
        puffing_law_hz=puffing_law(hearth.diameter_m),
        puffing_resolution_hz=resolution,
        hottest_k=max(float(hot.frame(k).max()) for k in frames) if hot else math.nan,
        fastest_m_s=max(float(np.linalg.norm(v, axis=-1).max()) for v in velocity()),
        cpu_s=sum(fire.description.cpu_s.values()),
    )


def _mean(values: np.ndarray) -> float:
    return float(np.nanmean(values)) if np.isfinite(values).any() else math.nan


def _puffing(history: FireHistory | None, hearth: Hearth) -> tuple[float, float]:
    """(Hz, resolution Hz) from the probes up to two diameters above the burner."""
    if history is None or len(history.time_s) < 2:
        return math.nan, math.nan
    time_s, rise = np.array(history.time_s), np.array(history.rise_m_s)
    heights = np.array(history.probe_position_m)[:, 2] - hearth.position_m[2]
    near = rise[:, heights <= max(2 * hearth.diameter_m, heights.min())]
    return puffing_frequency(time_s, near), 1 / float(time_s[-1] - time_s[0])
