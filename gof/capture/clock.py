"""The camera's clock: which frames follow each other, which were dropped or repeated, and one steady line through them.

Time unit: microseconds.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gof.capture.signals import Signals
from gof.capture.strips import NotDecodable

# Costs of `link`; tests/capture/test_clock.py holds them to any pattern of drops, repeats and wrong single times.
AGREE = 0.15  # part of a period, or of an interval if that is shorter, by which two steps agree
MISS = 0.06  # part of the period by which a time misses its place entirely; costs 1
DROP_COST = 0.5  # less than the misses of the frames after a drop, more than one small miss
# With fewer frames than these before or after it, a drop must explain more than one frame's wrong phase, of which every
# drop explains some: its count as well, or a second frame.
END_FRAMES, END_DROP_COST = 3, 1.2


def estimate_interval(count: np.ndarray, phase_us: np.ndarray, period: float) -> float:
    """Time between frames from counter and strips, by pairs eight frames apart: the shortest step that many agree on.
    Single wrong reads do not move it, and dropped frames make steps longer.

    Args:
        count: (T,) periods, or what lower bits say of them: they count backwards half of the time.
    Raises:
        NotDecodable: fewer than four frames, or the counter stands still.
    """
    if len(count) < 4:
        raise NotDecodable(f"{len(count)} frames are too few; at least four are needed, a second is good")
    lag = min(8, len(count) // 2)
    counts, phases = (count[lag:] - count[:-lag]) * period, phase_us[lag:] - phase_us[:-lag]
    steps = np.sort(np.maximum(phases + counts, phases - counts) / lag)
    # A drop adds interval / lag, a wrong count period / lag: what agrees is nearer.
    reach = AGREE * min(abs(float(np.median(steps))), period) / lag
    agreeing = np.searchsorted(steps, steps + reach, "right") - np.searchsorted(steps, steps - reach)
    shortest = steps[np.argmax(agreeing >= agreeing.max() / 2)]
    near = np.abs(steps - shortest) <= 2 * reach
    near = np.abs(steps - np.median(steps[near])) <= 2 * reach
    interval = float(steps[near].mean())
    if interval <= 0:
        raise NotDecodable(
            "the period counter does not advance; is the board running? Give the capture rate with --fps"
        )
    return interval


def wrap(time: np.ndarray, period: float) -> np.ndarray:
    """To -period/2 .. period/2."""
    return (np.asarray(time) + period / 2) % period - period / 2


def unwrap(phase_us: np.ndarray, index: np.ndarray, interval: float, period: float) -> np.ndarray:
    """Return times from phases alone: each step is that of a steady clock plus the small difference that the phases
    show."""
    steady = interval * np.diff(index)
    return phase_us[0] + np.concatenate([[0.0], np.cumsum(steady + wrap(np.diff(phase_us) - steady, period))])


def link(
    time: np.ndarray, interval: float, repeated: np.ndarray, period: float, counted: bool, window: int = 48
) -> np.ndarray:
    """Return (T,) position of every frame on a steady clock of the given interval.

    A repeated picture has the position of the one before; every other step is one more, or several after a drop. The
    cheapest of all such sequences is taken (Viterbi), where a frame costs up to one for missing its time, a drop half
    of that: drops are told from wrong single times because all frames after a drop agree with it. At the clip's ends
    there are few to agree, and a drop costs more than a frame's wrong phase. Half of a window is
    settled at a time, and the clock followed from window to window, so small errors of the interval do not add up.

    Args:
        time: (T,) right modulo `period`, single ones may be wrong.
        repeated: (T,) the first is False.
        counted: times are right without the modulo too, but for a few. Otherwise a drop of as many frames as fill whole
            periods cannot be seen, and the smallest that fits is taken.
    """
    order = np.cumsum(~repeated) - 1

    def follow(part: slice, origin: float, start: int | None = None) -> tuple[np.ndarray, float]:
        return _cheapest_shifts(
            time[part] - origin - interval * order[part],
            repeated[part],
            drop_cost[part],
            interval,
            period,
            counted,
            start,
        )

    place = np.arange(len(time))
    at_end = np.minimum(place, len(time) - place) < END_FRAMES
    drop_cost = np.where(at_end, END_DROP_COST, DROP_COST)
    index, shift, first = order.copy(), 0, slice(0, window)
    # Single times may be wrong: the clock starts from the frame that most others agree with.
    anchors = np.unique(np.linspace(0, len(time[first]) - 1, 9).astype(int))
    origin = min((time[k] - interval * order[k] for k in anchors), key=lambda o: follow(first, o)[1])
    origin += interval * follow(first, origin)[0][0]
    for begin in range(0, len(time), window // 2):
        part = slice(begin, begin + window)
        shifts, _ = follow(part, origin, shift)
        index[part] = order[part] + shifts
        settled = slice(begin, min(begin + window // 2, len(time)))
        shift = int(index[settled][-1] - order[settled][-1])
        rest = wrap(time[settled] - origin - interval * index[settled], period)
        near = np.abs(rest) < MISS * period
        origin += np.median(rest[near]) if near.any() else 0.0
    return index


def _cheapest_shifts(error, repeated, drop_cost, interval, period, counted, start):
    """Non-decreasing shifts (in intervals) that explain `error` (T,) us best, and their cost. start: shift before the
    first frame; None = any."""
    if counted:
        seen = np.rint(np.append(error / interval, [] if start is None else start)).astype(int)
        shifts = np.unique(seen[:, None] + np.arange(-2, 3))  # a frame between two drops may be misread
    else:
        shifts = np.arange(-16, 17) + (start or 0)
    shifts = shifts if start is None else shifts[shifts >= start]
    miss = error[:, None] - interval * shifts
    cost = np.minimum(np.abs(wrap(miss, period)) / (MISS * period), 1)
    if counted:
        cost += 0.5 * np.minimum(np.abs(miss) / interval, 1)
    size = 0.01 * shifts  # of drops that explain as much, the smallest
    best = -size if start is None else np.where(shifts == start, -size, np.inf)
    indices = np.arange(len(shifts))
    came_from = np.tile(indices, (len(error), 1))
    for k in range(len(error)):
        if not repeated[k] and (k or start is not None):
            lowest = np.minimum.accumulate(best)
            moves = lowest + drop_cost[k] < best
            came_from[k, moves] = np.maximum.accumulate(np.where(best == lowest, indices, 0))[moves]
            best = np.where(moves, lowest + drop_cost[k], best)
        best = best + cost[k]
    path = np.empty(len(error), int)
    path[-1] = (best + size).argmin()
    for k in range(len(error) - 1, 0, -1):
        path[k - 1] = came_from[k, path[k]]
    return shifts[path], float((best + size).min())


def unwrap_to(time: np.ndarray, index: np.ndarray, interval: float, period: float) -> np.ndarray:
    """Return times (right modulo the period) placed nearest to a steady clock through them."""
    z = np.exp(2j * np.pi * (time - index * interval) / period)
    start = np.angle(z.mean()) / (2 * np.pi) * period
    line = start + index * interval
    line += np.rint(np.median(time - line) / period) * period
    return line + wrap(time - line, period)


# ----------------------------------------------------------------
# Frames in which the board is hidden: a camera's clock carries on between those that show it.
#
# A board at the start and at the end of a take is enough. Its counter tells how many frames lie between, and a straight
# line through both parts gives the times of all.

LIKE_MARKER = 0.5  # correlation with the printed pattern; out of focus it is above 0.7, of anything else below 0.3
WANDER = 0.5e-6  # of the time since the board was seen: what a crystal's rate changes by within a take (assumed)
FEWEST_SEEN = 16


def board_seen(signals: Signals) -> np.ndarray:
    """Return (T,) frames that show the board. All where the marker was not looked for, or too few would be left."""
    if signals.marker is None:
        return np.ones(len(signals.strip), bool)
    seen = signals.marker > min(LIKE_MARKER, 0.7 * float(np.percentile(signals.marker, 90)))
    return seen if seen.sum() >= FEWEST_SEEN else np.ones(len(seen), bool)


def only_frames(signals: Signals, seen: np.ndarray) -> Signals:
    """Without the frames in which the board is hidden; the decoder takes them for dropped."""
    after_gap = np.flatnonzero(seen)[1:][np.diff(np.flatnonzero(seen)) > 1]
    duplicate = signals.duplicate.copy()
    duplicate[after_gap] = False
    return replace(signals, strip=signals.strip[seen], led=signals.led[seen], duplicate=duplicate[seen], marker=None)


def positions(seen: np.ndarray, index: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """Return positions on the camera's clock of all stored frames, from those of the frames that show the board.

    Args:
        seen: (T,) bool.   index: positions of those frames.
    Returns:
        (T,) positions; warnings about them.
    """
    shown = np.flatnonzero(seen)
    warnings = []
    for a, b, i, j in zip(shown, shown[1:], index, index[1:], strict=False):
        extra = int((j - i) - (b - a))
        if b - a > 1 and extra:
            what = f"{extra} frames are missing" if extra > 0 else f"{-extra} frames are shown twice"
            warnings.append(
                f"{what} somewhere between frames {a} and {b}, where the board is hidden: times there are up to "
                f"{abs(extra)} frames off"
            )
    frames = np.arange(len(seen))
    found = np.rint(np.interp(frames, shown, index)).astype(int)
    found = np.where(frames < shown[0], index[0] - (shown[0] - frames), found)
    return np.where(frames > shown[-1], index[-1] + (frames - shown[-1]), found), warnings


def wander_us(seen: np.ndarray, time_us: np.ndarray) -> np.ndarray:
    """Return (T,) what the clock may have wandered by since or until the board was seen."""
    shown = time_us[seen]
    after = np.clip(np.searchsorted(shown, time_us), 0, len(shown) - 1)
    nearest = np.minimum(np.abs(time_us - shown[after]), np.abs(time_us - shown[np.maximum(after - 1, 0)]))
    return WANDER * nearest
