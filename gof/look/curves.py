"""The curves of the pages, drawn again for print."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from gof.evaluate.scores import Scores
from gof.look.accuracy_chart import AccuracyChart
from gof.look.leaderboard_page import COLORS
from gof.look.line_chart import dress, number_decades, plain
from gof.look.paper import LETTERS, SMALL, printed

Kind = Literal["pdf", "svg", "png"]
SIZE_IN = 3.4, 2.5  # one column of a paper
ROW_IN, LETTERS_A_ROW = 0.14, 56  # of a legend
MARKS = "osD^PXvh*"
FRONT, FIRE, GREY = "#e8772e", "#c2410c", "#777777"


def write_accuracy(path: Path, chart: AccuracyChart) -> None:
    """Seconds to train (logarithmic) against a score, the front that nobody beats, and the constant control.

    Raises:
        GofError: no such kind of figure.   MissingDependencyError: matplotlib is not installed.
    """
    width, height = SIZE_IN
    names = [plain(name, LETTERS_A_ROW) for name in chart.names]
    legend_in = ROW_IN * (sum(name.count("\n") + 1 for name in names) + 2)
    with printed(path, width, height + legend_in) as figure:
        whole = height + legend_in
        axes = figure.add_axes((0.17, (legend_in + 0.45) / whole, 0.8, (height - 0.75) / whole))
        x, y = zip(*chart.front, strict=True)
        axes.step(x, y, where="post", color=FRONT, linewidth=1, label="nobody is better and faster")
        for number, (name, (seconds, score)) in enumerate(zip(names, chart.points, strict=True)):
            style = {"color": COLORS[number % len(COLORS)], "marker": MARKS[number % len(MARKS)]}
            axes.plot([seconds], [score], linestyle="none", markersize=4.5, label=name, **style)
        if chart.constant is not None:
            axes.axhline(chart.constant, color=GREY, linestyle=":", linewidth=0.9, label="one constant vector")
        axes.set_xscale("log")
        times_s = [seconds for seconds, _ in chart.points]
        low, high = 0.7 * min(times_s), 1.4 * max(times_s)
        axes.set_xlim(low, high)
        number_decades(axes.xaxis, low, high)
        axes.set_xlabel("seconds to train")
        axes.set_ylabel(chart.heading)
        axes.set_title(chart.title, fontsize=LETTERS, loc="left")
        dress(axes)
        figure.legend(loc="lower left", bbox_to_anchor=(0.1, 0.0), fontsize=SMALL, frameon=False)


def write_frame_scores(path: Path, scores: Scores) -> bool:
    """L2 of each frame over time with what standing still and one constant vector score; False below two scored frames.

    Raises: see `write_accuracy`.
    """
    frames = scores.dve.frames if scores.dve else ()
    if sum(frame.l2 is not None for frame in frames) < 2:
        return False
    start_s = frames[0].time_s
    with printed(path, *SIZE_IN) as figure:
        axes = figure.add_axes((0.14, 0.17, 0.83, 0.72))
        times_ms = [1000 * (frame.time_s - start_s) for frame in frames]
        values = [float("nan") if frame.l2 is None else frame.l2 for frame in frames]  # a gap in the line
        axes.plot(times_ms, values, color=FIRE, linewidth=1.2, label="this result")
        axes.axhline(1, color=GREY, linestyle=":", linewidth=0.9, label="standing still")
        constant = scores.controls.get("constant")
        if constant is not None and constant.l2 is not None:
            axes.axhline(constant.l2, color=GREY, linestyle="--", linewidth=0.9, label="one constant vector")
        axes.set_xlabel("time (ms)")
        axes.set_ylabel("DVE L2")
        axes.set_ylim(0, 1.15 * max(1.0, *(value for value in values if value == value)))
        axes.set_title("DVE L2 of each frame (lower is better)", fontsize=LETTERS, loc="left")
        dress(axes)
        axes.legend(fontsize=SMALL, frameon=False, ncols=3, loc="upper left", columnspacing=1, handlelength=1.6)
    return True
