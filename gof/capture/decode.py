"""One camera's signals -> the time of every frame on the board's clock."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from gof.capture import clock, counter, strips
from gof.capture.clock import WANDER, board_seen, only_frames, positions, wander_us
from gof.capture.counter import CountVote
from gof.capture.signals import Signals
from gof.capture.strips import NotDecodable, StripFit, StripReadings
from gof.capture.template import BoardTemplate
from gof.capture.times import Readout

MIN_WEIGHT = 0.05  # in the robust line; frames below are outliers
MOST_LAG = 0.1  # periods between strips and counter; half a strip's slot
MIN_BITS = 3  # of the counter, to count with: a cycle of 16 periods
MIN_SPAN_PX = 60  # of a strip along the readout, to measure the row time from
CLEAR_DELAY_US = 40.0  # along a strip: two bins of the learned curves, enough to tell a direction
USUAL_EXPOSURE = 0.35  # of the period, where the strips do not show it
EXPOSURE_MARGIN, EXPOSURE_ADD_US = 1.15, 100.0  # the estimate is good to about 15 %
READOUT: dict[tuple[int, int], Readout] = {(0, 1): "right", (0, -1): "left", (1, 1): "down", (1, -1): "up"}


@dataclass(frozen=True)
class DecodeOptions:
    """Facts known beforehand; None = estimated from the footage."""

    period_us: float = 4000.0
    fps: float | None = None
    row_time_us: float | None = None  # per image line, >= 0
    readout: Readout | None = None
    clock: str = "steady"  # "steady" or "free"
    iterations: int = 6  # rounds of learning the strips' curves and the frames' times from each other

    @property
    def steady(self) -> bool:
        return self.clock == "steady"


@dataclass
class CameraTimes:
    """Times of one camera. Times are mid-exposure at the picture's centre; a pixel's own time adds row_time_us times
    its distance from the centre line in the readout direction.

    Args:
        time_us: (T,) fused board time; sigma_us (T,) its standard error.
        measured_us: (T,) each frame's own measurement; used (T,) False for outliers.
        clock_index: (T,) position on the camera's steady clock (repeats and gaps show repeated and dropped frames).
        interval_us: between frames; rms_us, max_us: of measured minus fused over used frames.
        row_time_us, readout, exposure_us, saturation: of the sensor.
        count_candidates: starts (in periods) that the visible counter LEDs allow; the first is taken.
        count_agreement: share of clean LED readings that agree with it; count_readings their number.
        count_cycle: periods after which the counter shows the same again.
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
    readout: Readout
    exposure_us: float | None
    saturation: float | None
    count_candidates: np.ndarray
    count_agreement: float
    count_readings: int
    count_cycle: int
    systematic_us: float
    curve: np.ndarray  # (S, B) learned brightness of each strip over the period
    faults: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    hidden: int = 0  # frames that do not show the board

    def shift_periods(self, periods: int, period_us: float) -> None:
        """Move all times by whole periods (a count settled by another camera)."""
        self.time_us = self.time_us + periods * period_us
        self.measured_us = self.measured_us + periods * period_us


def decode(signals: Signals, template: BoardTemplate, options: DecodeOptions) -> CameraTimes:
    """Decode one camera. Frames in which the board is hidden get their times from the clock of those that show it.

    Raises:
        NotDecodable: the signals do not determine the time (says why, and what to give or change).
    """
    shown = board_seen(signals)
    if shown.all() or not options.steady:
        return _decode_shown(signals, template, options)
    found = _decode_shown(only_frames(signals, shown), template, options)
    return carried_over(found, shown)


def carried_over(found: CameraTimes, shown: np.ndarray) -> CameraTimes:
    """Return times of all frames from those of the frames that show the board, by the camera's clock.

    Args:
        shown: (T,) bool.
    """
    index, warnings = positions(shown, found.clock_index)
    start = found.time_us[0] - found.clock_index[0] * found.interval_us
    time = start + found.interval_us * index
    measured, used = time.copy(), np.zeros(len(time), bool)
    measured[shown], used[shown] = found.measured_us, found.used
    sigma = np.hypot(line_sigma(index, used, (measured - time)[used], len(time)), wander_us(shown, time))
    sigma = np.hypot(sigma, found.systematic_us)
    hidden = int((~shown).sum())
    note = (
        f"the board is hidden in {hidden} of {len(shown)} frames: their times lie on a straight line between those "
        f"that show it, +-{sigma.max():.0f} us at most if the camera's clock is steady to {WANDER * 1e6:g} ppm"
    )
    return replace(
        found,
        time_us=time,
        sigma_us=sigma,
        measured_us=measured,
        used=used,
        clock_index=index,
        hidden=hidden,
        warnings=[*found.warnings, note, *warnings],
    )


def _decode_shown(signals: Signals, template: BoardTemplate, options: DecodeOptions) -> CameraTimes:
    """Decode frames that all show the board."""
    seen, led_position = _strip_readings(signals, template, options)
    phase = strips.coarse_phase(seen, options.period_us)
    counter_read = _read_counter(signals, template, phase, options)
    start = _link_frames(seen, phase, counter_read, signals.duplicate, options)
    fit, index = _learn(seen, start, signals.duplicate, options)
    fused = _fuse(fit, index, start.interval_us, signals.duplicate, options)

    exposure = strips.estimate_exposure(fit.curve, fit.slots, options.period_us)
    led_time = fused.time_us[:, None] + fit.row_time * led_position
    vote = _vote(template, counter_read, led_time, exposure, options.period_us)

    exposed = exposure[0] if exposure else USUAL_EXPOSURE * options.period_us
    own_time = led_time + vote.candidates[0] * options.period_us
    late = counter.lag(template, counter_read.on, counter_read.known, own_time, options.period_us, exposed)
    if late is not None and abs(late) > MOST_LAG:
        raise NotDecodable(
            f"the counter's LEDs change {abs(late) * options.period_us:.0f} us or more "
            f"{'after' if late > 0 else 'before'} the strips say so: are the strips wired in the order that board "
            f"'{template.name}' has them in?"
        )

    residual = (fused.measured_us - fused.time_us)[fused.used] if options.steady else np.zeros(1)
    sigma = line_sigma(index, fused.used, residual, len(index)) if options.steady else fit.sigma
    strips_of_use = max(1, np.isfinite(fit.centre_error).sum())
    systematic = float(np.nanstd(fit.centre_error) / np.sqrt(strips_of_use))
    shift = int(vote.candidates[0]) * options.period_us
    return CameraTimes(
        time_us=fused.time_us + shift,
        sigma_us=np.hypot(sigma, systematic),
        measured_us=fused.measured_us + shift,
        used=fused.used,
        clock_index=index,
        interval_us=fused.interval_us,
        rms_us=float(np.sqrt(np.mean(residual**2))),
        max_us=float(np.abs(residual).max()),
        row_time_us=abs(fit.row_time),
        readout=READOUT[seen.axis, 1 if fit.row_time >= 0 else -1],
        exposure_us=exposure[0] if exposure else None,
        saturation=exposure[1] if exposure else None,
        count_candidates=vote.candidates,
        count_agreement=vote.agreement,
        count_readings=vote.readings,
        count_cycle=vote.cycle,
        systematic_us=systematic,
        curve=fit.curve,
        faults=fit.faults,
        warnings=_warnings(counter_read, vote, fused.used, signals.duplicate, template),
    )


@dataclass(frozen=True)
class _CounterRead:
    """The counter as the LEDs show it.

    Attributes:
        on: (T, L) brightness 0..1.   known: (L,) False for LEDs out of view.
        count: (T,) periods, up to the cycle of the lowest `bits` bits; None where they are too few to count.
        interval_us: between frames.
    """

    on: np.ndarray
    known: np.ndarray
    count: np.ndarray | None
    bits: int
    interval_us: float


@dataclass(frozen=True)
class _LinkedFrames:
    """Frames on the camera's clock.

    Attributes:
        index: (T,) positions.
        time_us: (T,) times there, to a fraction of a slot.
        interval_us: of the clock.
        counted_us: (T,) times by each frame's own count, single ones wrong by periods; None without a count.
    """

    index: np.ndarray
    time_us: np.ndarray
    interval_us: float
    counted_us: np.ndarray | None


@dataclass(frozen=True)
class _FusedTimes:
    """(T,) times on the camera's clock, (T,) each frame's own, (T,) which count, and the clock's interval."""

    time_us: np.ndarray
    measured_us: np.ndarray
    used: np.ndarray
    interval_us: float


def _read_counter(
    signals: Signals, template: BoardTemplate, phase_us: np.ndarray, options: DecodeOptions
) -> _CounterRead:
    """Read the LEDs; reads next to a change are settled by the disambiguation LED where it is in view."""
    on, known = counter.lit(signals.led, signals.board.led_visible)
    # The lower LEDs alone: which way they run tells the highest bit, and a highest LED that is dead does no harm.
    lower = known & (template.led_bit < counter.COUNTER_BITS - 1)
    count, bits = counter.read_count(on, lower, template.led_bit)
    interval = _interval(options, count, bits, phase_us)
    if bits < MIN_BITS:
        return _CounterRead(on, known, None, bits, interval)
    phase = phase_us / options.period_us
    count = counter.unfold(count, bits, phase, interval / options.period_us)
    at = np.flatnonzero((template.led_bit < 0) & known)
    disambiguation = on[:, at[0]] if len(at) else None
    count = counter.resolve(count, phase, disambiguation, template.disambiguation_lead)
    return _CounterRead(on, known, count, bits, interval)


def _link_frames(
    seen: StripReadings, phase: np.ndarray, read: _CounterRead, repeated: np.ndarray, options: DecodeOptions
) -> _LinkedFrames:
    """Put the frames on the camera's clock, from count and phase: the cheapest sequence of drops and repeats."""
    period, interval = options.period_us, read.interval_us
    counted = None if read.count is None else read.count * period + phase
    index = clock.link(phase if counted is None else counted, interval, repeated, period, counted is not None)
    if counted is None:
        time = clock.unwrap(phase, index, interval, period)
    else:
        # Single counts may still be wrong; the clock says which period is meant.
        line = strips.robust_line(index, counted)[0]
        time = line + clock.wrap(phase - line, period)
    if options.steady:
        interval = strips.sharpen_interval(seen, index, interval, period)
        time = index * interval + np.median(time - index * interval)
    return _LinkedFrames(index, time, interval, counted)


def _learn(
    seen: StripReadings, start: _LinkedFrames, repeated: np.ndarray, options: DecodeOptions
) -> tuple[StripFit, np.ndarray]:
    """Learn the strips' curves and the frames' times; once more where the better times link the frames otherwise.

    Returns:
        the fit, and (T,) the frames' positions on the clock.
    """
    period = options.period_us
    row_time, free = _row_time(options, seen, start.time_us, period)
    fit = strips.fit(seen, start.time_us, period, row_time, free, options.steady, options.iterations)
    if not options.steady:
        return fit, start.index
    times, counted = fit.time, start.counted_us
    if counted is not None:
        times = counted + clock.wrap(fit.time - counted, period)
    index = clock.link(times, start.interval_us, repeated, period, counted is not None)
    if (index == start.index).all():
        return fit, index
    near = clock.unwrap_to(fit.time, index, start.interval_us, period)
    line = strips.robust_line(index, near, fit.sigma)[0]
    return strips.fit(seen, line, period, fit.row_time, free, options.steady, options.iterations), index


def _fuse(
    fit: StripFit, index: np.ndarray, interval_us: float, repeated: np.ndarray, options: DecodeOptions
) -> _FusedTimes:
    """Return a robust line through all frames; each frame's own time where the clock is not steady."""
    if not options.steady:
        return _FusedTimes(fit.time, fit.time, ~repeated, interval_us)
    line = strips.robust_line(index, fit.time, fit.sigma)[0]
    measured = line + clock.wrap(fit.time - line, options.period_us)
    line, interval_us, weight = strips.robust_line(index, measured, fit.sigma)
    return _FusedTimes(line, measured, (weight > MIN_WEIGHT) & ~repeated, interval_us)


def _vote(
    template: BoardTemplate,
    read: _CounterRead,
    led_time: np.ndarray,
    exposure: tuple[float, float] | None,
    period: float,
) -> CountVote:
    """Return the LEDs of all frames vote on the count at which the clip starts."""
    exposure_us = exposure[0] if exposure else USUAL_EXPOSURE * period
    return counter.vote(
        template, read.on, read.known, led_time, period, EXPOSURE_MARGIN * exposure_us + EXPOSURE_ADD_US
    )


def _warnings(
    read: _CounterRead, vote: CountVote, used: np.ndarray, repeated: np.ndarray, template: BoardTemplate
) -> list[str]:
    warnings = []
    in_view = counter.read_count(read.on, read.known, template.led_bit)[1]
    if in_view < template.gray_bits:
        warnings.append(f"only the lowest {in_view} of {template.gray_bits} counter LEDs are in view")
    if vote.dark_bit is not None:
        dark = f"the LED of Gray bit {vote.dark_bit} stays dark where it should shine"
        warnings.append(f"{dark}: dead, or not wired; it was left out")
    if vote.agreement < counter.MIN_AGREEMENT:
        warnings.append(
            f"only {vote.agreement:.1%} of the clean counter LED readings fit the counter; times may be off by whole "
            "periods"
        )
    left_out = int((~used & ~repeated).sum())
    if left_out:
        warnings.append(f"{left_out} of {len(used)} frames were left out of the fit as outliers")
    return warnings


def _strip_readings(
    signals: Signals, template: BoardTemplate, options: DecodeOptions
) -> tuple[StripReadings, np.ndarray]:
    """Return the strips' brightness along the readout, and (L,) the LEDs' places on that axis relative to the picture's
    centre."""
    value, usable = strips.normalise(signals.strip, signals.board.strip_visible)
    if options.readout:
        axis = 0 if options.readout in ("left", "right") else 1
    else:  # strips lie along the readout
        run = signals.board.strip[:, -1] - signals.board.strip[:, 0]
        axis = int(np.abs(run).mean(0).argmax())
    centre = signals.image_size[axis] / 2
    position = signals.board.strip[..., axis] - centre
    return StripReadings(value, usable, axis, position, template.strip_slot), signals.board.led[:, axis] - centre


def _row_time(options: DecodeOptions, seen: StripReadings, time: np.ndarray, period: float) -> tuple[float, bool]:
    """Signed row time to start from, and whether to refine it."""
    sign = {"left": -1, "up": -1, "right": 1, "down": 1, None: 0}[options.readout]
    if options.row_time_us is not None and sign:
        return sign * options.row_time_us, False
    along = strips.row_time_from_fundamental(seen, time, period)
    spans = [np.ptp(seen.position[s][seen.usable[s]]) for s in np.flatnonzero(seen.alive)]
    span = max(spans, default=0.0)
    if along is None:
        raise NotDecodable(
            "the frames meet the board at too few phases of its period to measure the row time; set another tick "
            "(gof capture board set --tick-us 410), or give --row-time and --readout"
        )
    if span < MIN_SPAN_PX:
        raise NotDecodable(
            "the strips run across the readout direction; turn the board by 90 degrees, or give "
            "--row-time and --readout"
        )
    if options.row_time_us is not None:
        return float(np.sign(along)) * options.row_time_us, False
    if sign and np.sign(along) != sign and abs(along) * span > CLEAR_DELAY_US:
        raise NotDecodable(
            f"the strips show the opposite readout direction of '{options.readout}' ({along:+.2f} us per pixel)"
        )
    return along, True


def _interval(options: DecodeOptions, count: np.ndarray, bits: int, phase: np.ndarray) -> float:
    """us between frames, as given or from the counter."""
    if options.fps:
        return 1e6 / options.fps
    if bits < MIN_BITS:
        raise NotDecodable("too few counter LEDs are in view to measure the frame rate; give it with --fps")
    return clock.estimate_interval(count, phase, options.period_us)


def line_sigma(index: np.ndarray, used: np.ndarray, residual: np.ndarray, count: int) -> np.ndarray:
    """Return standard error of the fitted line at each frame."""
    n = max(int(used.sum()), 2)
    i = index - index[used].mean() if used.any() else index - index.mean()
    spread = max(float((i[used] ** 2).sum()), 1.0)
    scale = max(float(np.sqrt((residual**2).sum() / max(n - 2, 1))), 0.1)
    return scale * np.sqrt(1 / n + i**2 / spread) * np.ones(count)
