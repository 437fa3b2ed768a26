"""The fine clock: five strips lit one after another, read through a rolling shutter.

Time unit: microseconds. A point p of frame k is exposed around board time t_k + d(p), with t_k the mid-exposure time of
the picture's centre and d the row delay. The point shows a periodic curve h_s(t_k + d(p)) of its strip s. The
curves are learned from the footage itself, so exposure, saturation, codec smear and strips wired together need no
model; a curve's symmetry pins its centre to the middle of the strip's slot, because exposure and brightness response
change both flanks of a mid-exposure curve alike.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gof.core.errors import GofError

BIN_US = 20.0  # of the learned curves: a fraction of the shortest flank, that of a 100 us exposure
HUBER = 1.345  # standard deviations; 95 % efficient on Gaussian noise (Huber, Robust Statistics)
TUKEY = 4.685  # standard deviations; the same efficiency for the biweight
MAD_TO_SIGMA = 1.4826  # of a Gaussian
MIN_POINTS = 8  # of use, for a strip to count as alive
MIN_CONTRAST = 15.0  # grey levels between dark and lit; noise and codec move points by a few
MAX_CONDITION = 6.0  # of the harmonic basis: above, the frames' phases are bunched
# A frame moves to another minimum when that leaves less than MUCH_BETTER of its residual, and by more than noise: a
# frame without an edge in view fits many times about equally. Both figures by trial on rendered footage.
MUCH_BETTER = 0.6
NOISE_LEVEL = 0.005  # of the brightness 0..1
SEARCH_STEP_US = 40.0  # two bins; the flanks around a minimum are longer
# Steps of one round, so that a wrong curve of the first rounds cannot throw a frame out of its minimum.
MAX_TIME_STEP_US = 150.0
MAX_ROW_STEP = 0.2  # us per pixel
MAX_SMALL_ROW_STEP = 0.1  # where the row time is below 1 us per pixel
TIED = 0.85  # correlation of two strips' curves; strips of their own overlap at most in a flank


class NotDecodable(GofError):
    """The board is visible but its signals do not determine the time; the message says why and what to change."""


@dataclass(frozen=True)
class StripReadings:
    """The readings of T frames at J points along each of S strips.

    Attributes:
        value: (T, S, J) brightness, 0 dark to 1 lit, per point.
        usable: (S, J) points that are visible and flicker.
        axis: of the readout in the picture, 0 = x, 1 = y.
        position: (S, J) pixel coordinate along that axis, relative to the picture's centre.
        slot: (S,) nominal slot of each strip.
    """

    value: np.ndarray
    usable: np.ndarray
    axis: int
    position: np.ndarray
    slot: np.ndarray

    @property
    def alive(self) -> np.ndarray:
        """(S,) strips that can be read."""
        return self.usable.sum(1) >= MIN_POINTS


@dataclass
class StripFit:
    """Result of `fit`. All times in us.

    Attributes:
        time: (T,) each frame's own measured mid-exposure time at the picture's centre.
        sigma: (T,) standard error of `time`, scaled to the scatter about a steady clock.
        row_time: signed delay per pixel along the readings' axis.
        curve: (S, B) learned brightness 0..1 over the period; centre_error (S,) its centre minus the slot's, after
            removing the common part (strips of no use: NaN).
        slots: for each strip the slots it is lit in (more than one when strips are tied).
        faults: wiring faults in words.
    """

    time: np.ndarray
    sigma: np.ndarray
    row_time: float
    curve: np.ndarray
    centre_error: np.ndarray
    slots: list[tuple[int, ...]]
    faults: list[str]


def normalise(strip: np.ndarray, visible: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (T, S, J) raw brightness to 0..1 per point between its dark and lit levels; and the points of use (S, J):
    visible, and with MIN_CONTRAST between dark and lit."""
    low, high = np.percentile(strip, [3, 97], axis=0)
    usable = visible & (high - low > MIN_CONTRAST)
    return (strip - low) / np.maximum(high - low, 1.0), usable


def coarse_phase(seen: StripReadings, period: float) -> np.ndarray:
    """Return (T,) mid-exposure time modulo the period from which strips are bright, to a fraction of a slot.

    Raises: NotDecodable: fewer than three strips flicker.
    """
    alive = seen.alive
    if alive.sum() < 3:
        raise NotDecodable(f"only {alive.sum()} of {len(alive)} strips flicker; are they cut off, dead or hidden?")
    mean = np.stack([seen.value[:, s, seen.usable[s]].mean(1) for s in np.flatnonzero(alive)], 1)
    angle = 2 * np.pi * (seen.slot[alive] + 0.5) / len(seen.slot)
    resultant = (np.clip(mean, 0, 1) * np.exp(1j * angle)).sum(1)
    return np.angle(resultant) / (2 * np.pi) * period % period


def row_time_from_fundamental(seen: StripReadings, time: np.ndarray, period: float) -> float | None:
    """Delay per pixel of `position` along the strips, from the phase of the period's first harmonic at each point; None
    when the frames' phases cover the period too poorly."""
    omega = 2 * np.pi / period
    basis = np.stack([np.ones_like(time), np.cos(omega * time), np.sin(omega * time)], 1)
    if np.linalg.cond(basis) > MAX_CONDITION:
        return None
    coefficients = np.linalg.lstsq(basis, seen.value.reshape(len(time), -1), rcond=None)[0]
    _, cosine, sine = coefficients.reshape(3, *seen.usable.shape)
    slopes, weights = [], []
    for s in np.flatnonzero(seen.alive):
        u = seen.usable[s]
        # value = h(t + d - c): the fundamental's phase is d - c.
        phase = np.unwrap(np.angle(cosine[s, u] - 1j * sine[s, u])) / omega
        x = seen.position[s, u] - seen.position[s, u].mean()
        slopes.append((x * phase).sum() / (x * x).sum())
        weights.append((x * x).sum())
    return float(np.average(slopes, weights=weights)) if slopes else None


def sharpen_interval(seen: StripReadings, index: np.ndarray, interval: float, period: float) -> float:
    """Return the frame interval near `interval` at which the points' first harmonics add up best: a periodogram, good
    to a small part of the period over the whole clip. `index` are positions on a steady clock."""
    points = seen.value[:, seen.usable] - seen.value[:, seen.usable].mean(0)
    span = max(float(np.ptp(index)), 1.0)
    options = interval + period / span * np.linspace(-0.5, 0.5, 51)
    phases = np.exp(-2j * np.pi / period * np.outer(options, index))
    power = (np.abs(phases @ points) ** 2).sum(1)
    k = int(power.argmax())
    if not 0 < k < len(options) - 1:
        return float(options[k])
    a, b, c = power[k - 1 : k + 2]
    bend = a - 2 * b + c
    top = 0.5 * (a - c) / bend if bend < 0 else 0.0  # of the parabola through the three, in steps from the middle
    return float(options[k] + top * (options[1] - options[0]))


def fit(
    seen: StripReadings,
    line: np.ndarray,
    period: float,
    row_time: float,
    free_row_time: bool = True,
    steady: bool = True,
    iterations: int = 6,
) -> StripFit:
    """Learn the strips' curves and every frame's time, in turns.

    Args:
        line: (T,) first times on the board clock, right to a fraction of a slot, from a steady or linked clock.
        period: of the board, us.
        row_time: signed start value, us per pixel of position; refined when free_row_time.
        steady: learn curves with times on a straight line through the measured ones (camera clocks are steady to far
            below a microsecond over seconds); otherwise with the measured times.
    """
    steady_line = steady and len(line) >= 3
    index = np.rint((line - line[0]) / max(np.median(np.diff(line)), 1e-9)) if len(line) > 1 else np.zeros(1)
    strip, point = np.nonzero(seen.usable)
    x = seen.position[strip, point]
    raw = seen.value[:, strip, point]
    value, time = raw, line.copy()
    for iteration in range(iterations):
        reference = line if steady else time
        curve = _learn(value, reference[:, None] + row_time * x, strip, len(seen.slot), period)
        if iteration == iterations - 2 or (iteration == 0 and not steady):  # a frame may sit in a wrong minimum
            few = slice(None, None, 4)  # plenty for a start
            time = _search(value[:, few], curve, strip[few], reference, row_time * x[few], period)
        for _ in range(2):
            step, row_step, sigma = _gauss_newton(value, curve, strip, time, row_time, x, period, free_row_time)
            time = time + np.clip(step, -MAX_TIME_STEP_US, MAX_TIME_STEP_US)
            limit = MAX_SMALL_ROW_STEP if abs(row_time) < 1 else MAX_ROW_STEP
            row_time += float(np.clip(row_step, -limit, limit))
        if steady_line:
            line = robust_line(index, time, sigma)[0]
        # Lit and dark levels per point: frames rarely show a point both fully lit and fully dark.
        model = _evaluate(curve, strip, (line if steady else time)[:, None] + row_time * x, period)[0]
        value = _relevel(raw, model)
    slots, faults = _wiring(curve, seen)
    shift, centre_error = _anchor(curve, slots, period)
    time = time - shift
    scatter = np.sqrt(np.mean(sigma**2)) or 1.0
    about_line = robust_scale(time - robust_line(index, time, sigma)[0]) if steady_line else scatter
    sigma = sigma * max(1.0, about_line / scatter)
    return StripFit(time, sigma, row_time, _moved(curve, shift, period), centre_error, slots, faults)


def _moved(curve: np.ndarray, shift: float, period: float) -> np.ndarray:
    """Return (S, B) the curves `shift` us later."""
    bins = curve.shape[1]
    grid = np.arange(bins)
    return np.stack([np.interp((grid + shift * bins / period) % bins, grid, c, period=bins) for c in curve])


def robust_scale(r: np.ndarray) -> float:
    """Return standard deviation of the bulk: 1.4826 times the median absolute deviation, 0 for an empty array."""
    return float(MAD_TO_SIGMA * np.median(np.abs(r - np.median(r)))) if len(r) else 0.0


def robust_line(
    index: np.ndarray, time: np.ndarray, sigma: np.ndarray | None = None
) -> tuple[np.ndarray, float, np.ndarray]:
    """Straight line through (index, time) by iteratively reweighted least squares (Tukey), started from a
    repeated-median slope, so that up to half the frames may be wrong. Frames whose standard error is far above the
    others' count less. Returns fitted times, slope, weights in 0..1."""
    n = len(index)
    prior = np.ones(n) if sigma is None else np.minimum(1.0, (2 * np.median(sigma) / np.maximum(sigma, 1e-9)) ** 2)
    pick = np.unique(np.linspace(0, n - 1, min(n, 200)).astype(int))
    di = index[pick][:, None] - index[pick][None]
    dt = time[pick][:, None] - time[pick][None]
    slope = np.median(
        [np.median(t[d != 0] / d[d != 0]) for d, t in zip(di, dt, strict=True) if (d != 0).any()] or [0.0]
    )
    start = np.median(time - slope * index)
    weight = prior
    for _ in range(20):
        r = time - start - slope * index
        scale = max(robust_scale(r), 1e-3)
        weight = np.clip(1 - (r / (TUKEY * scale)) ** 2, 0, None) ** 2 * prior
        if weight.sum() < 2 or np.ptp(index[weight > 0]) == 0:
            break
        m = np.average(index, weights=weight)
        mt = np.average(time, weights=weight)
        slope = (weight * (index - m) * (time - mt)).sum() / (weight * (index - m) ** 2).sum()
        start = mt - slope * m
    return start + slope * index, float(slope), weight


def _learn(value: np.ndarray, time: np.ndarray, strip: np.ndarray, strips: int, period: float) -> np.ndarray:
    """Return (S, B) mean brightness over the period in linearly shared bins; empty bins are interpolated.

    Args:
        value, time: (T, N) brightness of N points and when they were exposed.   strip: (N,) their strip.
    """
    bins = round(period / BIN_US)
    grid = np.arange(bins)
    place = time / period % 1.0 * bins
    left = np.floor(place).astype(int)
    part = place - left
    clipped = np.clip(value, -0.5, 1.5)
    curve = np.zeros((strips, bins))
    for s in np.unique(strip):
        at = strip == s
        i, f, y = left[:, at].ravel() % bins, part[:, at].ravel(), clipped[:, at].ravel()
        j = (i + 1) % bins
        weight = _smoothed(np.bincount(i, 1 - f, bins) + np.bincount(j, f, bins))
        total = _smoothed(np.bincount(i, (1 - f) * y, bins) + np.bincount(j, f * y, bins))
        full = weight > 0.3  # of a reading
        curve[s] = np.interp(grid, grid[full], total[full] / weight[full], period=bins)
    return curve


def _smoothed(bins: np.ndarray) -> np.ndarray:
    """Lightly: neighbours count a quarter each."""
    return np.roll(bins, 1) / 4 + bins / 2 + np.roll(bins, -1) / 4


def _evaluate(curve: np.ndarray, strip: np.ndarray, time: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    """h and dh/dt (per us) of N points at their times (T, N)."""
    bins = curve.shape[1]
    place = time / period % 1.0 * bins
    left = np.floor(place).astype(int) % bins
    right = (left + 1) % bins
    part = place - np.floor(place)
    a, b = curve[strip, left], curve[strip, right]
    # The derivative is that of the smooth curve, not of one segment.
    slope = (np.roll(curve, -1, 1) - np.roll(curve, 1, 1)) / 2
    derivative = slope[strip, left] * (1 - part) + slope[strip, right] * part
    return a + part * (b - a), derivative * bins / period


def _search(
    value: np.ndarray, curve: np.ndarray, strip: np.ndarray, time: np.ndarray, delay: np.ndarray, period: float
) -> np.ndarray:
    """Return (T,) better times within half a period of the given ones, by least absolute residual on a grid. A frame
    moves only when that explains it much better.

    Args:
        value: (T, N) brightness of N points.   strip, delay: (N,) their strip and their delay.
    """

    def residual(shift: float) -> np.ndarray:
        model, _ = _evaluate(curve, strip, (time + shift)[:, None] + delay, period)
        return np.abs(value - model).mean(1)

    least = MUCH_BETTER * residual(0.0) - NOISE_LEVEL
    found = time.copy()
    for shift in np.arange(-period / 2, period / 2, SEARCH_STEP_US):
        candidate = residual(shift)
        better = candidate < least
        least = np.where(better, candidate, least)
        found = np.where(better, time + shift, found)
    return found


def _gauss_newton(
    value: np.ndarray,
    curve: np.ndarray,
    strip: np.ndarray,
    time: np.ndarray,
    row_time: float,
    x: np.ndarray,
    period: float,
    free_row_time: bool,
) -> tuple[np.ndarray, float, np.ndarray]:
    """Return one robust step for every frame's time and the shared row time: normal equations in which each frame's own
    unknown is eliminated (Schur complement).

    Returns:
        (T,) time steps; row time step; (T,) standard errors of the times.
    """
    h, dh = _evaluate(curve, strip, time[:, None] + row_time * x, period)
    r = value - h
    scale = max(robust_scale(r.ravel()), 0.01)
    w = np.minimum(1.0, HUBER * scale / np.maximum(np.abs(r), 1e-9))
    tt = (w * dh * dh).sum(1) + 1e-12
    t_r = (w * dh * r).sum(1)
    row_step = 0.0
    if free_row_time:
        tx = (w * dh * dh * x).sum(1)
        xx = (w * dh * dh * x * x).sum()
        x_r = (w * dh * r * x).sum()
        left = xx - (tx * tx / tt).sum()
        if left > 1e-9 * xx:
            row_step = (x_r - (tx * t_r / tt).sum()) / left
        t_r = t_r - tx * row_step
    rms = float(np.sqrt((w * r * r).sum() / w.sum()))
    return t_r / tt, row_step, rms / np.sqrt(tt)


def _relevel(raw: np.ndarray, model: np.ndarray) -> np.ndarray:
    """Return (T, N) brightness with gain and offset of every point such that it matches the curve; points that hardly
    change, or would need more than a factor of three, keep theirs."""
    m, y = model.mean(0), raw.mean(0)
    spread = ((model - m) ** 2).sum(0)
    gain = ((model - m) * (raw - y)).sum(0) / np.maximum(spread, 1e-9)
    ok = (spread > 0.05 * len(raw)) & (gain > 0.3) & (gain < 3)
    gain = np.where(ok, gain, 1.0)
    offset = np.where(ok, y - gain * m, 0.0)
    return (raw - offset) / gain


def _edges(curve: np.ndarray, period: float) -> tuple[float, float] | None:
    """Rising and falling half-level times of one curve (falling after rising), None without a clear lit interval."""
    low, high = np.percentile(curve, [2, 98])
    if high - low < 0.3:
        return None
    above = curve > (low + high) / 2
    if above.all() or not above.any():
        return None
    bins = len(curve)
    start = int(np.argmin(above))  # begin in the dark
    rolled, lit = np.roll(curve, -start) - (low + high) / 2, np.roll(above, -start)
    runs = np.flatnonzero(np.diff(lit.astype(int)))
    ups, downs = runs[::2], runs[1::2]
    if len(downs) < len(ups):
        downs = np.append(downs, bins - 1)
    longest = int(np.argmax(downs - ups))

    def cross(i):
        return i + rolled[i] / (rolled[i] - rolled[(i + 1) % bins] or 1e-9)

    return tuple((cross(int(i)) + start) * period / bins for i in (ups[longest], downs[longest]))


def _wiring(curve: np.ndarray, seen: StripReadings) -> tuple[list[tuple[int, ...]], list[str]]:
    """Return which slots each strip is lit in, and faults in words."""
    alive, slot = seen.alive, seen.slot
    faults = [f"strip {slot[s]} does not flicker: dead, stuck or hidden" for s in np.flatnonzero(~alive)]
    groups: list[list[int]] = []
    for s in np.flatnonzero(alive):
        for group in groups:
            if np.corrcoef(curve[s], curve[group[0]])[0, 1] > TIED:
                group.append(s)
                break
        else:
            groups.append([s])
    slots: list[tuple[int, ...]] = [()] * len(slot)
    for group in groups:
        shared = tuple(sorted(int(slot[s]) for s in group))
        for s in group:
            slots[s] = shared
        if len(group) > 1:
            faults.append(
                f"strips {', '.join(map(str, shared))} are tied together: all are lit in slots "
                f"{shared[0]}..{shared[-1]}"
            )
    return slots, faults


def _anchor(curve: np.ndarray, slots: list[tuple[int, ...]], period: float) -> tuple[float, np.ndarray]:
    """Return the common shift of the learned curves against the slots (us), and each strip's own remainder (S,).

    Raises: NotDecodable: no curve has edges.
    """
    strips = len(slots)
    error = np.full(strips, np.nan)
    for s in range(strips):
        edges = _edges(curve[s], period) if slots[s] else None
        if edges:
            centre = period / strips * (np.mean(slots[s]) + 0.5)
            error[s] = (np.mean(edges) - centre + period / 2) % period - period / 2
    good = np.isfinite(error)
    if not good.any():
        raise NotDecodable("no strip shows a lit and a dark interval; is the exposure longer than the board's period?")
    # On a circle: a common shift near half a period must not average to zero.
    angle = np.exp(2j * np.pi * error[good] / period)
    near = np.angle(angle.mean()) / (2 * np.pi) * period
    rest = (error - near + period / 2) % period - period / 2
    single = np.array([len(x) == 1 for x in slots]) & good
    shift = np.median(rest[single] if single.sum() >= 2 else rest[good])
    return near + shift, rest - shift


def estimate_exposure(curve: np.ndarray, slots: list[tuple[int, ...]], period: float) -> tuple[float, float] | None:
    """Exposure (us) and saturation gain (1 = none) that explain the learned curves as min(1, gain * overlap of exposure
    and slot / the largest overlap); None when every strip is tied or dead. Informative: times do not depend on it."""
    single = [s for s, x in enumerate(slots) if len(x) == 1]
    if not single:
        return None
    bins = curve.shape[1]
    slot = period / len(slots)
    grid = np.arange(bins) * period / bins
    lined = []
    for s in single:
        edges = _edges(curve[s], period)
        if edges:
            lined.append(np.interp((grid + np.mean(edges)) % period, grid, curve[s], period=period))
    if not lined:
        return None
    mean = np.median(lined, 0)
    low, high = np.percentile(mean, [2, 98])
    mean = (mean - low) / (high - low)
    away = np.minimum(grid, period - grid)
    best = (np.inf, 0.0, 1.0)
    for exposure in np.geomspace(20, 0.75 * period, 90):
        overlap = np.clip((slot + exposure) / 2 - away, 0, min(slot, exposure)) / min(slot, exposure)
        for gain in (1, 1.3, 1.7, 2.2, 3, 4, 6, 9, 13, 20):
            cost = np.abs(np.minimum(1, gain * overlap) - mean).mean()
            if cost < best[0]:
                best = (cost, float(exposure), float(gain))
    return best[1:]
