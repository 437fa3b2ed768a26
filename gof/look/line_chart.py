"""A line chart, drawn by matplotlib: .svg for a page, .pdf for a paper, .png for anything else.

White behind it in every format, so that it reads the same on a light and on a dark page.
"""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from gof.look.paper import SMALL, printed

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SIZE_IN = 5.8, 3.5  # of the axes with their labels; the legend is below
TITLE, WORDS, POINT_LABEL = 10.5, 9.0, 7.5  # pt
ROW_IN, LETTERS_A_ROW = 0.17, 84  # of the legend
COLOURS = ("#c2410c", "#1d4ed8", "#15803d", "#7e22ce", "#0e7490", "#a16207", "#be185d", "#475569")
DASHES, MARKS = ("-", "--", ":"), "os^Dv"  # the second round of the colours is dashed
GRID = "#e3e3e3"
STEPS = (1, 2, 5)  # of a decade that get a number
MARKED = 25  # a line of more points has no marks
LABELS_TURN = 0.85  # of the width: labels further right stand left of their marks
ROOM = 0.06  # beyond the outermost points, of an axis

Logarithmic = Literal["xy", "x", "y", ""]


class Point(NamedTuple):
    """A mark, what is written beside it, and how far the bar through it goes up and down."""

    x: float
    y: float
    label: str = ""
    spread: float = 0.0


def write(
    path: Path,
    title: str,
    x_label: str,
    y_label: str,
    lines: Mapping[str, Sequence[Point | tuple[float, float, str]]],
    log: Logarithmic = "xy",
) -> None:
    """Write one chart.

    Args:
        x_label, y_label: with their units.
        lines: points by the name in the legend. What has no place on a logarithmic axis, and NaN, is left out.
        log: the axes that are logarithmic.
    Raises:
        GofError: `path` is no .svg, .pdf or .png.   MissingDependencyError: matplotlib is not installed.
    """
    placed = {name: [Point(*p) for p in points if _has_place(Point(*p), log)] for name, points in lines.items()}
    names = {name: plain(name, LETTERS_A_ROW) for name in placed}
    width, height = SIZE_IN
    legend_in = ROW_IN * sum(words.count("\n") + 1 for words in names.values()) + 0.1
    whole = height + legend_in
    with printed(path, width, whole) as figure:
        axes = figure.add_axes((0.14, (legend_in + 0.5) / whole, 0.83, (height - 0.85) / whole))
        for number, (name, points) in enumerate(placed.items()):
            colour = COLOURS[number % len(COLOURS)]
            axes.plot(
                [point.x for point in points],
                [point.y for point in points],
                color=colour,
                linestyle=DASHES[number // len(COLOURS) % len(DASHES)],
                marker=MARKS[number % len(MARKS)] if len(points) <= MARKED else None,
                linewidth=1.4,
                markersize=3.5,
                label=names[name],
            )
            for x, y, _, spread in points:
                if spread:
                    axes.plot([x, x], [y - spread, y + spread], color=colour, linewidth=1.0)
        for which, axis, column in (("x", axes.xaxis, 0), ("y", axes.yaxis, 1)):
            values = [point[column] for points in placed.values() for point in points]
            if values and which in log:
                getattr(axes, f"set_{which}scale")("log")
                low, high = _limits(values)
                getattr(axes, f"set_{which}lim")(low, high)
                number_decades(axis, low, high)
        for number, points in enumerate(placed.values()):
            for point in (point for point in points if point.label):
                _write_beside(axes, point, COLOURS[number % len(COLOURS)])
        axes.set_xlabel(x_label, fontsize=WORDS)
        axes.set_ylabel(y_label, fontsize=WORDS)
        axes.set_title(title, fontsize=TITLE, fontweight="bold", loc="left")
        dress(axes, WORDS)
        figure.legend(loc="lower left", bbox_to_anchor=(0.1, 0.0), fontsize=WORDS, frameon=False, labelspacing=0.3)


def _write_beside(axes: Axes, point: Point, colour: str) -> None:
    """A mark's words: right of it, or left of it in the right part of the chart, where they would leave the figure."""
    across, _ = axes.transAxes.inverted().transform(axes.transData.transform((point.x, point.y)))
    side, shift = ("left", 4) if across < LABELS_TURN else ("right", -4)
    axes.annotate(
        plain(point.label, LETTERS_A_ROW),
        (point.x, point.y),
        xytext=(shift, 4),
        textcoords="offset points",
        horizontalalignment=side,
        fontsize=POINT_LABEL,
        color=colour,
    )


def _has_place(point: Point, log: Logarithmic) -> bool:
    if not np.isfinite((point.x, point.y)).all():
        return False
    return ("x" not in log or point.x > 0) and ("y" not in log or point.y > 0)


def _limits(values: Sequence[float]) -> tuple[float, float]:
    """Of a logarithmic axis."""
    low, high = np.log10([min(values), max(values)])
    room = max(ROOM * (high - low), 0.02)
    return float(10 ** (low - room)), float(10 ** (high + room))


def number_decades(axis, low: float, high: float) -> None:
    """Plain numbers on a logarithmic axis: 1, 2 and 5 of each decade; powers of ten over many; even steps within one.

    Args:
        axis: matplotlib's, `axes.xaxis` or `axes.yaxis`.
        low, high: its limits, above zero.
    """
    decades = np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)) + 1)
    wide = np.log10(high / low)
    if wide > 8:
        decades = decades[decades % 4 == 0]
    ticks = np.outer(10.0**decades, STEPS if wide < 2.5 else (1,)).ravel()
    ticks = ticks[(ticks >= low) & (ticks <= high)]
    if len(ticks) < 3:
        unit = 10.0 ** np.floor(np.log10((high - low) / 2))
        step = next(many * unit for many in (*STEPS, 10) if (high - low) / (many * unit) <= 6)
        ticks = step * np.arange(np.ceil(low / step), np.floor(high / step) + 1)
    axis.set_ticks(ticks, [f"{tick:.6g}" for tick in ticks])
    axis.set_ticks([], minor=True)


def plain(name: str, letters: int) -> str:
    """A name in rows of so many letters, which matplotlib takes neither for a formula nor for none at all."""
    return textwrap.fill(name, letters).replace("$", "\\$").lstrip("_") or "-"


def dress(axes: Axes, size: float = SMALL) -> None:
    """A thin grid behind the data, numbers of `size` pt, no box."""
    axes.grid(color=GRID, linewidth=0.4)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=size, width=0.5, length=2.5)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
