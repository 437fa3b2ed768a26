"""Pictures that are no whole ones: interlaced, so that they show two times at once, or shown twice."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

TEETH = 6  # lines that stand out in turn, up and down
STANDS_OUT = 8  # levels of 255 by which a line stands out from its neighbours, or a pixel changes when it moves
MOST_COMBED = 0.05  # share of the moving pixels in combs; interlaced fire has 0.22 and more, films of it below 0.0001
ENOUGH, HARDLY = 2000, 0.001  # pixels that moved, and the share of them in combs, by which pictures are whole
SIDEWAYS = 4  # combs of noise and fine patterns are as many along columns; those of fields only along rows
MOST_LINES = 480  # rows or columns that are looked at


@dataclass(frozen=True)
class Combs:
    """How many pixels moved, and how many of them lie in combs of rows, and of columns."""

    moved: int
    along_rows: int
    along_columns: int

    @property
    def shown(self) -> bool:
        """Whether the pictures are interlaced."""
        return self.along_rows > MOST_COMBED * self.moved and self.along_rows > SIDEWAYS * self.along_columns

    @property
    def ruled_out(self) -> bool:
        """Whether they are not, although much moved."""
        return self.moved >= ENOUGH and self.along_rows < HARDLY * self.moved


def find_combs(pairs: Iterable[tuple[np.ndarray, np.ndarray]]) -> Combs:
    """In pictures that follow each other, (H, W, 3) uint8, where something moved between them."""
    found = np.zeros(3, int)
    for before, after in pairs:
        moved, combs = _combs(before, after)
        found += (moved, combs, _combs(before.swapaxes(0, 1), after.swapaxes(0, 1))[1])
    return Combs(*found.tolist())


def _combs(before: np.ndarray, after: np.ndarray) -> tuple[int, int]:
    """Return the number of pixels that moved, and of those among them in combs of lines (axis 0)."""
    every = -(-after.shape[1] // MOST_LINES)
    first, then = (picture[:, ::every, 1].astype(np.int16) for picture in (before, after))
    moved = np.abs(then - first) > STANDS_OUT
    teeth = 2 * then[1:-1] - then[:-2] - then[2:]
    teeth[1::2] *= -1
    in_combs = 0
    for sign in (1, -1):
        out = (sign * teeth > 2 * STANDS_OUT) & moved[1:-1]
        if len(out) < TEETH:
            continue
        runs = np.logical_and.reduce([out[k : len(out) - TEETH + 1 + k] for k in range(TEETH)])
        combed = np.zeros_like(out)
        for k in range(TEETH):
            combed[k : k + len(runs)] |= runs
        in_combs += int(combed.sum())
    return int(moved.sum()), in_combs


# ----------------------------------------------------------------
# Frames that a copy shows twice: where a program filled a gap, or made another rate of a film.

COMPARED_EVERY = 4  # rows and columns of which one is compared
NEIGHBOURS = 5  # frames on either side
# Frames on either side that show a copy's step, and how many of them must change: a film at 30 in 240 has one in eight.
IN_STEP = 12, 3
REPEATED_SHARE = 0.1  # of the usual change; single frames of films of fire have 0.5 and more
CHANGES = 0.2  # levels of 255 by which a film's pictures must change, mean, for a repeat to be one


class FrameChanges:
    """Changes of a film's pictures from frame to frame, which it gathers as they are read."""

    def __init__(self) -> None:
        self._before: np.ndarray | None = None
        self._changes: list[float] = []

    def add(self, picture: np.ndarray) -> None:
        """Take the next frame, (H, W, 3) uint8."""
        now = picture[::COMPARED_EVERY, ::COMPARED_EVERY, 1].astype(np.int16)
        change = np.inf
        if self._before is not None and self._before.shape == now.shape:
            change = float(np.abs(now - self._before).mean())
        self._changes.append(change)
        self._before = now

    @property
    def repeated(self) -> tuple[int, ...]:
        """Numbers of the frames that show what the one before them shows, although the film moves around them.

        Most of a copy's frames may be repeats: then those that change come in even steps.
        """
        return tuple(k for k in range(1, len(self._changes)) if self._changes[k] < REPEATED_SHARE * self._usual(k))

    def _usual(self, k: int) -> float:
        """Return how much the frames around frame k change; 0 where they rest."""
        around = self._changes[max(k - NEIGHBOURS, 1) : k] + self._changes[k + 1 : k + 1 + NEIGHBOURS]
        usual = float(np.median(around)) if around else 0.0
        if usual > CHANGES:
            return usual if np.isfinite(usual) else 0.0
        reach, least = IN_STEP
        begin = max(k - reach, 0)
        near = np.array(self._changes[begin : k + reach + 1])
        changes = near[np.isfinite(near)]  # without those to a picture of another size, as the film's first is
        of_step = changes[changes > REPEATED_SHARE * changes.max(initial=0)]
        changed = begin + np.flatnonzero(near > REPEATED_SHARE * changes.max(initial=0))
        if len(changed) < least or not len(of_step) or np.ptp(np.diff(changed)) > 1:
            return 0.0
        between = changed[0] < k and (k < changed[-1] or len(self._changes) - changed[-1] <= np.diff(changed).max())
        usual = float(np.median(of_step))
        return usual if between and usual > CHANGES else 0.0
