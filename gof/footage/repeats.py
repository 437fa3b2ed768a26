"""Frames that a copy shows twice: where a program filled a gap, or made another rate of a film."""

from __future__ import annotations

import numpy as np

EVERY = 4  # rows and columns of which one is compared
NEIGHBOURS = 5  # frames on either side
MOST = 0.1  # of the neighbours' median change; single frames of films of fire have 0.5 and more
CHANGES = 0.2  # levels of 255 by which a film's pictures must change, mean, for a repeat to be one


class Changes:
    """Changes of a film's pictures from frame to frame, which it gathers as they are read."""

    def __init__(self) -> None:
        self._before: np.ndarray | None = None
        self._changes: list[float] = []

    def add(self, picture: np.ndarray) -> None:
        """Take the next frame, (H, W, 3) uint8."""
        now = picture[::EVERY, ::EVERY, 1].astype(np.int16)
        change = np.inf
        if self._before is not None and self._before.shape == now.shape:
            change = float(np.abs(now - self._before).mean())
        self._changes.append(change)
        self._before = now

    @property
    def repeated(self) -> tuple[int, ...]:
        """Numbers of the frames that show what the one before them shows, although the film moves around them."""
        found = []
        for k in range(1, len(self._changes)):
            around = self._changes[max(k - NEIGHBOURS, 1) : k] + self._changes[k + 1 : k + 1 + NEIGHBOURS]
            usual = float(np.median(around)) if around else 0.0
            if np.isfinite(usual) and usual > CHANGES and self._changes[k] < MOST * usual:
                found.append(k)
        return tuple(found)
