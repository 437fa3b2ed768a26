"""`gof leaderboard`: evaluated results side by side, as JSON, CSV, Markdown and one self-contained HTML page."""

from __future__ import annotations

import base64
import csv
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from gof.dataset import Dataset
from gof.errors import DataFormatError, GofError
from gof.evaluate.dve import state_at
from gof.evaluate.sparse_grid import StoredField
from gof.io.files import atomic_path, read_json, write_json
from gof.io.importers import ImportOptions, Trajectory, read_result
from gof.io.importers.similarity import transformed

# key -> (heading, path in scores.json or in the row itself, better: -1 low, +1 high, 0 neither, format)
COLUMNS = {
    "l2": ("DVE L2", ("dve", "l2"), -1, ".3f"),
    "cos_sim": ("DVE CosSim", ("dve", "cos_sim"), 1, ".3f"),
    "fluctuation_l2": ("fluctuation L2", ("dve", "fluctuation", "l2"), -1, ".3f"),
    "fluctuation_cos": ("fluctuation CosSim", ("dve", "fluctuation", "cos_sim"), 1, ".3f"),
    "emission_l2": ("on emission L2", ("dve", "on_emission", "l2"), -1, ".3f"),
    "emission_cos": ("on emission CosSim", ("dve", "on_emission", "cos_sim"), 1, ".3f"),
    "skill": ("skill over constant", ("dve", "skill_over_constant"), 1, ".3f"),
    "speed_ratio": ("speed ratio", ("dve", "speed_ratio"), 0, ".2f"),
    "psnr_flame": ("PSNR flame (dB)", ("psnr_flame",), 1, ".2f"),
    "ssim_flame": ("SSIM flame", ("ssim_flame",), 1, ".4f"),
    "psnr": ("PSNR (dB)", ("psnr",), 1, ".2f"),
    "ssim": ("SSIM", ("ssim",), 1, ".4f"),
    "lpips": ("LPIPS", ("lpips",), -1, ".4f"),
    "flip": ("FLIP", ("flip",), -1, ".4f"),
    "temporal_l2": ("change L2", ("temporal_l2",), -1, ".3f"),
    "cgvqm_2": ("CGVQM-2", ("cgvqm_2",), 1, ".2f"),
    "cgvqm_5": ("CGVQM-5", ("cgvqm_5",), 1, ".2f"),
    "rmse_depth": ("RMSE depth (m)", ("rmse_depth",), -1, ".3f"),
    "train_s": ("train (s)", ("train_s",), -1, ".1f"),
    "evaluate_s": ("evaluate (s)", ("evaluate_s",), -1, ".1f"),
    "gaussians": ("Gaussians", ("gaussians",), 0, "d"),
}


COLORS = ("#1769aa", "#c2410c", "#15803d", "#7e22ce", "#be123c", "#0e7490", "#854d0e", "#4b5563")
SYMBOLS = ("circle", "square", "diamond", "triangle-up", "cross", "star", "x", "triangle-down", "hexagon")


def collect(folders: list[Path]) -> list[dict[str, Any]]:
    """One row per folder with a scores.json of `gof evaluate`, then the controls of the first as rows with "control": true.

    Seconds to train: "train_seconds" of DIR/method.json (which may also give "name"), or the sum of DIR/reconstruct/costs.json
    or DIR/costs.json; None when there is neither.

    Raises:
        DataFormatError: a folder has no scores.json, or it is not one of `gof evaluate`.
    """
    rows = []
    for folder in folders:
        path = folder / "scores.json"
        if not path.is_file():
            raise DataFormatError(
                f"{folder}: no scores.json; run 'gof evaluate RESULT --truth DATASET --out {folder}' first"
            )
        scores = read_json(path)
        if not isinstance(scores, dict) or "dve" not in scores or "gaussians" not in scores:
            raise DataFormatError(f"{path}: not the scores of gof evaluate")
        about = read_json(folder / "method.json") if (folder / "method.json").is_file() else {}
        costs = scores.get("costs", {})
        values = scores | {
            "train_s": about.get("train_seconds", _train_seconds(folder)),
            "evaluate_s": sum(costs.values()) if costs else None,
        }
        row = {
            "name": about.get("name", folder.resolve().name),
            "folder": folder,
            "control": False,
            "method": scores.get("import", {}).get("method", "gof"),
            "notes": scores.get("import", {}).get("notes", []) + scores.get("warnings", []),
            "import": scores.get("import", {}),
            "dve": bool(scores.get("dve")),
        }
        rows.append(row | {key: _dig(values, where) for key, (_, where, _, _) in COLUMNS.items()})
    names = [r["name"] for r in rows]
    for i, row in enumerate(rows):  # two folders of one name
        if names.count(row["name"]) > 1:
            row["name"] = f"{row['name']} ({i + 1})"
    with_dve = next((r for r in rows if r["dve"]), None)
    if with_dve:
        for name, control in read_json(with_dve["folder"] / "scores.json").get("controls", {}).items():
            rows.append(
                {key: None for key in COLUMNS}
                | {
                    "name": f"control: {name}",
                    "method": control["meaning"],
                    "control": True,
                    "notes": [],
                    "l2": control["l2"],
                    "cos_sim": control["cos_sim"],
                    "speed_ratio": control.get("speed_ratio"),
                }
            )
    return rows


def _dig(values: Any, where: tuple[str, ...]):
    for key in where:
        values = values.get(key) if isinstance(values, dict) else None
    return values


def _train_seconds(folder: Path) -> float | None:
    for path in (folder / "reconstruct" / "costs.json", folder / "costs.json"):
        if path.is_file():
            return float(sum(s["seconds"] for s in read_json(path).get("stages", [])))
    return None


def pareto(points: list[tuple[float, float]], better: int) -> list[int]:
    """Indices of the points (cost, score) that no other beats in both, by rising cost; `better` +1: high scores win, -1: low."""
    best, front = None, []
    for i in sorted(range(len(points)), key=lambda i: (points[i][0], -better * points[i][1])):
        if best is None or better * points[i][1] > better * best:
            best = points[i][1]
            front.append(i)
    return front


def text_cell(row: dict[str, Any], key: str) -> str:
    value = row.get(key)
    return "-" if value is None else format(value, COLUMNS[key][3])


def used_columns(rows: list[dict[str, Any]]) -> list[str]:
    return [key for key in COLUMNS if any(r.get(key) is not None for r in rows)]


def to_csv(rows: list[dict[str, Any]]) -> str:
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["name", "method", "control", *COLUMNS])
    for r in rows:
        writer.writerow([r["name"], r["method"], int(r["control"]), *("" if r[k] is None else r[k] for k in COLUMNS)])
    return out.getvalue()


def to_markdown(rows: list[dict[str, Any]]) -> str:
    """The best value of every column in bold; controls below, in italics, never bold."""
    keys = used_columns(rows)
    lines = ["| method | " + " | ".join(COLUMNS[k][0] for k in keys) + " |", "|---|" + "---:|" * len(keys)]
    best = best_rows(rows)
    for i, r in enumerate(rows):
        name = r["name"].replace("|", "\\|")
        cells = [f"**{text_cell(r, k)}**" if best.get(k) == i else text_cell(r, k) for k in keys]
        lines.append(f"| {f'*{name}*' if r['control'] else name} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def best_rows(rows: list[dict[str, Any]]) -> dict[str, int]:
    """column -> row with its best value, controls left out."""
    out = {}
    for key, (_, _, better, _) in COLUMNS.items():
        values = [(better * r[key], -i) for i, r in enumerate(rows) if not r["control"] and r.get(key) is not None]
        if better and len(values) > 1:
            out[key] = -max(values)[1]
    return out


# ---------------------------------------------------------------- pictures


def stream_plots(rows: list[dict[str, Any]], dataset: Dataset, time_s: float | None = None) -> list[dict[str, Any]]:
    """{"name", "images": {kind: data URI}} of every row whose result can be read again; otherwise {"name", "reason"}."""
    from gof.evaluate.streams import plots

    time_s = float(dataset.times_s[len(dataset.times_s) // 2]) if time_s is None else time_s
    field = StoredField(dataset.velocity, time_s) if dataset.meta.get("velocity") else None
    out = []
    for row in rows:
        if row["control"]:
            continue
        try:
            state = state_at(_read_again(row), time_s)
            if not (state.dynamic & (state.at(time_s)[1] > 0)).any():
                raise GofError(f"no dynamic Gaussian lives at {time_s:g} s")
            out.append(
                {
                    "name": row["name"],
                    "time_s": time_s,
                    "images": {k: _uri(p) for k, p in plots(state, time_s, field).items()},
                }
            )
        except GofError as e:
            out.append({"name": row["name"], "reason": str(e)})
    return out


def _read_again(row: dict[str, Any]):
    """The result behind a row: the file in its folder, or the one that was scored, with the options that were used."""
    origin, folder = row["import"], row["folder"]
    candidates = [Path(p) for p in (origin.get("path"),) if p] + [
        folder / "result.npz",
        folder / "reconstruct" / "result.npz",
    ]
    path = next((p for p in candidates if p.exists()), None)
    if path is None:
        raise DataFormatError(
            f"{folder}: the result is not there any more (looked for {', '.join(map(str, candidates))})"
        )
    o = origin.get("options", {})
    gaussians = read_result(
        path,
        ImportOptions(
            o.get("time_unit_s"),
            o.get("time_zero_s", 0.0),
            o.get("frame_time_s"),
            Path(o["world"]) if o.get("world") else None,
        ),
    ).gaussians
    if "alignment" in origin:
        matrix = np.array(origin["alignment"]["matrix"])
        gaussians = (
            gaussians.transformed(matrix) if isinstance(gaussians, Trajectory) else transformed(gaussians, matrix)
        )
    return gaussians


def _uri(image) -> str:
    data = io.BytesIO()
    image.save(data, "PNG", optimize=True)
    return "data:image/png;base64," + base64.b64encode(data.getvalue()).decode()


def pareto_figures(rows: list[dict[str, Any]]) -> list[str]:
    """HTML of plotly charts: seconds to train (log) against a score, with the front that nobody beats."""
    import plotly.graph_objects as go

    out = []
    for key in ("l2", "cos_sim", "psnr_flame", "ssim_flame"):
        heading, _, better, _ = COLUMNS[key]
        shown = [r for r in rows if not r["control"] and r.get(key) is not None and r.get("train_s")]
        if not shown:
            continue
        points = [(r["train_s"], r[key]) for r in shown]
        front = pareto(points, better)
        figure = go.Figure()
        figure.add_scatter(
            x=[points[i][0] for i in front],
            y=[points[i][1] for i in front],
            mode="lines",
            line={"color": "#e8772e", "shape": "hv"},
            name="nobody is better and faster",
            hoverinfo="skip",
        )
        for number, (r, point) in enumerate(zip(shown, points, strict=True)):
            figure.add_scatter(
                x=[point[0]],
                y=[point[1]],
                mode="markers",
                name=r["name"],
                marker={"size": 12, "color": COLORS[number % len(COLORS)], "symbol": SYMBOLS[number % len(SYMBOLS)]},
            )
        constant = next((r for r in rows if r["control"] and r["name"].endswith("constant")), None)
        if constant and constant.get(key) is not None:
            figure.add_hline(
                y=constant[key],
                line={"dash": "dot", "color": "#777"},
                annotation_text="one constant vector",
                annotation_position="top right",
            )
        arrow = "lower is better" if better < 0 else "higher is better"
        figure.update_layout(
            template="plotly_white",
            height=420,
            margin={"l": 64, "r": 24, "t": 44, "b": 50},
            legend={"orientation": "h", "y": -0.22, "font": {"size": 12}},
            title={"text": f"{heading} ({arrow})", "font": {"size": 15}},
        )
        low, high = np.log10([0.7 * min(p[0] for p in points), 1.4 * max(p[0] for p in points)])
        ticks = [f * 10.0**k for k in range(int(np.floor(low)), int(np.ceil(high))) for f in (1, 2, 5)]
        figure.update_xaxes(
            type="log", title="seconds to train", range=[low, high], tickvals=ticks, ticktext=[f"{t:g}" for t in ticks]
        )
        figure.update_yaxes(title=heading)
        out.append(
            figure.to_html(full_html=False, include_plotlyjs=False, config={"displaylogo": False, "responsive": True})
        )
    return out


def to_html(rows: list[dict[str, Any]], streams: list[dict[str, Any]], title: str) -> str:
    """The page; everything is inside it."""
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from plotly.offline import get_plotlyjs

    charts = pareto_figures(rows)
    keys = used_columns(rows)
    table = [
        {
            "name": r["name"],
            "method": r["method"],
            "control": r["control"],
            "notes": r["notes"],
            "cells": [{"text": text_cell(r, k), "value": r.get(k), "best": best_rows(rows).get(k) == i} for k in keys],
        }
        for i, r in enumerate(rows)
    ]
    environment = Environment(loader=PackageLoader("gof.evaluate", "."), autoescape=True, undefined=StrictUndefined)
    return environment.get_template("leaderboard.html").render(
        title=title,
        headings=[{"text": COLUMNS[k][0], "better": COLUMNS[k][2]} for k in keys],
        table=table,
        streams=streams,
        charts=charts,
        plotlyjs=get_plotlyjs() if charts else "",
    )


@dataclass
class LeaderboardConfig:
    """Evaluated results side by side: table, stream plots of velocity, accuracy against time."""

    folders: tyro.conf.Positional[list[Path]]
    """Folders with scores.json of gof evaluate; method.json ("name", "train_seconds") and costs.json are used when there."""
    truth: Path | None = None
    """Dataset folder: adds stream plots with the truth beside each method."""
    out: Path = Path("out/leaderboard")
    """Folder for leaderboard.json, .csv, .md and .html; older ones are replaced."""
    title: str = "Leaderboard"
    """Heading of the page."""
    time: float | None = None
    """Time of the stream plots in seconds; default the middle frame."""
    json: Path | None = None
    """Another file to write the rows to."""


def main(argv: list[str]) -> int:
    """The command line of `gof leaderboard`."""
    from rich.console import Console
    from rich.table import Table

    config = tyro.cli(LeaderboardConfig, prog="gof leaderboard", args=argv)
    rows = collect(config.folders)
    streams = stream_plots(rows, Dataset.open(config.truth), config.time) if config.truth else []
    content = {
        "schema": "gof-leaderboard",
        "version": 1,
        "rows": [{k: v for k, v in r.items() if k not in ("folder", "import", "dve")} for r in rows],
    }
    for path in {config.out / "leaderboard.json", config.json} - {None}:
        write_json(path, content)
    for suffix, text in (
        ("csv", to_csv(rows)),
        ("md", to_markdown(rows)),
        ("html", to_html(rows, streams, config.title)),
    ):
        with atomic_path(config.out / f"leaderboard.{suffix}") as temporary:
            temporary.write_text(text, encoding="utf-8")
    console = Console()
    table = Table(title=config.title, title_justify="left")
    shown = [k for k in ("l2", "cos_sim", "psnr_flame", "ssim_flame", "train_s") if k in used_columns(rows)]
    table.add_column("method", no_wrap=True)
    for key in shown:
        table.add_column(COLUMNS[key][0], justify="right")
    for r in rows:
        table.add_row(r["name"], *(text_cell(r, k) for k in shown), style="dim" if r["control"] else None)
    console.print(table)
    for s in streams:
        if "reason" in s:
            console.print(
                f"note: no stream plot of {s['name']}: {s['reason']}", style="yellow", markup=False, highlight=False
            )
    console.print(f"written to {config.out}/leaderboard.html, .json, .csv, .md")
    return 0
