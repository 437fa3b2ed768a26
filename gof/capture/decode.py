"""One camera's signals -> the time of every frame on the board's clock."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from gof.capture import clock, counter, strips
from gof.capture.signals import Signals
from gof.capture.strips import NotDecodable
from gof.capture.template import BoardTemplate

READOUT = {(0, 1): "right", (0, -1): "left", (1, 1): "down", (1, -1): "up"}


@dataclass(frozen=True)
class DecodeOptions:
    """What is known beforehand; None = estimated from the footage."""

    period_us: float = 4000.0
    fps: float | None = None
    row_time_us: float | None = None  # per image line, >= 0
    readout: str | None = None  # down, up, left, right
    clock: str = "steady"  # "steady" or "free"
    iterations: int = 6  # rounds of learning the strips' curves and the frames' times from each other


@dataclass
class CameraTimes:
    """Times of one camera. Times are mid-exposure at the picture's centre; a pixel's own time adds row_time_us times its
    distance from the centre line in the readout direction.

    Args:
        time_us: (T,) fused board time; sigma_us (T,) its standard error.
        measured_us: (T,) each frame's own measurement; used (T,) False for outliers.
        clock_index: (T,) position on the camera's steady clock (repeats and gaps show repeated and dropped frames).
        interval_us: between frames; rms_us, max_us: of measured minus fused over used frames.
        row_time_us, readout, exposure_us, saturation: of the sensor.
        count_candidates: starts (in periods) that the visible counter LEDs allow; the first is taken.
        count_agreement: share of clean LED readings that agree with it; count_readings their number.
        systematic_us: uncertainty common to all frames, from the scatter of the strips' centres.
    """

    time_us: np.ndarray
    sigma_us: np.ndarray
    measured_us: np.ndarray
    used: np.ndarray
    clock_index: np.ndarray
    interval_us: float
    rms_us: float
    max_us: float
    row_time_us: float
    readout: str
    exposure_us: float | None
    saturation: float | None
    count_candidates: np.ndarray
    count_agreement: float
    count_readings: int
    systematic_us: float
    curve: np.ndarray  # (S, B) learned brightness of each strip over the period
    faults: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    def shift_periods(self, periods: int, period_us: float) -> None:
        """Move all times by whole periods (a count settled by another camera)."""
        self.time_us = self.time_us + periods * period_us
        self.measured_us = self.measured_us + periods * period_us


def decode(signals: Signals, template: BoardTemplate, options: DecodeOptions) -> CameraTimes:
    """Decode one camera.

    Raises:
        NotDecodable: the signals do not determine the time (says why, and what to give or change).
    """
    period = options.period_us
    slot = template.strip_slot
    value, usable = strips.normalise(signals.strip, signals.board.strip_visible)
    phase = strips.coarse_phase(value, usable, slot, period)
    axis, position, led_position = _readout_axis(signals, options)

    on, known = counter.lit(signals.led, signals.board.led_visible)
    read, bits = counter.read_count(on, known, template.led_bit)
    warnings: list[str] = []
    if bits < template.gray_bits:
        warnings.append(f"only the lowest {bits} of {template.gray_bits} counter LEDs are in view")
    d_at = int(np.flatnonzero(template.led_bit < 0)[0]) if (template.led_bit < 0).any() else None
    d = on[:, d_at] if d_at is not None and known[d_at] else None
    full = bits == template.gray_bits
    if full:
        read = counter.resolve(read, phase / period, d, template.disambiguation_lead)
    interval = _interval(options, read, bits, phase, period)
    counted = read * period + phase
    index = clock.link(counted if full else phase, interval, signals.duplicate, period, full)
    if full:
        # Single counts may still be wrong; the clock says which period is meant.
        line = strips.robust_line(index, counted)[0]
        time = line + clock.wrap(phase - line, period)
    else:
        time = clock.unwrap(phase, index, interval, period)
    steady = options.clock == "steady"
    if steady:
        interval = strips.sharpen_interval(value, usable, index, interval, period)
        time = index * interval + np.median(time - index * interval)

    row_time, free = _row_time(options, value, usable, position, time, period)
    fit = strips.fit(value, usable, position, axis, slot, time, period, row_time, free, steady, options.iterations)
    if steady:
        exact = counted + clock.wrap(fit.time - counted, period) if full else fit.time
        better = clock.link(exact, interval, signals.duplicate, period, full)
        if (better != index).any():
            index = better
            line = strips.robust_line(index, clock.unwrap_to(fit.time, index, interval, period), fit.sigma)[0]
            fit = strips.fit(
                value, usable, position, axis, slot, line, period, fit.row_time, free, steady, options.iterations
            )
        line = strips.robust_line(index, fit.time, fit.sigma)[0]
        measured = line + clock.wrap(fit.time - line, period)
        line, interval, weight = strips.robust_line(index, measured, fit.sigma)
    else:
        line, weight, measured = fit.time, np.ones(len(fit.time)), fit.time
    used = (weight > 0.05) & ~signals.duplicate

    exposure = strips.estimate_exposure(fit.curve, fit.slots, period)
    lead = exposure[0] if exposure else 0.35 * period
    led_time = line[:, None] + fit.row_time * led_position
    candidates, agreement, readings = counter.vote(template, on, known, led_time, period, 1.15 * lead + 100)
    if agreement < 0.97:
        warnings.append(
            f"only {agreement:.1%} of the clean counter LED readings fit the counter; times may be off by whole periods"
        )
    residual = (measured - line)[used] if steady else np.zeros(1)
    systematic = float(np.nanstd(fit.centre_error) / np.sqrt(max(1, np.isfinite(fit.centre_error).sum())))
    sigma = _line_sigma(index, used, residual, len(line)) if steady else fit.sigma
    if (~used & ~signals.duplicate).sum():
        warnings.append(
            f"{int((~used & ~signals.duplicate).sum())} of {len(line)} frames were left out of the fit as outliers"
        )
    sign = 1 if fit.row_time >= 0 else -1
    out = CameraTimes(
        line,
        np.hypot(sigma, systematic),
        measured,
        used,
        index,
        interval,
        float(np.sqrt(np.mean(residual**2))),
        float(np.abs(residual).max()),
        abs(fit.row_time),
        READOUT[axis, sign],
        exposure[0] if exposure else None,
        exposure[1] if exposure else None,
        candidates,
        agreement,
        readings,
        systematic,
        fit.curve,
        fit.faults,
        warnings,
    )
    out.shift_periods(int(candidates[0]), period)
    return out


def _readout_axis(signals: Signals, options: DecodeOptions):
    """Image axis of the readout (0 = x), and strip and LED coordinates on it relative to the picture's centre."""
    if options.readout:
        axis = 0 if options.readout in ("left", "right") else 1
    else:
        run = signals.board.strip[:, -1] - signals.board.strip[:, 0]
        axis = int(np.abs(run).mean(0).argmax())
    centre = signals.image_size[axis] / 2
    return axis, signals.board.strip[..., axis] - centre, signals.board.led[:, axis] - centre


def _row_time(options: DecodeOptions, value, usable, position, time, period) -> tuple[float, bool]:
    """Signed row time to start from, and whether to refine it."""
    sign = {"left": -1, "up": -1, "right": 1, "down": 1, None: 0}[options.readout]
    if options.row_time_us is not None and sign:
        return sign * options.row_time_us, False
    along = strips.row_time_from_fundamental(value, usable, position, time, period)
    span = max((np.ptp(position[s][usable[s]]) for s in range(len(usable)) if usable[s].sum() >= 8), default=0.0)
    if along is None:
        raise NotDecodable(
            "the frames meet the board at too few phases of its period to measure the row time; set another tick "
            "(gof capture board set --tick-us 410), or give --row-time-us and --readout"
        )
    if span < 60:
        raise NotDecodable(
            "the strips run across the readout direction; turn the board by 90 degrees, or give "
            "--row-time-us and --readout"
        )
    if options.row_time_us is not None:
        return float(np.sign(along)) * options.row_time_us, False
    if sign and np.sign(along) != sign and abs(along) * span > 40:
        raise NotDecodable(
            f"the strips show the opposite readout direction of '{options.readout}' ({along:+.2f} us per pixel)"
        )
    return along, True


def _interval(options: DecodeOptions, read, bits, phase, period) -> float:
    if options.fps:
        return 1e6 / options.fps
    if bits < 3:
        raise NotDecodable("too few counter LEDs are in view to measure the frame rate; give it with --fps")
    return clock.estimate_interval(read, phase, period)


def _line_sigma(index, used, residual, count) -> np.ndarray:
    """Standard error of the fitted line at each frame."""
    n = max(int(used.sum()), 2)
    i = index - index[used].mean() if used.any() else index - index.mean()
    spread = max(float((i[used] ** 2).sum()), 1.0)
    scale = max(float(np.sqrt((residual**2).sum() / max(n - 2, 1))), 0.1)
    return scale * np.sqrt(1 / n + i**2 / spread) * np.ones(count)
