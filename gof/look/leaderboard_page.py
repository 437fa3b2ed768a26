"""The leaderboard as one self-contained HTML page: the table, stream plots of velocity, accuracy against time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from gof.core.errors import GofError
from gof.dataset import Dataset
from gof.evaluate.leaderboard import COLUMNS, EvaluatedResult, Row, best_rows, used_columns
from gof.evaluate.sparse_grid import StoredField
from gof.look.charts import accuracy_charts
from gof.look.comparison import read_again
from gof.look.pages import PageGrid, template
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


def to_html(rows: Sequence[Row], streams: Sequence[StreamPlots], title: str, grid: PageGrid | None = None) -> str:
    """The page; everything is inside it."""
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
