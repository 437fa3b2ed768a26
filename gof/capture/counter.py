"""The coarse clock: the period counter in reflected Gray code, and its disambiguation LED.

Time unit: microseconds of board time. The exposure of a frame may straddle a change of the counter; then one Gray bit,
and only one, may read either way. The disambiguation LED shows floor(t / period + lead) & 1: it is steady around every
change of the Gray code, and so identifies the change.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gof.capture.strips import NotDecodable
from gof.capture.template import BoardTemplate

MOST_UNEVEN = 3.0  # periods: what a step of the count may cost, however long the gap
MIN_AGREEMENT = 0.97  # of the LEDs with the count; sharp footage has above 0.99
MOST_WRONG = 0.75  # LEDs' worth of readings that may contradict the count: one that is hidden makes half an LED, a
MOST_WRONG_SHARE = 0.15  # wrong board, or two LEDs that are swapped, a whole one; and of all readings
QUICK_BITS, CHANGES = 4, 0.2  # lowest LEDs, and the standard deviation of their brightness: these change often
ALIKE = 0.005  # of their readings: lags that fit as well
COUNTER_BITS = 15  # of the firmware, see firmware/core/gof_board.h; a board may have fewer LEDs


def gray(count: np.ndarray) -> np.ndarray:
    """Reflected Gray code of non-negative integers."""
    count = np.asarray(count)
    return count ^ (count >> 1)


def lit(led: np.ndarray, visible: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """LED brightness (T, L) to 0..1 between dark and lit, and known (L,): False for LEDs out of view.

    LEDs that change are scaled by their own levels, constant ones by the levels of the others (their brightness agrees
    to a few percent on one board).
    """
    low, high = np.percentile(led, [5, 95], axis=0)
    changes = visible & (high - low > 60)
    if not changes.any():
        raise NotDecodable(
            "no counter LED changes in this footage; is the board running, is the clip longer than a period?"
        )
    dark, bright = np.median(low[changes]), np.median(high[changes])
    low, high = np.where(changes, low, dark), np.where(changes, high, bright)
    return np.clip((led - low) / (high - low), 0, 1), visible.copy()


def read_count(on: np.ndarray, known: np.ndarray, bit: np.ndarray) -> tuple[np.ndarray, int]:
    """Decode Gray bits (T, L) 0..1 of each frame by a threshold.

    Unknown bits above the highest known run are taken as zero.
    Returns:
        count (T,) of the lowest `bits` bits, and `bits`: bits 0..bits-1 are all known.
    """
    position = {int(b): i for i, b in enumerate(bit) if b >= 0}
    bits = 0
    while bits in position and known[position[bits]]:
        bits += 1
    count = np.zeros(len(on), np.int64)
    for b in range(bits):
        count |= (on[:, position[b]] > 0.5).astype(np.int64) << b
    shift = 1
    while shift < max(bits, 1):
        count ^= count >> shift
        shift *= 2
    return count, bits


def unfold(count: np.ndarray, bits: int, phase: np.ndarray, step: float) -> np.ndarray:
    """Periods from the lowest `bits` Gray bits alone, which count up and down in turns: of the two counts that a
    reading may mean, those in a row that advance most evenly (Viterbi).

    Args:
        count: (T,) as `read_count` decodes these bits.
        phase: (T,) position in the period, 0..1, from the strips.
        step: periods from frame to frame.
    Returns:
        (T,) periods, up to a common multiple of the bits' cycle. A gap of more than three quarters of that cycle is
        read wrong.
    """
    cycle = 1 << (bits + 1)
    either = np.stack([count, cycle - 1 - count], 1)
    advance = (either[1:, None, :] - either[:-1, :, None] + cycle // 4) % cycle - cycle // 4  # (T-1, before, after)
    odd = advance + (np.diff(phase) - step)[:, None, None]
    cost = np.minimum(np.abs(odd), MOST_UNEVEN)
    best, came_from = np.zeros(2), np.zeros((len(count), 2), int)
    for k in range(1, len(count)):
        total = best[:, None] + cost[k - 1]
        came_from[k], best = total.argmin(0), total.min(0)
    path = np.empty(len(count), int)
    path[-1] = best.argmin()
    for k in range(len(count) - 1, 0, -1):
        path[k - 1] = came_from[k, path[k]]
    steps = advance[np.arange(len(count) - 1), path[:-1], path[1:]]
    return either[0, path[0]] + np.concatenate([[0], np.cumsum(steps)])


def resolve(count: np.ndarray, phase: np.ndarray, disambiguation: np.ndarray | None, lead: float) -> np.ndarray:
    """Count of each frame from a read that may be off by one near a change.

    Args:
        count: (T,) as read.
        phase: (T,) position in the period, 0..1, from the strips.
        disambiguation: (T,) state of the LED 0..1, None when it is not in view.
        lead: of the template, in periods.
    """
    if disambiguation is None:
        return count
    parity = (disambiguation > 0.5).astype(np.int64)
    # Between lead and the end the LED already shows the next count; around the change it is steady.
    after_turn = phase >= 1 - lead
    shown = count + after_turn  # parity that a right read would show
    wrong = (shown & 1) != parity
    near_start, near_end = phase < (1 - lead) / 2, phase > 1 - lead / 2
    # Just after the change an old count was read: one more. Just before it a new one was read: one less.
    return count + np.where(wrong & near_start, 1, 0) - np.where(wrong & near_end, 1, 0)


@dataclass(frozen=True)
class CountVote:
    """The common reading of the LEDs of all frames.

    Attributes:
        candidates: periods to add to the frames' times; all agree equally well, smallest first.
        agreement: share of clean readings that agree with them.
        readings: number of clean readings.
        cycle: periods after which the LEDs show the same again.
        leds: that were read.
        dark_bit: Gray bit whose LED stays dark where it should shine, and was left out; None where there is none.
    """

    candidates: np.ndarray
    agreement: float
    readings: int
    cycle: int
    leds: int
    dark_bit: int | None = None

    @property
    def is_contradicted(self) -> bool:
        """Whether LEDs contradict each other: then several counts explain about as much, each against one LED."""
        return 1 - self.agreement > min(MOST_WRONG / max(self.leds, 1), MOST_WRONG_SHARE)


def vote(
    template: BoardTemplate, on: np.ndarray, known: np.ndarray, led_time: np.ndarray, period: float, exposure: float
) -> CountVote:
    """Return the count at which the clip starts, from all frames together.

    Every frame's time is known up to one common number of periods, so one integer explains all LEDs of all frames; each
    candidate's predicted bits are compared with frames whose exposure lies inside one period. Missing LEDs leave
    candidates that cannot be told apart. A board with an LED less than the counter has bits, or whose highest LED is
    dead or not wired (a classic ESP32 has no pin for it), still tells them all: by which way the lower ones run.

    Args:
        led_time: (T, L) mid-exposure board time of each LED in each frame, us, up to that number of periods.
        exposure: us, with a margin.
    Raises:
        NotDecodable: no reading lies inside one period; the LEDs contradict each other.
    """
    is_bit = (template.led_bit >= 0) & known
    time, read = led_time[:, is_bit], on[:, is_bit] > 0.5
    bits = template.led_bit[is_bit]
    phase = time % period
    clean = (phase > exposure / 2) & (phase < period - exposure / 2)
    if not clean.any():
        raise NotDecodable(
            f"the exposure (about {exposure:.0f} us) is so long that every frame straddles a change of the "
            "counter; lengthen the board's tick"
        )
    base = np.floor(time / period).astype(np.int64)
    origin = int(base.min())
    base -= origin
    tallies = [_tally(base[clean[:, i], i], read[clean[:, i], i]) for i in range(len(bits))]
    counter_bits = max(COUNTER_BITS, template.gray_bits)
    found = _best_count(tallies, bits, counter_bits, origin)
    highest = bits == template.gray_bits - 1
    if found.is_contradicted and highest.any() and not read[:, highest].any():
        kept = [tally for tally, use in zip(tallies, ~highest, strict=True) if use]
        without = _best_count(kept, bits[~highest], counter_bits, origin)
        if not without.is_contradicted:
            return replace(without, dark_bit=template.gray_bits - 1)
    if found.is_contradicted:
        raise NotDecodable(contradiction(template.name, found))
    return found


def lag(
    template: BoardTemplate, on: np.ndarray, known: np.ndarray, led_time: np.ndarray, period: float, exposure: float
) -> float | None:
    """Return the delay of the LEDs' changes in periods, -0.5 to 0.5: 0 where strips and LEDs belong together.
    None where no LED changes often enough to tell.

    Args:
        on: (T, L) brightness 0..1.   led_time: (T, L) mid-exposure board time of each LED in each frame, us.
        exposure: us.
    """
    quick = known & (template.led_bit < QUICK_BITS) & (on.std(0) > CHANGES)
    if not quick.any():
        return None
    seen, bits = on[:, quick], template.led_bit[quick]
    moments = led_time[:, quick, None] / period + exposure / period * np.linspace(-0.5, 0.5, 11)
    lags = np.linspace(-0.5, 0.5, 101)
    cost = []
    for late in lags:
        at = moments - late
        count = np.floor(at).astype(np.int64)
        parity = np.floor(at + template.disambiguation_lead).astype(np.int64) & 1
        shown = np.where(bits[:, None] < 0, parity, gray(count) >> np.maximum(bits, 0)[:, None] & 1)
        cost.append(float(np.abs(seen - shown.mean(2)).sum()))
    alike = lags[np.array(cost) <= min(cost) + ALIKE * seen.size]  # frames that meet few phases leave a range open
    return float(alike[np.abs(alike).argmin()])


def contradiction(board: str, vote: CountVote) -> str:
    """Return a warning of LEDs that contradict each other."""
    return (
        f"no count of board '{board}' explains its LEDs: the best fits {vote.agreement:.1%} of {vote.readings} clean "
        "readings. Is it another board (--board), or is an LED dead, hidden, or wired in "
        "another place?"
    )


def _best_count(tallies: list[tuple], bits: np.ndarray, counter_bits: int, origin: int) -> CountVote:
    """Return the counts at the start that the fewest readings contradict."""
    wrap = 1 << counter_bits
    wrong = np.zeros(wrap)
    for bit, tally in zip(bits, tallies, strict=True):
        # Candidates are periodic in the bit's own cycle: compare one cycle, then repeat it.
        cycle = min(wrap, 1 << (bit + 2))
        candidate, cost = np.arange(cycle), np.zeros(cycle)
        for offset, seen, number in zip(*tally, strict=True):
            cost += number * ((gray((candidate + offset) % wrap) >> bit & 1) != seen)
        wrong += np.tile(cost, wrap // cycle)
    return best_counts(wrong, sum(int(number.sum()) for _, _, number in tallies), len(bits), origin)


def best_counts(wrong: np.ndarray, readings: int, leds: int, origin: int) -> CountVote:
    """Return the counts that the fewest readings contradict.

    Args:
        wrong: (cycle,) readings that each count contradicts.   readings: of all `leds` LEDs together.
        origin: periods to take from a count to have what is added to the frames' times.
    """
    least = float(wrong.min())
    candidates = np.flatnonzero(wrong <= least + 0.5) - origin
    return CountVote(candidates, 1 - least / max(readings, 1), readings, len(wrong), leds)


def _tally(offset: np.ndarray, seen: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return each distinct (offset, reading) and how often it occurs."""
    pairs, counts = np.unique(np.stack([offset, seen.astype(np.int64)], 1), axis=0, return_counts=True)
    return pairs[:, 0], pairs[:, 1], counts
