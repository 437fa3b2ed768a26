"""What a chart of accuracy against time shows, whoever draws it: the page's or a figure for print."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from gof.evaluate.leaderboard import COLUMNS, LOWER, Row, pareto

CHARTS = ("l2", "cos_sim", "psnr_flame", "ssim_flame")  # scores that are drawn against the time they took


@dataclass(frozen=True)
class AccuracyChart:
    """A score against seconds to train.

    Attributes:
        key: of `COLUMNS`.   names: of the methods, one for each of the points.
        points: (seconds to train, score).
        constant: the score of one constant vector, a control; None where it has none.
    """

    key: str
    names: tuple[str, ...]
    points: tuple[tuple[float, float], ...]
    constant: float | None

    @property
    def heading(self) -> str:
        return COLUMNS[self.key].heading

    @property
    def title(self) -> str:
        lower = COLUMNS[self.key].better == LOWER
        return f"{self.heading} ({'lower' if lower else 'higher'} is better)"

    @property
    def front(self) -> list[tuple[float, float]]:
        """The points that nobody beats in both, by time."""
        return [self.points[i] for i in pareto(self.points, COLUMNS[self.key].better)]


def accuracy_charts(rows: Sequence[Row]) -> list[AccuracyChart]:
    """One for each score that a method has whose training time is known."""
    constant = next((row for row in rows if row.control and row.name.endswith("constant")), None)
    out = []
    for key in CHARTS:
        shown = [row for row in rows if not row.control and getattr(row, key) is not None and row.train_s]
        if shown:
            points = tuple((row.train_s, getattr(row, key)) for row in shown)
            level = None if constant is None else getattr(constant, key)
            out.append(AccuracyChart(key, tuple(row.name for row in shown), points, level))
    return out
