"""Boards for people: a suite's as one self-contained HTML page and a Markdown table, and the leaderboard's page."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, TypeVar

import numpy as np

from gof.core.errors import GofError
from gof.core.gaussians import TransientGaussians
from gof.dataset import Dataset
from gof.evaluate.intervals import weighted_quantile
from gof.evaluate.leaderboard import COLUMNS, EvaluatedResult, LeaderboardRow, best_rows, in_markdown, used_columns
from gof.evaluate.sparse_grid import StoredField
from gof.evaluate.suite_board import RANKED, BoardRow, BoardScene, Figure, SuiteBoard
from gof.evaluate.training_curve import TrainingCurve
from gof.look.charts import FAINT, accuracy_charts, line_chart, stream_chart
from gof.look.comparison import read_again
from gof.look.drawing import Chart
from gof.look.pages import PageGrid, template

K = TypeVar("K", int, str)  # what names a row


def used(rows: tuple[BoardRow, ...]) -> list[str]:
    """Return the columns in which any row has a value: those with ranks first."""
    filled = [key for key in COLUMNS if any(key in row.figures for row in rows)]
    return [key for key in RANKED if key in filled] + [key for key in filled if key not in RANKED]


def best(figures: Mapping[K, Figure], key: str) -> K | None:
    """Return which of a column's competing figures has the best mean; None where none is better, or there is one
    alone."""
    sign = COLUMNS[key].better
    if not sign or len(figures) < 2:
        return None
    return max(figures, key=lambda i: sign * figures[i].mean)


def marks_of(figures: Mapping[K, Figure], key: str) -> dict[K, str]:
    """Return a column's marks: "best" is the best mean, "first" are the others that may be first as well."""
    leader = best(figures, key)
    may_be = {i: "first" for i, figure in figures.items() if figure.rank == 1}
    return may_be if leader is None else may_be | {leader: "best"}


def competing(rows: tuple[BoardRow, ...], key: str) -> dict[int, Figure]:
    """Return the column's figures of the rows that compete, by the row's number."""
    return {i: row.figures[key] for i, row in enumerate(rows) if row.competes and key in row.figures}


def value(key: str, figure: Figure | None) -> str:
    """Return a mean, ± half of its interval."""
    if figure is None:
        return "-"
    kind = COLUMNS[key].format
    number = format(round(figure.mean) if kind == "d" else figure.mean, kind)
    return number if figure.half_width is None else f"{number} ± {format(figure.half_width, kind)}"


def remark(figure: Figure | None, scenes: int) -> str:
    """Rank, wins and the spread of seeds, where there are any."""
    if figure is None:
        return ""
    parts = []
    if figure.rank:
        parts = [f"rank {figure.rank}" + (f" to {figure.last_rank}" if figure.last_rank != figure.rank else "")]
    parts += [f"{figure.wins} of {scenes} wins"] if figure.wins is not None and scenes > 1 else []
    parts += [f"seeds ± {_two_digits(figure.seed_sd)}"] if figure.seed_sd is not None else []
    return ", ".join(parts)


def _two_digits(number: float) -> str:
    """Return two significant digits without an exponent, as the means above it have none."""
    return np.format_float_positional(number, precision=2, fractional=False, trim="-")


def partly(row: BoardRow, board: SuiteBoard) -> str:
    """Say that its means are of fewer scenes than the others'; "" where they are not."""
    return f"in {row.scenes} of {len(board.scenes)} scenes" if row.scenes < len(board.scenes) else ""


def refusal(row: BoardRow) -> str:
    """Say that the check refuses the submission, and why; "" where it does not."""
    more = f" and {len(row.refused) - 1} more" if len(row.refused) > 1 else ""
    return f"refused by the check, not ranked: {row.refused[0]}{more}" if row.refused else ""


def marks(row: BoardRow) -> tuple[str, str]:
    """Return the input of a method beside pictures, and its prior knowledge; empty for trivial baselines, no
    methods."""
    if row.trivial_baseline:
        return "", ""
    knew = "not stated" if row.prior is None else ", ".join(row.prior) or "nothing"
    return ", ".join(row.given) or "not stated", knew


def suite_markdown(board: SuiteBoard) -> str:
    """Return the best mean of a column in bold; rows that do not compete in italics."""
    keys = used(board.rows)
    leaders = {key: best(competing(board.rows, key), key) for key in keys}
    headings = ["method", "given", "knew before", *(COLUMNS[key].heading for key in keys)]
    lines = [f"| {' | '.join(headings)} |", "|---|---|---|" + "---:|" * len(keys)]
    for i, row in enumerate(board.rows):
        name = in_markdown(row.name)
        given, knew = map(in_markdown, marks(row))
        cells = []
        for key in keys:
            figure = row.figures.get(key)
            text = " ".join(filter(None, (value(key, figure), _in_brackets(remark(figure, len(board.scenes))))))
            cells.append(f"**{text}**" if i == leaders[key] else text)
        remarks = [
            _in_brackets(text) for text in (in_markdown(refusal(row)), in_markdown(row.alarm), partly(row, board))
        ]
        name = " ".join(filter(None, (name if row.competes else f"*{name}*", *remarks)))
        lines.append(f"| {name} | {given} | {knew} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def _in_brackets(text: str) -> str:
    return f"({text})" if text else ""


def suite_html(board: SuiteBoard, grids: Mapping[str, PageGrid | None]) -> str:
    """Return the page; everything is inside it.

    Args:
        grids: the methods' pictures side by side, by the scene's name.
    """
    keys = used(board.rows)
    marked = {key: marks_of(competing(board.rows, key), key) for key in keys}
    table = []
    for i, row in enumerate(board.rows):
        cells = [
            {
                "text": value(key, row.figures.get(key)),
                "small": remark(row.figures.get(key), len(board.scenes)),
                "value": row.figures[key].mean if key in row.figures else None,
                "mark": marked[key].get(i, ""),
            }
            for key in keys
        ]
        given, knew = marks(row)
        small = (
            refusal(row),
            row.alarm,
            partly(row, board),
            given and f"given: {given}",
            knew and f"knew before: {knew}",
        )
        about = {"name": row.name, "method": row.what, "competes": row.competes}
        table.append((about | {"small": [one for one in small if one]}, cells))
    return template("suite.html").render(
        title=board.title,
        board=board,
        methods=[row for row in board.rows if not row.trivial_baseline],
        ranked=any(row.competes for row in board.rows),
        headings=[{"text": COLUMNS[key].heading, "better": COLUMNS[key].better} for key in keys],
        table=table,
        scenes=[_scene(scene, grids.get(scene.name)) for scene in board.scenes],
    )


def _scene(scene: BoardScene, grid: PageGrid | None) -> dict:
    """Return all that the page shows of a scene."""
    keys = [key for key in RANKED if any(key in figures for figures in scene.figures.values())]
    finished = {name: figures for name, figures in scene.figures.items() if any(one.rank for one in figures.values())}
    marked = {key: marks_of({name: has[key] for name, has in finished.items() if key in has}, key) for key in keys}
    rows = [
        (
            name,
            name in scene.trivial_baselines,
            [
                {
                    "text": value(key, figures.get(key)),
                    "small": remark(figures.get(key), 1),
                    "mark": marked[key].get(name, ""),
                }
                for key in keys
            ],
        )
        for name, figures in (scene.figures | scene.trivial_baselines).items()
    ]
    return {
        "name": scene.name,
        "split": scene.split,
        "eddy_time_s": scene.eddy_time_s,
        "at_least": scene.at_least,
        "eddies": scene.eddies,
        "trivial_baselines_on": scene.trivial_baselines_on,
        "headings": [COLUMNS[key].heading for key in keys],
        "rows": rows,
        "grid": grid,
        "curves": [_curve(name, curve) for name, curve in scene.curves.items()],
        "chart": _loss_chart(scene.curves) if scene.curves else "",
    }


def _curve(name: str, curve: TrainingCurve) -> dict:
    """Return a row of the table of trainings."""
    return {
        "name": name,
        "steps": curve.step[-1],
        "seconds": curve.cpu_seconds[-1],
        "first": curve.loss[0],
        "last": curve.loss[-1],
        "fall": "not known" if math.isnan(curve.last_fall) else f"{100 * curve.last_fall:.0f} %",
    }


def _loss_chart(curves: Mapping[str, TrainingCurve]) -> str:
    """Return SVG of the losses over CPU seconds, each method's over its own first value."""
    lines = {}
    for name, curve in curves.items():
        places = zip(curve.cpu_seconds, curve.loss, strict=True)
        lines[name] = [(seconds, loss / curve.loss[0], "") for seconds, loss in places]
    return line_chart("Training loss", "CPU seconds", "loss / its first value", lines).svg()


# ----------------------------------------------------------------
# The leaderboard as one self-contained HTML page: the table, stream plots of velocity, accuracy against time.


@dataclass(frozen=True)
class StreamPlots:
    """Stream plots of a result as SVG by what they show (`streams.KINDS`), or the `reason` why there are none."""

    name: str
    time_s: float
    images: dict[str, str] = field(default_factory=dict)
    reason: str = ""


def stream_plots(
    results: Sequence[EvaluatedResult], dataset: Dataset, time_s: float | None = None
) -> list[StreamPlots]:
    """Stream plots of every result that can be read again, beside the truth; by default at the middle frame."""
    time_s = float(dataset.times_s[len(dataset.times_s) // 2]) if time_s is None else time_s
    truth = StoredField(dataset.velocity, time_s) if dataset.has_velocity else None
    out = []
    for result in results:
        try:
            state = read_again(result).measured_from(dataset.datum).state_at(time_s)
            if not (state.dynamic & (state.at(time_s)[1] > 0)).any():
                raise GofError(f"no dynamic Gaussian lives at {time_s:g} s")
            charts = stream_charts(result.name, state, time_s, truth)
            images = {label: charts[kind].svg() for kind, label in KINDS.items() if kind in charts}
            out.append(StreamPlots(result.name, time_s, images))
        except GofError as e:
            out.append(StreamPlots(result.name, time_s, reason=str(e)))
    return out


def leaderboard_html(
    rows: Sequence[LeaderboardRow], streams: Sequence[StreamPlots], title: str, grid: PageGrid | None = None
) -> str:
    """Return the page; everything is inside it."""
    keys, best = used_columns(rows), best_rows(rows)
    cells = [
        [
            {"text": row.text(key), "value": getattr(row, key), "mark": "best" if best.get(key) == i else ""}
            for key in keys
        ]
        for i, row in enumerate(rows)
    ]
    return template("leaderboard.html").render(
        title=title,
        headings=[{"text": COLUMNS[key].heading, "better": COLUMNS[key].better} for key in keys],
        table=list(zip(rows, cells, strict=True)),
        rows_of_others=any(row.other_footage for row in rows),
        streams=streams,
        grid=grid,
        charts=[chart.svg() for chart in accuracy_charts(rows).values()],
    )


# ----------------------------------------------------------------
# Stream plots of velocity: Gaussians max-projected along the depth and cut at one X, and the truth at these places.

CELLS = 72  # along the longest side of the box
FLOATERS = 0.002  # share of the weight that may lie outside the box at each end of an axis
KINDS = {
    "projection": "front view",
    "truth_projection": "front view, truth",
    "slice": "X-slice",
    "truth_slice": "X-slice, truth",
}  # in the order in which a page shows them


class Volume(NamedTuple):
    density: np.ndarray  # (X, Y, Z) summed s_x s_y s_z alpha per cell, any unit
    velocity: np.ndarray  # (X, Y, Z, 3) m/s, weighted mean
    low: np.ndarray  # (3,) m
    cell: float  # m

    def centres(self) -> np.ndarray:
        index = np.stack(np.meshgrid(*(np.arange(n) + 0.5 for n in self.density.shape), indexing="ij"), -1)
        return self.low + index * self.cell


def volume(gaussians: TransientGaussians, time_s: float) -> Volume:
    """Return the dynamic Gaussians that live at a time, summed into cubic cells and blurred by one cell; at least one
    must."""
    from scipy.ndimage import gaussian_filter  # here: it takes long to load

    position, opacity = gaussians.at(time_s)
    weight = gaussians.scale.astype(np.float64).prod(1) * opacity * gaussians.dynamic
    keep = weight > 1e-9 * max(weight.sum(), 1e-300)
    weight = weight[keep]
    position = position[keep].astype(np.float64)
    velocity = gaussians.moving_gas[keep].astype(np.float64)
    # of each axis the middle 99.6 % of the weight: a few floaters must not shrink the flame
    low, high = (np.array([weighted_quantile(x, weight, q) for x in position.T]) for q in (FLOATERS, 1 - FLOATERS))
    cell = float(max((high - low).max(), 1e-3) / (CELLS - 8))
    low = low - 4 * cell
    shape = np.maximum(np.ceil((high - low) / cell).astype(int) + 4, 9)
    index = np.floor((position - low) / cell).astype(int)
    inside = ((index >= 0) & (index < shape)).all(1)
    flat = np.ravel_multi_index(tuple(index[inside].T), shape)
    sums = [np.bincount(flat, weight[inside] * c, int(shape.prod())).reshape(shape) for c in (1.0, *velocity[inside].T)]
    density, *momentum = (gaussian_filter(s, 1.0, mode="constant") for s in sums)
    filled = density > 1e-6 * density.max()
    mean = [np.where(filled, m / np.where(filled, density, 1), 0) for m in momentum]
    return Volume(density, np.stack(mean, -1), low, cell)


def max_projection(density: np.ndarray, velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the view along Y: density (X, Z) of the densest cell of each column, and its (v_x, v_z) (X, Z, 2)."""
    j = density.argmax(1)[:, None, :]
    picked = np.take_along_axis(velocity, j[..., None], 1)[:, 0]
    return np.take_along_axis(density, j, 1)[:, 0], picked[..., [0, 2]]


def x_slice(density: np.ndarray, velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """Return the plane of constant X through the centre of mass: density (Y, Z), (v_y, v_z) (Y, Z, 2), and its cell
    number."""
    i = round(float((density.sum((1, 2)) * np.arange(len(density))).sum() / density.sum()))
    return density[i], velocity[i][..., 1:], i


def cropped(density: np.ndarray, velocity: np.ndarray, margin: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Return a plane's density (A, B) and velocity (A, B, 2) without the cells around it where nothing would be
    drawn."""
    seen = density > FAINT * density.max()
    box = tuple(slice(max(int(k.min()) - margin, 0), int(k.max()) + margin + 1) for k in np.nonzero(seen))
    return density[box], velocity[box]


def stream_charts(name: str, gaussians: TransientGaussians, time_s: float, truth=None) -> dict[str, Chart]:
    """Return charts by kind: "projection", "slice"; with a true field (anything with `sample`) also "truth_" of these.

    Args:
        name: of the result, for the charts' titles.
    """
    v = volume(gaussians, time_s)
    seen = {"": v.velocity}
    if truth is not None:
        seen["truth_"] = truth.sample(v.centres().reshape(-1, 3)).reshape(v.velocity.shape)
    cuts = {"projection": max_projection, "slice": lambda density, velocity: x_slice(density, velocity)[:2]}
    charts = {}
    for plane, cut in cuts.items():
        for whose, velocity in seen.items():
            kind = whose + plane
            charts[kind] = stream_chart(f"{KINDS[kind]} of {name}", *cropped(*cut(v.density, velocity)), v.cell)
    return charts
