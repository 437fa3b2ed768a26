"""All charts, drawn by matplotlib: inline SVG for pages, and .pdf, .svg and .png for papers.

A `Chart` is what to draw and how large; `Chart.svg` and `Chart.write` draw it. On a page letters are text, colours
are those for black (for white where it is printed), and marks say their numbers to a resting pointer. In a file the
ground is white and letters are outlines (.svg) or whole TrueType fonts (.pdf), which publishers ask for. The same chart
is the same bytes at any time.
"""

from __future__ import annotations

import io
import re
import textwrap
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from html import escape
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from gof.core.errors import GofError
from gof.core.files import atomic_path
from gof.evaluate.leaderboard import COLUMNS, LOWER, LeaderboardRow, pareto

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

    from gof.capture.decode import CameraTimes
    from gof.evaluate.scores import Scores

Kind = Literal["pdf", "svg", "png"]
Logarithmic = Literal["xy", "x", "y", ""]

SUFFIXES = (".pdf", ".svg", ".png")
DPI, PAGE_DPI = 300, 150  # of a .png; and of what is pixels in a page's SVG
LETTERS, SMALL = 7.5, 6.0  # pt
COLOURS = ("#c2410c", "#1d4ed8", "#15803d", "#7e22ce", "#0e7490", "#a16207", "#be185d", "#475569")
DASHES, MARKS = ("-", "--", ":"), "os^DvPX*"  # the second round of the colours is dashed
INK, SOFT, GRID, FRONT = "#1c1c1e", "#6b6b70", "#e3e3e3", "#e8772e"
DARK = dict(  # what a colour becomes on a screen, where pages are dark (page.css)
    zip(
        (*COLOURS, INK, SOFT, GRID),
        ("#fb923c", "#7aa2ff", "#5fce85", "#c79bfa", "#4cc9e0", "#e3b341", "#f783b5", "#a8b3c2")
        + ("#ece7e0", "#a29a90", "#3a3632"),
        strict=True,
    )
)
STYLE = {
    "svg.hashsalt": "gof",
    "pdf.fonttype": 42,
    "font.size": LETTERS,
    "axes.linewidth": 0.5,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": SOFT,
    "xtick.color": SOFT,
    "ytick.color": SOFT,
}
ON_A_PAGE = {"svg.fonttype": "none", "figure.facecolor": "none", "axes.facecolor": "none"}
LETTER_PX = 15  # of labels on a page, where there is room
TIP = "tip:"  # begins the name of a mark that says its numbers
ONE_AT_A_TIME = threading.Lock()  # matplotlib's settings are the process's

STEPS = (1, 2, 5)  # of a decade that get a number
MARKED = 25  # a line of more points has no marks
TIPPED = 400  # a line of more points says no numbers
LABELS_TURN = 0.85  # of the width: labels further right stand left of their marks
ROOM = 0.06  # beyond the outermost points, of an axis
ACCURACY = ("l2", "cos_sim", "psnr_flame", "ssim_flame")  # scores that are drawn against the time they took
FAINT = 0.02  # of the largest density: below, no stream is drawn
STREAM_CELLS = 1.2  # between two streamlines
GROUND = "#121214"  # of stream plots: fire is light


@dataclass(frozen=True)
class Chart:
    """A chart that is not drawn yet.

    Attributes:
        title: what people read who do not see it.
        size_in: width and height in print, inches.
        draw: draws it into an empty figure of that size.
        letters: of its labels, pt.
    """

    title: str
    size_in: tuple[float, float]
    draw: Callable[[Figure], None]
    letters: float = LETTERS

    def svg(self) -> str:
        """Return an <svg> for a page of HTML, as wide as there is room, until its letters have the page's size."""
        drawn = io.BytesIO()
        with _style(ON_A_PAGE):
            self._drawn().savefig(drawn, format="svg", dpi=PAGE_DPI, metadata=dict.fromkeys(("Date", "Creator")))
        size_pt = (72 * self.size_in[0], 72 * self.size_in[1])
        return _inline(drawn.getvalue().decode(), self.title, size_pt, LETTER_PX / self.letters)

    def write(self, path: Path) -> None:
        """Write a file. Raises GofError: `path` is no .pdf, .svg or .png."""
        require_figure(path)
        kind = path.suffix.lower()[1:]
        dates: dict[str, dict[str, str | None]] = {"pdf": {"CreationDate": None}, "svg": {"Date": None}, "png": {}}
        about = dates[kind]
        about |= {"Title": self.title} if self.title else {}
        with _style({}), atomic_path(path) as temporary:
            self._drawn().savefig(temporary, format=kind, dpi=DPI, metadata=about)

    def _drawn(self) -> Figure:
        from matplotlib.figure import Figure

        figure = Figure(figsize=self.size_in)
        self.draw(figure)
        return figure


def require_figure(*paths: Path) -> None:
    """Raise GofError for a suffix of which no figure is made."""
    for path in paths:
        if path.suffix.lower() not in SUFFIXES:
            raise GofError(f"{path}: a figure is a {', '.join(SUFFIXES)}")


def text_width_in(words: str, size: float) -> float:
    """Return the inches that words take in a size in pt."""
    from matplotlib.textpath import TextPath

    return TextPath((0, 0), words, size=size).get_extents().xmax / 72


@contextmanager
def _style(settings: Mapping[str, str]) -> Iterator[None]:
    """Hold matplotlib for one thread, in our style, whatever the user's own settings are."""
    from matplotlib import style

    with ONE_AT_A_TIME, style.context(["default", {**STYLE, **settings}]):
        yield


def _inline(drawn: str, title: str, size_pt: tuple[float, float], px_per_pt: float) -> str:
    """matplotlib's SVG as part of a page: named, in the page's letters and for its ground, with numbers at its marks.

    Names of groups go, because several charts of a page would share them; definitions of one name are equal.
    """
    body = re.sub(r"<metadata>.*?</metadata>\s*", "", drawn[drawn.index(">", drawn.index("<svg")) + 1 :], flags=re.S)
    body = body.replace("*{stroke", ".chart *{stroke")
    body = re.sub(rf'<g id="{TIP}([^"]*)">', r"<g><title>\1</title>", body)
    body = re.sub(r'<g id="[^"]*">', "<g>", body)
    body = re.sub(r"font: ((?:\d+ )?)([\d.]+px)[^;\"]*", _own_letters, body)  # of matplotlib before 3.11
    body = re.sub(r"font-family: [^;\"]*;? ?", "", body)
    body = re.sub("|".join(DARK), lambda found: f"var(--{found[0][1:]}, {found[0]})", body)
    dark = "; ".join(f"--{light[1:]}: {dark}" for light, dark in DARK.items())
    width, height = size_pt
    return (
        f'<svg class="chart" role="img" aria-label="{escape(title)}" viewBox="0 0 {width:g} {height:g}" width="100%" '
        f'style="max-width: {px_per_pt * width:.0f}px">\n'
        f"<style>@media screen {{ .chart {{ {dark} }} }}</style>{body}"
    )


def _own_letters(font: re.Match) -> str:
    weight = f"font-weight: {font[1].strip()}; " if font[1] else ""
    return f"{weight}font-size: {font[2]}"


# ---------------------------------------------------------------- what all have in common


class ChartSize(NamedTuple):
    """Size of a chart without its legend, inches, where its axes begin, as shares of it, and its letters, pt."""

    width: float
    height: float
    left: float
    letters: float

    @property
    def small(self) -> float:
        return self.letters * SMALL / LETTERS


COLUMN = ChartSize(3.4, 2.4, 0.16, LETTERS)  # one column of a paper
WIDE = ChartSize(5.8, 3.5, 0.14, 9.0)


def _chart(
    title: str, x_label: str, y_label: str, names: Sequence[str], size: ChartSize, fill: Callable[[Axes], None]
) -> Chart:
    """Return a chart with its title above, and a legend of `names` below, in rows; `fill` draws the data."""
    row_in = 1.4 * size.small / 72
    legend_in = row_in * sum(name.count("\n") + 1 for name in names) + 0.1
    whole = size.height + legend_in

    def draw(figure: Figure) -> None:
        below, above = 3.6 * size.letters / 72, 2.6 * size.letters / 72
        area = (size.left, (legend_in + below) / whole, 0.97 - size.left, (size.height - below - above) / whole)
        axes = figure.add_axes(area)
        fill(axes)
        axes.set_xlabel(x_label, fontsize=size.letters)
        axes.set_ylabel(y_label, fontsize=size.letters)
        axes.set_title(title, fontsize=1.1 * size.letters, fontweight="bold", loc="left")
        _dress(axes, size.small)
        corner = (size.left - 0.04, 0.0)
        figure.legend(fontsize=size.small, frameon=False, labelspacing=0.3, loc="lower left", bbox_to_anchor=corner)

    return Chart(title, (size.width, whole), draw, size.letters)


def _dress(axes: Axes, size: float) -> None:
    """Add a thin grid behind the data, numbers of `size` pt, no box."""
    axes.grid(color=GRID, linewidth=0.4)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=size, labelcolor=INK, width=0.5, length=2.5)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def _plain(name: str, size: ChartSize) -> str:
    """Return a name in rows that fit the chart, which matplotlib takes neither for a formula nor for none at all."""
    letters = int(97 * size.width / size.small)  # of 0.58 of their height each, beside the legend's marks
    return textwrap.fill(name, letters).replace("$", "\\$").lstrip("_") or "-"


def _tip(*words: str) -> dict[str, Any]:
    """Return the text of a mark, as an argument of matplotlib's."""
    return {"gid": TIP + ", ".join(word for word in words if word)}


def _limits(values: Sequence[float], room: float = ROOM) -> tuple[float, float]:
    """Return the limits of a logarithmic axis."""
    low, high = np.log10([min(values), max(values)])
    beyond = max(room * (high - low), 0.02)
    return float(10 ** (low - beyond)), float(10 ** (high + beyond))


def _number_decades(axis: Axis, low: float, high: float) -> None:
    """Plain numbers on a logarithmic axis: 1, 2 and 5 of each decade; powers of ten over many; even steps within one.

    Args:
        axis: `axes.xaxis` or `axes.yaxis`.
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


# ---------------------------------------------------------------- lines


class Point(NamedTuple):
    """A mark, what is written beside it, and how far the bar through it goes up and down."""

    x: float
    y: float
    label: str = ""
    spread: float = 0.0


def line_chart(
    title: str,
    x_label: str,
    y_label: str,
    lines: Mapping[str, Sequence[Point | tuple[float, float, str]]],
    log: Logarithmic = "xy",
) -> Chart:
    """Make a chart of lines.

    Args:
        x_label, y_label: with their units.
        lines: points by the name in the legend. NaN, and values without a place on a logarithmic axis, are left out.
        log: the axes that are logarithmic.
    """
    placed = {name: [Point(*p) for p in points if _has_place(Point(*p), log)] for name, points in lines.items()}
    names = {name: _plain(name, WIDE) for name in placed}

    def fill(axes: Axes) -> None:
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
                **_tip(name),
            )
            for x, y, _, spread in points:
                if spread:
                    axes.plot([x, x], [y - spread, y + spread], color=colour, linewidth=1.0)
        for which, axis in (("x", axes.xaxis), ("y", axes.yaxis)):
            values: list[float] = [getattr(point, which) for points in placed.values() for point in points]
            if values and which in log:
                getattr(axes, f"set_{which}scale")("log")
                low, high = _limits(values)
                getattr(axes, f"set_{which}lim")(low, high)
                _number_decades(axis, low, high)
        for number, points in enumerate(placed.values()):
            for point in (point for point in points if point.label):
                _write_beside(axes, point, COLOURS[number % len(COLOURS)])

    return _chart(title, x_label, y_label, list(names.values()), WIDE, fill)


def _write_beside(axes: Axes, point: Point, colour: str) -> None:
    """Write a mark's words: right of it, or left of it in the right part of the chart, where they would leave the
    figure."""
    across, _ = axes.transAxes.inverted().transform(axes.transData.transform((point.x, point.y)))
    side, shift = ("left", 4) if across < LABELS_TURN else ("right", -4)
    axes.annotate(
        _plain(point.label, WIDE),
        (point.x, point.y),
        xytext=(shift, 4),
        textcoords="offset points",
        horizontalalignment=side,
        fontsize=WIDE.small,
        color=colour,
    )


def _has_place(point: Point, log: Logarithmic) -> bool:
    if not np.isfinite((point.x, point.y)).all():
        return False
    return ("x" not in log or point.x > 0) and ("y" not in log or point.y > 0)


# ---------------------------------------------------------------- scores


def accuracy_charts(rows: Sequence[LeaderboardRow]) -> dict[str, Chart]:
    """Return a chart by score for each that a method has whose training time is known."""
    constant = next((row for row in rows if row.trivial_baseline and row.name.endswith("constant")), None)
    charts = {}
    for key in ACCURACY:
        methods = [row for row in rows if not row.trivial_baseline and getattr(row, key) is not None]
        points = [(row.name, row.train_s, getattr(row, key)) for row in methods if row.train_s]
        if points:
            charts[key] = accuracy_chart(key, points, None if constant is None else getattr(constant, key))
    return charts


def accuracy_chart(key: str, points: Sequence[tuple[str, float, float]], constant: float | None = None) -> Chart:
    """Make a chart of a score against seconds to train (logarithmic), with the front that no other beats in both.

    Args:
        key: of `COLUMNS`.
        points: each method's name, seconds to train and score.
        constant: the score of one constant vector, a trivial baseline; None where it has none.
    """
    column = COLUMNS[key]
    title = f"{column.heading} ({'lower' if column.better == LOWER else 'higher'} is better)"
    front = pareto([(seconds, score) for _, seconds, score in points], column.better)
    names = [_plain(name, COLUMN) for name, _, _ in points]
    lines = ["no method is better and faster", *([] if constant is None else ["one constant vector"])]

    def fill(axes: Axes) -> None:
        x, y = zip(*(points[i][1:] for i in front), strict=True)
        axes.step(x, y, where="post", color=FRONT, linewidth=1, label=lines[0])
        for number, (shown, (name, seconds, score)) in enumerate(zip(names, points, strict=True)):
            style: dict[str, Any] = {"color": COLOURS[number % len(COLOURS)], "marker": MARKS[number % len(MARKS)]}
            tip: dict[str, Any] = _tip(name, f"{column.heading} {score:{column.format}}", f"{seconds:.4g} s")
            axes.plot([seconds], [score], linestyle="none", markersize=4.5, label=shown, **style, **tip)
        if constant is not None:
            tip = _tip(lines[1], f"{constant:{column.format}}")
            axes.axhline(constant, color=SOFT, linestyle=":", linewidth=0.9, label=lines[1], **tip)
        axes.set_xscale("log")
        times_s = [seconds for _, seconds, _ in points]
        low, high = 0.7 * min(times_s), 1.4 * max(times_s)
        axes.set_xlim(low, high)
        _number_decades(axes.xaxis, low, high)

    return _chart(title, "seconds to train", column.heading, [*names, *lines], COLUMN, fill)


def frame_chart(scores: Scores) -> Chart | None:
    """Make a chart of the L2 of each frame over time, with what standing still and one constant vector score.

    Returns None below two scored frames; frames without a score leave a gap.
    """
    frames = scores.dve.frames if scores.dve else ()
    known = [frame.l2 for frame in frames if frame.l2 is not None]
    if len(known) < 2:
        return None
    times_ms = [1000 * (frame.time_s - frames[0].time_s) for frame in frames]
    values = [float("nan") if frame.l2 is None else frame.l2 for frame in frames]
    trivial_baseline = scores.trivial_baselines.get("constant")
    levels = {"standing still": (1.0, ":")}
    if trivial_baseline is not None and trivial_baseline.l2 is not None:
        levels["one constant vector"] = (trivial_baseline.l2, "--")

    def fill(axes: Axes) -> None:
        axes.plot(times_ms, values, color=COLOURS[0], linewidth=1.2, label="this result")
        for time_ms, value in zip(times_ms, values, strict=True):
            if len(frames) <= TIPPED and np.isfinite(value):
                tip = _tip(f"{time_ms:.4g} ms", f"L2 {value:.3f}")
                axes.plot([time_ms], [value], color=COLOURS[0], marker="o", markersize=2, linestyle="none", **tip)
        for name, (level, dashes) in levels.items():
            tip = _tip(name, f"L2 {level:.3f}")
            axes.axhline(level, color=SOFT, linestyle=dashes, linewidth=0.9, label=name, **tip)
        axes.set_ylim(0, 1.1 * max(1.0, *known))

    title = "DVE L2 of each frame (lower is better)"
    return _chart(title, "time (ms)", "DVE L2", ["this result", *levels], COLUMN, fill)


def around_chart(scores: Scores) -> Chart | None:
    """Make a chart of the flame's PSNR by the angle from the nearest given camera; None without such views."""
    known = [(view, view.psnr_flame) for view in scores.around if view.psnr_flame is not None]
    if not known:
        return None
    angles = sorted({round(view.angle_deg) for view, _ in known})
    means = [fmean(psnr for view, psnr in known if round(view.angle_deg) == angle) for angle in angles]
    lines = ["mean", "a camera"]

    def fill(axes: Axes) -> None:
        axes.plot(angles, means, color=COLOURS[0], linewidth=1.4, label=lines[0])
        for k, (view, psnr) in enumerate(known):
            tip = _tip(view.camera, f"{view.angle_deg:.0f} degrees", f"{psnr:.2f} dB")
            label = lines[1] if k == 0 else None
            axes.plot([view.angle_deg], [psnr], "o", color=COLOURS[0], markersize=3.5, label=label, **tip)

    title = "Flame PSNR (higher is better)"
    return _chart(title, "angle from the nearest given camera (degrees)", "PSNR flame (dB)", lines, COLUMN, fill)


# ---------------------------------------------------------------- streams


def stream_chart(title: str, density: np.ndarray, velocity: np.ndarray, cell_m: float) -> Chart:
    """Make a plot of streamlines, brighter where there is more, none where there is hardly anything or nothing moves.

    Args:
        density: (A, B) along the first axis, to the right, and the second, upwards; any unit.
        velocity: (A, B, 2) m/s.
        cell_m: edge of a cell, m; a bar says how long a round number of metres is.
    """
    across, up = density.shape
    height = 3.1
    width = max(height * across / up, 0.9)

    def draw(figure: Figure) -> None:
        from matplotlib.colors import Normalize

        axes = figure.add_axes((0, 0, 1, 1), facecolor=GROUND, xlim=(0, across), ylim=(0, up), aspect="equal")
        figure.patch.set(visible=True, facecolor=GROUND)
        axes.set(xticks=[], yticks=[])
        axes.spines[:].set_visible(False)
        axes.set_rasterization_zorder(3)
        drawn = (density > FAINT * density.max()) & (np.linalg.norm(velocity, axis=-1) > 1e-6)
        if drawn.any():
            x, y = np.arange(across) + 0.5, np.arange(up) + 0.5
            shade = 0.15 + 0.85 * np.sqrt(np.clip(density / density.max(), 0, 1))
            flow = np.where(drawn[..., None], velocity, np.nan)
            lines = (across / (30 * STREAM_CELLS), up / (30 * STREAM_CELLS))  # matplotlib's 1 is thirty
            colours: dict[str, Any] = {"color": shade.T, "cmap": "inferno", "norm": Normalize(0, 1)}
            strokes: dict[str, Any] = {"linewidth": 1.0, "arrowsize": 0.7, "minlength": 0.06, "zorder": 2}
            axes.streamplot(x, y, flow[..., 0].T, flow[..., 1].T, density=lines, **colours, **strokes)
        bar_m = _round_below(0.5 * across * cell_m)
        white: dict[str, Any] = {"color": "#ebebeb", "zorder": 4}
        axes.plot([1.5, 1.5 + bar_m / cell_m], [1.5, 1.5], linewidth=1.2, solid_capstyle="butt", **white)
        axes.text(1.5, 2.2, f"{bar_m:g} m", fontsize=SMALL, **white)

    return Chart(title, (width, height), draw)


def _round_below(value: float) -> float:
    """Return 1, 2 or 5 times a power of ten, the largest not above a value > 0."""
    unit = 10.0 ** np.floor(np.log10(value))
    return float(max(step * unit for step in STEPS if step * unit <= value * (1 + 1e-9)))


# ---------------------------------------------------------------- frame times of a camera


def frame_times_chart(name: str, times: CameraTimes, slot: np.ndarray | None, period_us: float) -> Chart:
    """Make a chart of one camera's times: measured minus fused time of each frame, and the curves they were read from.

    Frames that were left out are hollow, at the border where they lie beyond it. Below are every strip's learned
    brightness over the board's period and its nominal slot.

    Args:
        slot: (S,) of the strips; None of a ring, whose one curve is its LEDs' brightness around the exposure's middle.
    """
    residual = times.measured_us - times.time_us
    limit = max(10.0, np.ceil(times.max_us / 5) * 5 + 5)
    title = (
        f"{name}: rms {times.rms_us:.2f} us, {times.interval_us:.3f} us per frame; "
        f"rows {times.row_time_us:.3f} us per pixel, {times.readout}"
    )

    def draw(figure: Figure) -> None:
        above = figure.add_axes((0.09, 0.56, 0.88, 0.36))
        frame, shown = np.arange(len(residual)), np.clip(residual, -limit, limit)
        for used, face in ((True, COLOURS[1]), (False, "none")):
            these = times.used == used
            edge = COLOURS[1] if used else COLOURS[0]
            dots: dict[str, Any] = {"linestyle": "none", "marker": "o", "markersize": 2.5, "markerfacecolor": face}
            above.plot(frame[these], shown[these], markeredgecolor=edge, clip_on=False, **dots)
        for level in (-times.rms_us, times.rms_us):
            above.axhline(level, color=SOFT, linestyle=":", linewidth=0.9)
        above.set_ylim(-limit, limit)
        above.set_title(title, fontsize=LETTERS, loc="left", parse_math=False)
        above.set_xlabel("frame")
        above.set_ylabel("measured - fused time (us)")
        below = figure.add_axes((0.09, 0.1, 0.88, 0.34))
        bins = times.curve.shape[1]
        time_ms = period_us / 1000 * np.arange(bins) / bins
        for k in np.argsort(slot) if slot is not None else [0]:
            s = 0 if slot is None else int(slot[k])
            colour = COLOURS[s % len(COLOURS)]
            below.plot(time_ms, np.clip(times.curve[k], -0.1, 1.1), color=colour, linewidth=1.1)
            if slot is not None:
                begin, end = (period_us / 1000 * part / len(slot) for part in (s, s + 1))
                below.plot([begin, end], [-0.16, -0.16], color=colour, linewidth=3, solid_capstyle="butt")
                below.text((begin + end) / 2, -0.12, f"slot {s}", fontsize=SMALL, ha="center", color=colour)
        for number, fault in enumerate(times.faults):
            where: dict[str, Any] = {
                "transform": below.transAxes,
                "fontsize": SMALL,
                "color": COLOURS[0],
                "parse_math": False,
            }
            below.text(0.01, 0.95 - 0.08 * number, f"fault: {fault}", va="top", **where)
        ring = "LEDs' brightness over a round (exposure in the middle)"
        strips = "strips' brightness over the board's period (bars: nominal slots)"
        below.set_xlabel(f"{ring if slot is None else strips}, ms")
        below.set_ylim(-0.2, 1.15)
        for axes in (above, below):
            _dress(axes, SMALL)

    return Chart(f"{name}: how far each frame's own measurement lies from its steady clock", (7.0, 4.2), draw)
