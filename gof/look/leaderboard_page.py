"""The leaderboard as one self-contained HTML page: the table, stream plots of velocity, accuracy against time."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from PIL import Image

from gof.core.errors import DataFormatError, GofError, MissingDependencyError
from gof.core.gaussians import MovingGaussians
from gof.dataset import Dataset
from gof.evaluate.leaderboard import COLUMNS, EvaluatedResult, Row, best_rows, used_columns
from gof.evaluate.sparse_grid import StoredField
from gof.host import extras
from gof.io.importers import ImportOptions, read_result
from gof.look.accuracy_chart import AccuracyChart, accuracy_charts
from gof.look.streams import plots

COLORS = ("#1769aa", "#c2410c", "#15803d", "#7e22ce", "#be123c", "#0e7490", "#854d0e", "#4b5563")
SYMBOLS = ("circle", "square", "diamond", "triangle-up", "cross", "star", "x", "triangle-down", "hexagon")
PLOTLY = ("leaderboard", "a chart of score against time")  # the extra, and what for


@dataclass(frozen=True)
class StreamPlots:
    """Stream plots of a result as data URIs by kind (`streams.plots`), or the `reason` why there are none."""

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
            images = {kind: _uri(picture) for kind, picture in plots(state, time_s, truth).items()}
            out.append(StreamPlots(result.name, time_s, images))
        except GofError as e:
            out.append(StreamPlots(result.name, time_s, reason=str(e)))
    return out


def read_again(result: EvaluatedResult) -> MovingGaussians:
    """The Gaussians behind the scores: the file that was scored, or the one in the folder, read and moved as it was.

    Raises:
        DataFormatError: the file is gone, or damaged.
    """
    origin = result.scores.import_
    options = ImportOptions() if origin.options is None else origin.options.options()
    gaussians = read_result(scored_file(result), options).gaussians
    return gaussians if origin.alignment is None else gaussians.transformed(np.array(origin.alignment.matrix))


def scored_file(result: EvaluatedResult) -> Path:
    """The file behind the scores. Raises DataFormatError: it is gone."""
    origin = result.scores.import_
    candidates = [result.folder / "result.npz", result.folder / "reconstruct" / "result.npz"]
    if origin.path is not None:
        candidates.insert(0, Path(origin.path))
    path = next((p for p in candidates if p.exists()), None)
    if path is None:
        looked = ", ".join(map(str, candidates))
        raise DataFormatError(f"{result.folder}: the result is not there any more (looked for {looked})")
    return path


def _uri(picture: Image.Image) -> str:
    data = io.BytesIO()
    picture.save(data, "PNG", optimize=True)
    return "data:image/png;base64," + base64.b64encode(data.getvalue()).decode()


def pareto_figures(rows: Sequence[Row]) -> list[str]:
    """HTML of plotly charts: seconds to train (log) against a score, with the front that nobody beats."""
    return [_pareto_figure(chart) for chart in accuracy_charts(rows)]


def _charts(rows: Sequence[Row]) -> tuple[list[str], str]:
    """The charts, and why there are none: the tables do not need plotly."""
    try:
        return pareto_figures(rows), ""
    except MissingDependencyError as e:
        return [], str(e)


def _pareto_figure(chart: AccuracyChart) -> str:
    go = extras.load("plotly.graph_objects", *PLOTLY)
    figure = go.Figure()
    figure.add_scatter(
        x=[seconds for seconds, _ in chart.front],
        y=[score for _, score in chart.front],
        mode="lines",
        line={"color": "#e8772e", "shape": "hv"},
        name="nobody is better and faster",
        hoverinfo="skip",
    )
    for number, (name, (seconds, score)) in enumerate(zip(chart.names, chart.points, strict=True)):
        marker = {"size": 12, "color": COLORS[number % len(COLORS)], "symbol": SYMBOLS[number % len(SYMBOLS)]}
        figure.add_scatter(x=[seconds], y=[score], mode="markers", name=name, marker=marker)
    if chart.constant is not None:
        figure.add_hline(
            y=chart.constant,
            line={"dash": "dot", "color": "#777"},
            annotation_text="one constant vector",
            annotation_position="top right",
        )
    figure.update_layout(
        template="plotly_white",
        height=420,
        margin={"l": 64, "r": 24, "t": 44, "b": 50},
        legend={"orientation": "h", "y": -0.22, "font": {"size": 12}},
        title={"text": chart.title, "font": {"size": 15}},
    )
    times_s = [seconds for seconds, _ in chart.points]
    low, high = np.log10([0.7 * min(times_s), 1.4 * max(times_s)])
    ticks = [f * 10.0**k for k in range(int(np.floor(low)), int(np.ceil(high))) for f in (1, 2, 5)]
    texts = [f"{tick:g}" for tick in ticks]
    figure.update_xaxes(type="log", title="seconds to train", range=[low, high], tickvals=ticks, ticktext=texts)
    figure.update_yaxes(title=chart.heading)
    return figure.to_html(full_html=False, include_plotlyjs=False, config={"displaylogo": False, "responsive": True})


@dataclass(frozen=True)
class PagePicture:
    """A picture of a page as a data URI, with what stands above it and below."""

    uri: str
    title: str = ""
    note: str = ""


@dataclass(frozen=True)
class PageGrid:
    """Results side by side: rows of pictures, None where a place is empty; `of` which camera and frame they are."""

    rows: Sequence[Sequence[PagePicture | None]]
    of: str


def to_html(rows: Sequence[Row], streams: Sequence[StreamPlots], title: str, grid: PageGrid | None = None) -> str:
    """The page; everything is inside it."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    charts, no_charts = _charts(rows)
    keys, best = used_columns(rows), best_rows(rows)
    cells = [
        [
            {"text": row.text(key), "value": getattr(row, key), "mark": "best" if best.get(key) == i else ""}
            for key in keys
        ]
        for i, row in enumerate(rows)
    ]
    environment = Environment(loader=PackageLoader("gof.look", "."), autoescape=True, undefined=StrictUndefined)
    return environment.get_template("leaderboard.html").render(
        title=title,
        headings=[{"text": COLUMNS[key].heading, "better": COLUMNS[key].better} for key in keys],
        table=list(zip(rows, cells, strict=True)),
        rows_of_others=any(row.other_footage for row in rows),
        streams=streams,
        grid=grid,
        charts=charts,
        no_charts=no_charts,
        plotlyjs=extras.load("plotly.offline", *PLOTLY).get_plotlyjs() if charts else "",
    )
