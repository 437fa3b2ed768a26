"""The leaderboard as one self-contained HTML page: the table, stream plots of velocity, accuracy against time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from gof.core.errors import DataFormatError, GofError
from gof.core.gaussians import MovingGaussians
from gof.dataset import Dataset
from gof.evaluate.leaderboard import COLUMNS, EvaluatedResult, Row, best_rows, used_columns
from gof.evaluate.sparse_grid import StoredField
from gof.io.importers import ImportOptions, read_result
from gof.look.charts import accuracy_charts
from gof.look.streams import KINDS, stream_charts


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
        charts=[chart.svg() for chart in accuracy_charts(rows).values()],
    )
