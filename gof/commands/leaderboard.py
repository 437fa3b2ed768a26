"""`gof leaderboard`: evaluated results side by side, as JSON, CSV, Markdown and one self-contained HTML page."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import tyro
from rich.box import SIMPLE_HEAD
from rich.table import Table

from gof.commands.everywhere import require_free, require_writable, write_figures
from gof.commands.read import Seconds, read_options
from gof.core.files import atomic_path
from gof.core.records import write_record
from gof.dataset import Dataset
from gof.evaluate.leaderboard import (
    COLUMNS,
    Leaderboard,
    LeaderboardRow,
    collect,
    rows_of,
    to_csv,
    to_markdown,
    used_columns,
)
from gof.host.options import require_number
from gof.host.terminal import console
from gof.look.boards import leaderboard_html, stream_plots
from gof.look.charts import accuracy_charts
from gof.look.comparison import Moment
from gof.look.drawing import Kind, require_figure
from gof.look.pages import side_by_side

SHOWN = (
    "flow_prior",
    "eve_l2",
    "eve_cos",
    "l2",
    "cos_sim",
    "epe_px",
    "psnr_flame",
    "ssim_flame",
    "train_s",
)  # columns for the terminal


@dataclass
class LeaderboardConfig:
    """Evaluated results side by side: table, pictures with errors, stream plots of velocity, accuracy against time.

    Examples:
      gof leaderboard boards/ours boards/theirs --dataset data/fire
    """

    FIGURES: ClassVar = (Leaderboard,)

    folders: tyro.conf.Positional[Annotated[list[Path], tyro.conf.arg(metavar="FOLDER ...")]]
    """Folders with scores.json of gof evaluate; also method.json ("name", "train_seconds") and costs.json, if there."""
    dataset: Path | None = None
    """Dataset folder: adds the results' pictures side by side, and stream plots of the ground truth beside each
    method."""
    out: Path | None = None
    """Folder for leaderboard.json, .csv, .md and .html. Default: "leaderboard" beside the first folder, where older
    ones are replaced."""
    title: str = "Leaderboard"
    """Heading of the page."""
    time: Seconds | None = None
    """Time of pictures and stream plots; default: the held-out frame with most flame, and the middle frame."""
    figure: tuple[Kind, ...] = ()
    """Also write the charts of accuracy against time for print: OUT/accuracy_l2.pdf and so on."""


def main(argv: list[str]) -> int:
    """Run `gof leaderboard`."""
    config = read_options(LeaderboardConfig, "leaderboard", argv)
    require_number("--time", config.time)
    results = collect(config.folders)
    if config.out is not None:
        require_free(config.out / "leaderboard.json")
    folder = config.out or require_writable(results[0].folder.absolute().parent) / "leaderboard"
    dataset = Dataset.open(config.dataset) if config.dataset else None
    rows = rows_of(results, None if dataset is None else dataset.scored_as())
    streams = stream_plots(results, dataset, config.time) if dataset else []
    charts = [
        (chart, folder / f"accuracy_{key}.{kind}")
        for key, chart in accuracy_charts(rows).items()
        for kind in config.figure
    ]
    require_figure(*(path for _, path in charts))
    write_record(folder / "leaderboard.json", Leaderboard(tuple(rows)))
    write_figures(Leaderboard(tuple(rows)))
    middle = Moment.near(dataset, len(dataset.cameras) // 2, config.time) if dataset else None
    grid = side_by_side(results, middle) if middle else None
    page = leaderboard_html(rows, streams, config.title, grid)
    pages = {"csv": to_csv(rows), "md": to_markdown(rows), "html": page}
    for suffix, text in pages.items():
        with atomic_path(folder / f"leaderboard.{suffix}") as temporary:
            temporary.write_text(text, encoding="utf-8")
    for chart, path in charts:
        chart.write(path)
    out = console()
    out.print(_table(config.title, rows))
    for result in results:
        if result.scores.images is not None and not result.scores.images.count:
            note = f"note: no scores of pictures of {result.name}: its dataset holds no frame out"
            out.print(note, style="yellow")
    for row in rows:
        if row.other_footage and row.notes:
            out.print(f"note: {row.name}: {row.notes[0]}", style="yellow")
    for stream in streams:
        if stream.reason:
            note = f"note: no stream plot of {stream.name}: {stream.reason}"
            out.print(note, style="yellow")
    out.print(f"written to {folder}/leaderboard.html, .json, .csv, .md")
    if charts:
        out.print(f"for print: {', '.join(path.name for _, path in charts)}")
    return 0


def _table(title: str, rows: list[LeaderboardRow]) -> Table:
    """In a narrow window names are folded; numbers and words of headings stay whole."""
    table = Table(title=title, title_justify="left", box=SIMPLE_HEAD, padding=0)
    shown = [key for key in used_columns(rows) if key in SHOWN]
    table.add_column("method", overflow="fold")
    for key in shown:
        table.add_column(COLUMNS[key].heading.replace(" ", "\n"), justify="right", no_wrap=True)
    for row in rows:
        table.add_row(row.name, *(row.text(key) for key in shown), style=None if row.competes else "dim")
    return table
