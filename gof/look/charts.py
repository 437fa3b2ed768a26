"""All charts: each shows one thing, drawn as `gof.look.drawing` draws."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import fmean
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from gof.evaluate.leaderboard import COLUMNS, LOWER, LeaderboardRow, pareto
from gof.look.drawing import (
    COLOURS,
    COLUMN,
    LETTERS,
    SMALL,
    SOFT,
    STEPS,
    WIDE,
    Chart,
    dress,
    find_limits,
    fit_name,
    lay_out,
    number_decades,
    tip_of,
    unit_range,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from gof.capture.decode import CameraTimes
    from gof.evaluate.scores import Scores

Logarithmic = Literal["xy", "x", "y", ""]

FRONT = "#e8772e"
DASHES, MARKS = ("-", "--", ":"), "os^DvPX*"  # the second round of the colours is dashed
MARKED = 25  # a line of more points has no marks
TIPPED = 400  # a line of more points says no numbers
LABELS_TURN = 0.85  # of the width: labels further right stand left of their marks
ACCURACY = ("l2", "cos_sim", "psnr_flame", "ssim_flame")  # scores that are drawn against the time they took
FAINT = 0.02  # of the largest density: below, no stream is drawn
STREAM_CELLS = 1.2  # between two streamlines
GROUND = "#121214"  # of stream plots: fire is light


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
    names = {name: fit_name(name, WIDE) for name in placed}

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
                **tip_of(name),
            )
            for x, y, _, spread in points:
                if spread:
                    axes.plot([x, x], [y - spread, y + spread], color=colour, linewidth=1.0)
        for which, axis in (("x", axes.xaxis), ("y", axes.yaxis)):
            values: list[float] = [getattr(point, which) for points in placed.values() for point in points]
            if values and which in log:
                getattr(axes, f"set_{which}scale")("log")
                low, high = find_limits(values)
                getattr(axes, f"set_{which}lim")(low, high)
                number_decades(axis, low, high)
        for number, points in enumerate(placed.values()):
            for point in (point for point in points if point.label):
                _write_beside(axes, point, COLOURS[number % len(COLOURS)])

    return lay_out(title, x_label, y_label, list(names.values()), WIDE, fill)


def _write_beside(axes: Axes, point: Point, colour: str) -> None:
    """Write a mark's words: right of it, or left of it in the right part of the chart, where they would leave the
    figure."""
    across, _ = axes.transAxes.inverted().transform(axes.transData.transform((point.x, point.y)))
    side, shift = ("left", 4) if across < LABELS_TURN else ("right", -4)
    axes.annotate(
        fit_name(point.label, WIDE),
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
    names = [fit_name(name, COLUMN) for name, _, _ in points]
    lines = ["no method is better and faster", *([] if constant is None else ["one constant vector"])]

    def fill(axes: Axes) -> None:
        x, y = zip(*(points[i][1:] for i in front), strict=True)
        axes.step(x, y, where="post", color=FRONT, linewidth=1, label=lines[0])
        for number, (shown, (name, seconds, score)) in enumerate(zip(names, points, strict=True)):
            style: dict[str, Any] = {"color": COLOURS[number % len(COLOURS)], "marker": MARKS[number % len(MARKS)]}
            tip: dict[str, Any] = tip_of(name, f"{column.heading} {score:{column.format}}", f"{seconds:.4g} s")
            axes.plot([seconds], [score], linestyle="none", markersize=4.5, label=shown, **style, **tip)
        if constant is not None:
            tip = tip_of(lines[1], f"{constant:{column.format}}")
            axes.axhline(constant, color=SOFT, linestyle=":", linewidth=0.9, label=lines[1], **tip)
        axes.set_xscale("log")
        times_s = [seconds for _, seconds, _ in points]
        low, high = 0.7 * min(times_s), 1.4 * max(times_s)
        axes.set_xlim(low, high)
        number_decades(axes.xaxis, low, high)

    return lay_out(title, "seconds to train", column.heading, [*names, *lines], COLUMN, fill)


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
                tip = tip_of(f"{time_ms:.4g} ms", f"L2 {value:.3f}")
                axes.plot([time_ms], [value], color=COLOURS[0], marker="o", markersize=2, linestyle="none", **tip)
        for name, (level, dashes) in levels.items():
            tip = tip_of(name, f"L2 {level:.3f}")
            axes.axhline(level, color=SOFT, linestyle=dashes, linewidth=0.9, label=name, **tip)
        axes.set_ylim(0, 1.1 * max(1.0, *known))

    title = "DVE L2 of each frame (lower is better)"
    return lay_out(title, "time (ms)", "DVE L2", ["this result", *levels], COLUMN, fill)


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
            tip = tip_of(view.camera, f"{view.angle_deg:.0f} degrees", f"{psnr:.2f} dB")
            label = lines[1] if k == 0 else None
            axes.plot([view.angle_deg], [psnr], "o", color=COLOURS[0], markersize=3.5, label=label, **tip)

    title = "Flame PSNR (higher is better)"
    return lay_out(title, "angle from the nearest given camera (degrees)", "PSNR flame (dB)", lines, COLUMN, fill)


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
            colours: dict[str, Any] = {"color": shade.T, "cmap": "inferno", "norm": unit_range()}
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
            dress(axes, SMALL)

    return Chart(f"{name}: how far each frame's own measurement lies from its steady clock", (7.0, 4.2), draw)
