"""The report's chart of L2 over time, as the points that its SVG needs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gof.evaluate.scores import FrameScore, Scores

LEFT, WIDTH, BOTTOM, HEIGHT = 40, 550, 165, 150  # of the axes, in a box of 600 x 185
LABEL_ABOVE, LABEL_BELOW = -5, 13  # from a line to the foot of its label


@dataclass(frozen=True)
class Chart:
    """Heights of the marks, the curve's pieces as "x,y x,y ...", and the last time in ms. y grows downwards."""

    lines: list[str]
    zero: float
    one: float
    constant: float | None  # of the constant control
    constant_label: float | None
    end_ms: int


def l2_chart(scores: Scores) -> Chart | None:
    """L2 of each frame; None below two scored frames. Undefined frames leave a gap."""
    frames = scores.dve.frames if scores.dve else ()
    values = [frame.l2 for frame in frames if frame.l2 is not None]
    if len(values) < 2:
        return None
    top = 1.1 * max([1.0, *values])
    start_s, end_s = frames[0].time_s, frames[-1].time_s

    def y(value: float) -> float:
        return round(BOTTOM - HEIGHT * value / top, 1)

    def point(frame: FrameScore) -> str:
        return f"{LEFT + WIDTH * (frame.time_s - start_s) / (end_s - start_s):.1f},{y(frame.l2)}"

    control = scores.controls.get("constant")
    constant = None if control is None or control.l2 is None else y(control.l2)
    label = None
    if constant is not None:  # clear of the curve
        label = constant + (LABEL_BELOW if np.mean(values) > control.l2 else LABEL_ABOVE)
    return Chart(
        lines=[" ".join(map(point, piece)) for piece in _pieces(frames)],
        zero=y(0),
        one=y(1.0),
        constant=constant,
        constant_label=label,
        end_ms=round(1000 * (end_s - start_s)),
    )


def _pieces(frames: Sequence[FrameScore]) -> list[list[FrameScore]]:
    """The frames with a score, cut where one is missing."""
    pieces: list[list[FrameScore]] = [[]]
    for frame in frames:
        if frame.l2 is not None:
            pieces[-1].append(frame)
        elif pieces[-1]:
            pieces.append([])
    return [piece for piece in pieces if piece]
