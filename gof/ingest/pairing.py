"""Frames of several cameras that were taken together, by the cameras' clocks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gof.core.errors import DataFormatError, GofError

SAME_RATE = 0.01  # relative: cameras that differ by less have one rate
NEAR = 0.6  # of a camera's step: how far its frame may lie from where its neighbours say it should
GAP = 1.5  # of a camera's step: longer, and a frame is missing
MAX_LEFT_OUT = 0.1  # share of moments without a frame of some camera, above which the clocks are not believed


@dataclass(frozen=True)
class Pairing:
    """`frames`: (T,) numbers per camera that belong together; `notes`: what a user should know of it, in words."""

    frames: list[np.ndarray]
    notes: tuple[str, ...]


def pair(names: list[str], clocks: list[np.ndarray], start: int, limit: int | None, source: str = "") -> Pairing:
    """Return a frame of every camera for each frame of the slowest one, from the first camera's frame `start` on.

    Each frame is the one nearest to the slowest camera's. Cameras whose rate is a whole multiple of its rate keep their
    phase: they are moved by how far the two were apart at the beginning, so that jitter swaps no neighbours. A time at
    which one camera has no frame (dropped, or shown twice) is skipped for all.

    Args:
        names: of the cameras, for messages.
        clocks: (N,) seconds of all frames of each camera, on one clock.
        start: frame number, 0 <= start < N of camera 0.
        limit: use at most so many; None for all.
        source: what to name in errors, where the clocks are from.
    Raises:
        DataFormatError: more than `MAX_LEFT_OUT` of the moments lack a frame of some camera.
        GofError: a camera has a single frame; the videos do not overlap; fewer than two moments are left.
    """
    where = f"{source}: " if source else ""
    for name, clock in zip(names, clocks, strict=True):
        if len(clock) < 2:
            raise GofError(f"{where}{name}: has {len(clock)} frame; a fire's motion needs at least 2 of every camera")
    own = [_growing(clock) for clock in clocks]  # frame numbers without those shown twice
    steps = [_usual_step(clock[k]) for clock, k in zip(clocks, own, strict=True)]
    slowest = 0 if steps[0] >= (1 - SAME_RATE) * max(steps) else int(np.argmax(steps))

    first = _first_frame(where, names, clocks, steps, start, slowest)
    moments = own[slowest][own[slowest] >= first]
    time_s = clocks[slowest][moments]
    chosen, present = [], np.ones(len(moments), bool)
    inside = np.ones(len(moments), bool)
    for clock, k, step in zip(clocks, own, steps, strict=True):
        phase = clock[_nearest(clock, k, time_s[:1])[0]] - time_s[0] if _steady_phase(steps[slowest] / step) else 0.0
        frames = _nearest(clock, k, time_s + phase)
        present &= np.abs(clock[frames] - time_s - phase) <= NEAR * step
        inside &= time_s + phase <= clock[-1] + 0.5 * step
        chosen.append(frames)
    used = np.flatnonzero(present & inside)
    for frames in chosen:
        used = used[np.diff(frames[used], prepend=-1) > 0]
    used = used[:limit]
    if len(used) < 2:
        raise GofError(
            f"{where}{len(used)} frames are left in common; at least 2 are needed (check --start, --frames and the "
            "times)"
        )
    lost = used[-1] + 1 - len(used)
    repeats = sum(len(clock) - len(k) for clock, k in zip(clocks, own, strict=True))  # say nothing of the clocks
    if lost - repeats > MAX_LEFT_OUT * (used[-1] + 1):
        raise DataFormatError(
            f"{where}at {lost} of {used[-1] + 1} moments some camera has no frame, first at frame "
            f"{moments[np.flatnonzero(~present)[0]]} of {names[slowest]}: do the times belong to these videos? If so, "
            "choose a range without with --start and --frames"
        )
    paired = [numbers[used] for numbers in chosen]
    return Pairing(paired, tuple(_notes(names, clocks, steps, paired, slowest)))


def _growing(clock: np.ndarray) -> np.ndarray:
    """Return numbers of the frames that are later than all before."""
    return np.flatnonzero(np.diff(np.maximum.accumulate(clock), prepend=-np.inf) > 0)


def _usual_step(time_s: np.ndarray) -> float:
    return float(np.median(np.diff(time_s))) if len(time_s) > 1 else np.inf


def _steady_phase(ratio: float) -> bool:
    return np.isfinite(ratio) and abs(ratio - round(ratio)) <= SAME_RATE * ratio


def _nearest(clock: np.ndarray, own: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Return, of the frames `own`, the one nearest in time to each of `wanted` (M,) s."""
    after = (
        np.clip(np.searchsorted(clock[own], wanted), 1, len(own) - 1) if len(own) > 1 else np.zeros(len(wanted), int)
    )
    before = np.maximum(after - 1, 0)
    return own[np.where(wanted - clock[own[before]] <= clock[own[after]] - wanted, before, after)]


def _first_frame(
    where: str, names: list[str], clocks: list[np.ndarray], steps: list[float], start: int, slowest: int
) -> int:
    """Return the slowest camera's frame nearest to the first camera's frame `start`, or to its first after all have
    begun."""
    begun = max(clock[0] - 0.5 * step for clock, step in zip(clocks, steps, strict=True) if np.isfinite(step))
    ended = min(clock[-1] + 0.5 * step for clock, step in zip(clocks, steps, strict=True) if np.isfinite(step))
    reference = clocks[0][start:]
    together = np.flatnonzero((reference >= begun) & (reference <= ended))
    if not len(together):
        spans = ", ".join(
            f"{name} {clock[0]:.3f} to {clock[-1]:.3f} s" for name, clock in zip(names, clocks, strict=True)
        )
        late = f" from frame {start} of {names[0]} on" if start else ""
        board = (
            " Was the LED board restarted between them, or was another layout used to read it (gof capture sync "
            "--board, --tick-us)?"
        )
        raise GofError(
            f"{where}the videos do not overlap in time{late} ({spans}): are they of one take, and their times of one "
            f"clock?{board if where else ' See --start.'}"
        )
    return int(np.abs(clocks[slowest] - reference[together[0]]).argmin())


def _notes(
    names: list[str], clocks: list[np.ndarray], steps: list[float], frames: list[np.ndarray], slowest: int
) -> list[str]:
    """Return notes where pairs are not plainly one frame of each after the other."""
    notes = []
    if max(steps) > (1 + SAME_RATE) * min(steps):
        rates = ", ".join(f"{name} {1 / step:.4g}" for name, step in zip(names, steps, strict=True))
        notes.append(f"the cameras differ in rate ({rates} frames per second): paired by time, at {names[slowest]}'s")
    for name, clock, step, used in zip(names, clocks, steps, frames, strict=True):
        range_s = clock[used[0] : used[-1] + 1]
        gaps = np.flatnonzero(np.diff(range_s) > GAP * step)
        twice = np.flatnonzero(np.diff(range_s) <= 0)
        missing = round(float((np.diff(range_s)[gaps] / step - 1).sum())) - len(twice)
        if missing > 0:
            notes.append(
                f"{name}: {missing} frames are missing, first after frame {used[0] + gaps[0]}; left out for all"
            )
        if len(twice):
            notes.append(
                f"{name}: {len(twice)} frames are shown twice, first after frame {used[0] + twice[0]}; left out for all"
            )
    counts = [len(clock) for clock in clocks]
    if len(set(counts)) > 1:
        each = ", ".join(f"{name} {count}" for name, count in zip(names, counts, strict=True))
        notes.append(f"{len(frames[0])} moments in which all cameras filmed are used (frames: {each})")
    return notes
