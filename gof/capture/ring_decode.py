"""One camera's view of a ring board -> the time of every frame on the board's clock.

One LED of the ring is lit at a time, so a picture shows an arc: as many LEDs as steps lie in its exposure. The arc's
middle is the middle of the exposure, whatever the LEDs' brightness does to saturate; with a rolling shutter every LED
is seen at its own line's time, and the arc's place in the picture also gives the lines' delay. The counter, in plain
binary, gives the round; it is read where the exposure lies within one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from gof.capture import clock
from gof.capture.counter import MIN_AGREEMENT, CountVote, best_counts, contradiction
from gof.capture.decode import MIN_BITS, READOUT, CameraTimes, DecodeOptions, carried_over, line_sigma
from gof.capture.ring_board import RingBoard
from gof.capture.ring_signals import RingSignals
from gof.capture.strips import NotDecodable, robust_line, robust_scale

FEWEST_FRAMES = 8
LEAST_LIGHT = 25.0  # grey levels of a lit LED above the board; a codec's noise is a few
MOST_LIT = 0.9  # of the ring: a longer arc has no ends to be found
MARGIN = 3.0  # steps beside the arc that are compared too
OFF = 0.15  # soft limit of what an LED's brightness may miss the model by
HIDDEN_LIT, HIDDEN_SEEN = 0.7, 0.25  # an LED that should shine above the one and stays below the other is hidden
FLAT = 1e-3  # by which moments must differ in their misses to be told apart
OUTLIER, LEAST_OUTLIER = 5.0, 0.25  # times the frames' scatter, and steps, by which a used frame may miss the clock
REACH = 2.0  # steps by which a frame's own time is searched around the clock's
ROUNDS = 4
MOST_SIGMAS = 3.0  # a delay of lines below as many of its standard errors is none
LEAST_DELAY = 0.05  # of a step, across the ring: a smaller one is none either
SYSTEMATIC = 0.01, 0.25  # steps and lines by which all times may be off: arcs' ends; place in the picture (on renders)
LEAST_KNOWN = 1e-5  # smallest eigenvalue of the fit's normal matrix, scaled to a unit diagonal
MOST_CANDIDATES = 64
MOST_VOTES = 100  # frames that vote on the count


@dataclass(frozen=True)
class _Arc:
    """Brightness of an LED by its distance from the exposure's middle, in steps: 1 nearer than half the arc, 0
    beyond, and a ramp between. Both ends look alike, however the camera saturates.

    Attributes:
        half, ramp: half the arc's length at half brightness, and the ramps' length, in steps.
        delay: (2,) us per pixel right and down.
    """

    half: float
    ramp: float
    delay: np.ndarray

    def light(self, off: np.ndarray) -> np.ndarray:
        return np.clip((self.half - np.abs(off)) / self.ramp + 0.5, 0, 1)

    def slope(self, off: np.ndarray) -> np.ndarray:
        """Return the slope of `light` along `off`."""
        on_ramp = np.abs(np.abs(off) - self.half) < self.ramp / 2
        return -np.sign(off) * on_ramp / self.ramp


@dataclass(frozen=True)
class _Ring:
    """The arc that a ring shows, in steps and shares.

    Attributes:
        light: (T, L) 0 dark to 1 lit.   usable: (T, L) bool, in the picture and not hidden.
        place: (T, L, 2) px from the picture's centre.
        step_us: of the ring.
    """

    light: np.ndarray
    usable: np.ndarray
    place: np.ndarray
    step_us: float

    def off(self, time_us: np.ndarray, arc: _Arc) -> np.ndarray:
        """Return (T, L) steps from each LED's own middle to the exposure's, where and when the camera sees it."""
        leds = self.light.shape[1]
        seen_at = time_us[:, None] + self.place @ arc.delay
        return clock.wrap(seen_at / self.step_us - (np.arange(leds) + 0.5), leds)


def decode_ring(signals: RingSignals, board: RingBoard, options: DecodeOptions) -> CameraTimes:
    """Decode one camera. Frames in which the board is not found get their times from the clock of those that show it.

    Raises:
        NotDecodable: the footage does not determine the time (says why, and what to give or change).
    """
    brightest = np.nan_to_num(signals.led).max(1)
    bright = float(np.median(brightest[signals.seen])) if signals.seen.any() else 0.0
    shown = signals.seen & (brightest > bright / 3)
    if shown.sum() < FEWEST_FRAMES:
        raise NotDecodable(
            f"board '{board.name}' is found in {int(shown.sum())} frames, {FEWEST_FRAMES} are needed: is its marker "
            "whole, lit, and at least about 25 pixels wide?"
        )
    if bright < LEAST_LIGHT:
        raise NotDecodable("no LED of the ring is lit in the footage; is the board switched on?")
    if shown.all():
        return _decode_shown(signals, board, options, bright)
    if not options.steady:
        raise NotDecodable(
            f"the board is not found in {int((~shown).sum())} of {len(shown)} frames; with --clock free "
            "the times of such frames cannot be interpolated"
        )
    return carried_over(_decode_shown(signals.among(shown), board, options, bright), shown)


def _decode_shown(signals: RingSignals, board: RingBoard, options: DecodeOptions, bright: float) -> CameraTimes:
    width, height = signals.image_size
    light = np.clip(signals.led / np.percentile(signals.led.max(1), 75), 0, 1)
    ring = _Ring(light, signals.led_inside, signals.led_px - [width / 2, height / 2], board.step_us)
    arc, phase = _first_guess(ring)
    read = _read_counter(signals, bright)
    index, start, interval = _link(phase, read, signals.duplicate, board, options)
    arc, fused, measured, seen_us, ring, systematic = _fit(ring, arc, start, index, options)
    if options.steady:
        most = max(OUTLIER * robust_scale(measured - fused), LEAST_OUTLIER * board.step_us)
        used = (np.abs(measured - fused) < most) & ~signals.duplicate
        interval = float(np.polyfit(index, fused, 1)[0])
        residual = (measured - fused)[used]
        sigma = line_sigma(index, used, residual, len(index))
    else:
        used, residual, sigma = ~signals.duplicate, np.zeros(1), seen_us
    if used.sum() < FEWEST_FRAMES:
        raise NotDecodable(f"only {int(used.sum())} frames show the ring well enough to agree on a clock")
    exposure = (
        float(2 * arc.half if arc.half > 0.75 else arc.ramp) * board.step_us
    )  # an arc of one LED is placed by its ramp
    centre = [width / 2, height / 2]
    vote = _vote(signals, read, fused[:, None] + (signals.counter_px - centre) @ arc.delay, board, exposure)
    axis = int(np.abs(arc.delay).argmax())
    shift = int(vote.candidates[0]) * board.period_us
    return CameraTimes(
        time_us=fused + shift,
        sigma_us=np.hypot(sigma, systematic),
        measured_us=measured + shift,
        used=used,
        clock_index=index,
        interval_us=interval,
        rms_us=float(np.sqrt(np.mean(residual**2))),
        max_us=float(np.abs(residual).max()),
        row_time_us=float(np.abs(arc.delay[axis])),
        readout=READOUT[axis, 1 if arc.delay[axis] >= 0 else -1] if arc.delay.any() else options.readout or "down",
        exposure_us=exposure,
        saturation=None,
        count_candidates=vote.candidates,
        count_agreement=vote.agreement,
        count_readings=vote.readings,
        count_cycle=vote.cycle,
        systematic_us=systematic,
        curve=_curve(ring, fused, arc),
        faults=[],
        warnings=_warnings(ring, read, vote, used, signals),
    )


def _first_guess(ring: _Ring) -> tuple[_Arc, np.ndarray]:
    """Return the arc's length, and (T,) us modulo a round at which each frame shows it."""
    leds = ring.light.shape[1]
    lit = float(np.percentile((np.where(ring.usable, ring.light, 0) > 0.5).sum(1), 75))
    if lit > MOST_LIT * leds:
        raise NotDecodable(
            f"about {lit:.0f} of the ring's {leds} LEDs are lit at once: the exposure is as long as a round; film with "
            "a shorter one"
        )
    arc = _Arc(max(lit, 1.0) / 2, 1.0, np.zeros(2))
    # Slide the arc round the ring in half steps: where it agrees best with what is lit.
    moments = np.arange(2 * leds) / 2
    model = arc.light(clock.wrap(moments[:, None] - (np.arange(leds) + 0.5), leds))
    agree = np.where(ring.usable, ring.light - 0.5, 0) @ (model - 0.5).T
    best = agree >= agree.max(1, keepdims=True) - 1e-6
    turn = np.angle((best * np.exp(2j * np.pi * moments / leds)).sum(1))
    return arc, (turn / (2 * np.pi) % 1) * leds * ring.step_us


@dataclass(frozen=True)
class _RingCounterRead:
    """The counter as it shows.

    Attributes:
        on: (T, B) bool, lowest bit first.   known: (B,) False for LEDs that leave the picture or are hidden.
        count: (T,) of the `bits` lowest bits.
    """

    on: np.ndarray
    known: np.ndarray
    count: np.ndarray
    bits: int


def _read_counter(signals: RingSignals, bright: float) -> _RingCounterRead:
    """By a threshold. An LED that never shines although a higher one changes is hidden: between, it must have."""
    level = max(float(np.percentile(signals.counter.max(1), 75)), bright / 4)
    on = signals.counter > level / 2
    known = signals.counter_inside.mean(0) > 0.5
    changes = np.flatnonzero(known & (on.mean(0) > 0.05) & (on.mean(0) < 0.95))
    if len(changes):
        lower = np.arange(on.shape[1]) < changes.max()
        known &= ~(lower & (on.mean(0) < 0.01))
    bits = int(np.argmin(np.append(known, False)))
    count = on[:, :bits].astype(np.int64) @ (1 << np.arange(bits))
    return _RingCounterRead(on, known, count, bits)


def _link(
    phase: np.ndarray, read: _RingCounterRead, repeated: np.ndarray, board: RingBoard, options: DecodeOptions
) -> tuple[np.ndarray, np.ndarray, float]:
    """Return (T,) positions on the camera's clock, (T,) times there up to whole rounds, and the interval in us."""
    period = board.period_us
    counted = read.bits >= MIN_BITS
    cycle = 1 << read.bits
    count = np.rint(np.unwrap(read.count.astype(float), period=cycle)) if counted else np.zeros(len(phase))
    if options.fps:
        interval = 1e6 / options.fps
    elif counted:
        interval = clock.estimate_interval(count, phase, period)
    else:
        raise NotDecodable("too few counter LEDs are in view to measure the frame rate; give it with --fps")
    time = count * period + phase if counted else phase
    index = clock.link(time, interval, repeated, period, counted)
    if counted:
        line = robust_line(index, time)[0]
        time = line + clock.wrap(phase - line, period)
    else:
        time = clock.unwrap(phase, index, interval, period)
    if not options.steady:
        return index, time, interval
    line, interval, _ = robust_line(index, time)
    return index, line, interval


def _fit(
    ring: _Ring, arc: _Arc, time: np.ndarray, index: np.ndarray, options: DecodeOptions
) -> tuple[_Arc, np.ndarray, np.ndarray, np.ndarray, _Ring, float]:
    """Arc, lines' delay and clock together, then each frame's own time; LEDs that turn out to be hidden are left out.

    Returns:
        the arc, (T,) fused times, (T,) each frame's own, (T,) the own times' standard errors (us), the ring as it was
        used, and the standard error of all times together (us).
    """
    axes: tuple[int, ...] = (0, 1)
    if options.readout is not None:
        axes = (0,) if options.readout in ("left", "right") else (1,)
    given_us = None if options.readout is None else options.row_time_us
    if given_us is not None:
        sign = 1 if options.readout in ("right", "down") else -1
        arc = _Arc(arc.half, arc.ramp, sign * given_us * np.eye(2)[axes[0]])
        axes = ()
    for round_ in range(ROUNDS):
        arc, time, error = _fit_shared(ring, arc, time, index, axes)
        if round_ == 0 and given_us is None:  # lines are read along one axis
            strength = np.abs(arc.delay) / np.maximum(error[:2], 1e-9)
            axis = int(strength.argmax())
            across = abs(arc.delay[axis]) * float(np.ptp(ring.place[ring.usable], axis=0)[axis])
            kept = axis if strength[axis] > MOST_SIGMAS and across > LEAST_DELAY * ring.step_us else None
            axes = () if kept is None else (kept,)
            delay = np.where(np.arange(2) == kept, arc.delay, 0.0)
            if options.row_time_us is not None:
                delay, axes = np.sign(delay) * options.row_time_us, ()
            arc = _Arc(arc.half, arc.ramp, delay)
        ring = _without_hidden(ring, arc, time)
        if not options.steady:
            time = _own_times(ring, arc, time)[0]
    measured, sigma = _own_times(ring, arc, time)
    off = np.multiply(SYSTEMATIC, [ring.step_us, np.abs(arc.delay).max()])
    return arc, time, measured, sigma, ring, float(np.linalg.norm([error[2], *off]))


def _fit_shared(
    ring: _Ring, arc: _Arc, time: np.ndarray, index: np.ndarray, axes: tuple[int, ...]
) -> tuple[_Arc, np.ndarray, np.ndarray]:
    """Return least squares over all LEDs near the arcs.

    Args:
        axes: of the lines' delay that is fitted.
    Returns:
        the arc, (T,) times, and (3,) standard errors of the delay's two parts (us per px) and of all times (us).
    """
    k = (index - index.mean()) / max(float(np.ptp(index)), 1.0)
    near = ring.usable & (np.abs(ring.off(time, arc)) < arc.half + arc.ramp + MARGIN)
    observed = ring.light[near]
    reach = np.abs(ring.place).max()

    def unpacked(x: np.ndarray) -> tuple[_Arc, np.ndarray]:
        delay = arc.delay.copy()
        delay[list(axes)] = x[4:] * ring.step_us / reach
        return _Arc(x[0], x[1], delay), time + ring.step_us * (x[2] + x[3] * k)

    def miss(x: np.ndarray) -> np.ndarray:
        shape, at = unpacked(x)
        return shape.light(ring.off(at, shape)[near]) - observed

    first = np.array([arc.half, arc.ramp, 0.0, 0.0, *(arc.delay[list(axes)] * reach / ring.step_us)])
    least = np.array([0.3, 0.05, *np.full(len(first) - 2, -np.inf)])
    most = np.array([len(ring.light[0]) / 2, len(ring.light[0]) / 2, *np.full(len(first) - 2, np.inf)])
    found = least_squares(miss, np.clip(first, least, most), bounds=(least, most), loss="soft_l1", f_scale=OFF)
    normal = found.jac.T @ found.jac
    size = np.sqrt(np.maximum(np.diag(normal), 1e-12))
    scaled = normal / np.outer(size, size)
    if np.linalg.eigvalsh(scaled)[0] < LEAST_KNOWN:
        raise NotDecodable(
            "the frames show too few places of the ring to determine the delay of the picture's lines; film at another "
            "rate or longer, or give --row-time and --readout"
        )
    spread = robust_scale(miss(found.x)) + 1e-3
    error = spread * np.sqrt(np.diag(np.linalg.inv(scaled))) / size
    shape, at = unpacked(found.x)
    per_axis = np.zeros(2)
    per_axis[list(axes)] = error[4:] * ring.step_us / reach
    return shape, at, np.array([*per_axis, error[2] * ring.step_us])


def _without_hidden(ring: _Ring, arc: _Arc, time: np.ndarray) -> _Ring:
    """LEDs that stay dark where they should shine are behind something, or dead."""
    expected = np.where(ring.usable, arc.light(ring.off(time, arc)), 0) > HIDDEN_LIT
    shone = (expected & (ring.light > HIDDEN_SEEN)).sum(0)
    due = expected.sum(0)
    hidden = (due > 0) & (shone < due / 4)
    return _Ring(ring.light, ring.usable & ~hidden, ring.place, ring.step_us)


def _own_times(ring: _Ring, arc: _Arc, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (T,) us each frame's own time near `time`, and its standard error."""
    shifts = np.linspace(-REACH, REACH, 81)
    off = ring.off(time, arc)
    cost = np.stack(
        [np.where(ring.usable, (arc.light(off + shift) - ring.light) ** 2, 0).sum(1) for shift in shifts], 1
    )
    low = cost <= cost.min(1, keepdims=True) + FLAT
    shift = shifts[np.where(low, np.abs(shifts), np.inf).argmin(1)]  # without evidence, keep the clock
    for _ in range(3):
        slope = np.where(ring.usable, arc.slope(off + shift[:, None]), 0)
        miss = np.where(ring.usable, ring.light - arc.light(off + shift[:, None]), 0)
        information = (slope**2).sum(1)
        shift = np.clip(shift + (slope * miss).sum(1) / np.maximum(information, 0.05), -REACH, REACH)
    noise = np.sqrt(np.where(ring.usable, miss**2, 0).sum(1) / np.maximum(ring.usable.sum(1), 1)) + 1e-3
    # An exposure within one LED's step tells only that it is.
    vague = low.sum(1) * (shifts[1] - shifts[0]) / np.sqrt(12)
    sigma = np.where(information > 0.05, noise / np.sqrt(np.maximum(information, 0.05)), vague)
    return time + ring.step_us * shift, ring.step_us * sigma


def _vote(
    signals: RingSignals, read: _RingCounterRead, at_us: np.ndarray, board: RingBoard, exposure_us: float
) -> CountVote:
    """Return the round in which the clip starts, from the counters of all frames together: one number explains them
    all.

    Args:
        at_us: (T, B) mid-exposure of each counter LED, up to that number of rounds.
    """
    period, bits = board.period_us, read.on.shape[1]
    phase = at_us % period
    inside = (phase > exposure_us / 2) & (phase < period - exposure_us / 2) & signals.counter_inside & read.known
    frames = np.flatnonzero(inside.any(1))
    frames = frames[:: len(frames) // MOST_VOTES + 1]
    if not len(frames):
        raise NotDecodable(
            f"the exposure (about {exposure_us / 1000:.0f} ms) is so long that every frame straddles a change of the "
            "counter; film with a shorter one"
        )
    base = np.floor(at_us / period).astype(np.int64)
    origin = int(base.min())
    candidate = np.arange(1 << bits)
    wrong = np.zeros(len(candidate))
    for b in range(bits):
        for frame in frames[inside[frames, b]]:
            shown = (candidate + base[frame, b] - origin) >> b & 1
            wrong += shown != read.on[frame, b]
    readings = int(inside[frames].sum())
    found = best_counts(wrong, readings, int(inside[frames].any(0).sum()), origin)
    if found.is_contradicted:
        raise NotDecodable(contradiction(board.name, found))
    return replace(found, candidates=found.candidates[:MOST_CANDIDATES])


def _curve(ring: _Ring, time: np.ndarray, arc: _Arc) -> np.ndarray:
    """Return (1, L) mean brightness of the LEDs by how long before or after its middle they were lit, one step a
    bin."""
    leds = ring.light.shape[1]
    bin_ = np.floor(ring.off(time, arc)[ring.usable] + leds / 2).astype(int) % leds
    total = np.bincount(bin_, ring.light[ring.usable], leds)
    return (total / np.maximum(np.bincount(bin_, minlength=leds), 1))[None]


def _warnings(
    ring: _Ring, read: _RingCounterRead, vote: CountVote, used: np.ndarray, signals: RingSignals
) -> list[str]:
    warnings = []
    hidden = int((~ring.usable.any(0)).sum())
    if hidden:
        warnings.append(f"{hidden} of {ring.light.shape[1]} LEDs of the ring are out of view or hidden")
    if not read.known.all():
        warnings.append(f"only {int(read.known.sum())} of {len(read.known)} counter LEDs are in view")
    if vote.agreement < MIN_AGREEMENT:
        warnings.append(
            f"only {vote.agreement:.1%} of the clean counter LED readings fit the counter; times may be off by whole "
            "rounds"
        )
    left_out = int((~used & ~signals.duplicate).sum())
    if left_out:
        warnings.append(f"{left_out} of {len(used)} frames were left out of the fit as outliers")
    return warnings
