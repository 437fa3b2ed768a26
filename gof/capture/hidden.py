"""Frames in which the board is hidden: a camera's clock carries on between those that show it.

A board at the start and at the end of a take is enough. Its counter tells how many frames lie between, and a straight
line through both parts gives the times of all.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gof.capture.signals import Signals

LIKE_MARKER = 0.5  # correlation with the printed pattern; out of focus it is above 0.7, of anything else below 0.3
WANDER = 0.5e-6  # of the time since the board was seen: what a crystal's rate changes by within a take (assumed)
FEWEST_SEEN = 16


def board_seen(signals: Signals) -> np.ndarray:
    """(T,) frames that show the board. All of them where nobody looked, or where too few would be left."""
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
    """Positions on the camera's clock of all stored frames, from those of the frames that show the board.

    Args:
        seen: (T,) bool.   index: positions of those frames.
    Returns:
        (T,) positions; what is doubtful about them, in words.
    """
    shown = np.flatnonzero(seen)
    doubts = []
    for a, b, i, j in zip(shown, shown[1:], index, index[1:], strict=False):
        extra = int((j - i) - (b - a))
        if b - a > 1 and extra:
            what = f"{extra} frames are missing" if extra > 0 else f"{-extra} frames are shown twice"
            doubts.append(
                f"{what} somewhere between frames {a} and {b}, where the board is hidden: times there are up to "
                f"{abs(extra)} frames off"
            )
    frames = np.arange(len(seen))
    found = np.rint(np.interp(frames, shown, index)).astype(int)
    found = np.where(frames < shown[0], index[0] - (shown[0] - frames), found)
    return np.where(frames > shown[-1], index[-1] + (frames - shown[-1]), found), doubts


def wander_us(seen: np.ndarray, time_us: np.ndarray) -> np.ndarray:
    """(T,) what the clock may have wandered by since or until the board was seen."""
    shown = time_us[seen]
    after = np.clip(np.searchsorted(shown, time_us), 0, len(shown) - 1)
    nearest = np.minimum(np.abs(time_us - shown[after]), np.abs(time_us - shown[np.maximum(after - 1, 0)]))
    return WANDER * nearest
