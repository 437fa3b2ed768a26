"""`gof study reconstruct`: what the settings of the reconstruction are worth, in tables and charts over seconds."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Literal, get_args

import numpy as np

from gof.commands.read import read_options
from gof.dataset import Dataset
from gof.look.charts import Point, line_chart
from gof.reconstruct.presets import PRESETS, effort_of, size_of
from gof_benchmark.studies.variants import Row, Setting, VariantStudy, run_one, table, write_page

FACTORS = (0.25, 0.5, 1, 2)  # of the preset's steps, Gaussians and picture size
VOXELS = (0.5, 1, 1.5)  # of the preset's
VARIED = {"steps": "iterations", "gaussians": "gaussians", "max-size": "longest_side", "voxels": "voxels"}
"""The varied settings, and their name in the settings and the rows."""
WORDS = {
    "steps": "number of steps",
    "gaussians": "number of Gaussians",
    "max-size": "longer side of the pictures, px",
    "voxels": "voxels along the longest side",
}
"""The varied settings in legends and headings."""
CHOICES: dict[str, dict[str, Setting]] = {
    "no flow prior": {"flow_prior": False},
    "scene of Gaussians": {"scene": "gaussians"},
    "flow by DeepFlow": {"flow": "deepflow"},
    "flow by TV-L1": {"flow": "tvl1"},
    "the paper's method": {"method": "paper"},
}
Group = Literal["presets", "steps", "gaussians", "max-size", "voxels", "choices"]
CHARTS = {"l2": "DVE L2", "cos_sim": "DVE CosSim", "psnr_flame": "held-out flame PSNR, dB"}
SCORES = {
    "l2": "DVE L2",
    "cos_sim": "DVE CosSim",
    "psnr_flame": "PSNR flame (dB)",
    "ssim_flame": "SSIM flame",
    "psnr_flame_novel": "PSNR flame, novel view (dB)",
}
COLUMNS = {VARIED[setting]: words for setting, words in WORDS.items()} | {"seconds": "seconds"}
COLUMNS |= {key: words for score, name in SCORES.items() for key, words in ((score, name), (f"{score}_sd", "±"))}
"""The columns of the tables: what a row holds, and the heading."""
Series = dict[str, dict[str, dict[str, Setting]]]


@dataclass
class SettingsStudy(VariantStudy):
    """Reconstruct a dataset with more and less work, and with other choices: velocity (DVE) and held-out pictures
    against seconds.

    Examples:
      gof study reconstruct data/fire --out out/settings

    The presets up to --preset, then that preset with 1/4, 1/2, 1 and 2 times its steps, Gaussians and picture
    size, with 1/2 and 1.5 times its voxels, and with one choice of the method changed. Every reconstruction has a
    folder in OUT; finished ones are kept, so a stopped study goes on where it was.
    """

    vary: tuple[Group, ...] = get_args(Group)
    """Settings to vary."""
    seeds: int = 1
    """Runs of each; the tables show their mean and standard deviation, the charts bars of the latter."""


def main(argv: list[str]) -> int:
    """`gof study reconstruct DATASET`; see --help."""
    study = read_options(SettingsStudy, "study reconstruct", argv)
    dataset = Dataset.open(study.dataset)
    groups = run_all(study, dataset)
    _draw_charts(study, groups)
    parts = [f"![{label}]({key}.svg)" for key, label in CHARTS.items()]
    for group, rows in groups.items():
        names = [row["name"] for row in rows]
        parts += [f"## {WORDS.get(group, group)}", table(["run", *COLUMNS.values()], names, rows, list(COLUMNS))]
    write_page(study.folder / "reconstruct.md", parts)
    study.finish("reconstruct", [{"group": group} | row for group, rows in groups.items() for row in rows])
    return 0


def run_all(study: SettingsStudy, dataset: Dataset) -> dict[str, list[Row]]:
    """Return rows by what was varied; what several groups have in common is made once."""
    known: dict[tuple, Row] = {}

    def once(name: str, settings: dict[str, Setting]) -> Row:
        key = tuple(sorted(settings.items()))
        if key not in known:
            folder = name.replace(" ", "-").replace("'", "")
            runs = {folder: settings} | {f"{folder}_{k}": settings | {"seed": k} for k in range(1, study.seeds)}
            known[key] = mean_row([run_one(study, dataset, run, given) for run, given in runs.items()])
        return known[key] | {"name": name}

    found = series(study, dataset)
    return {group: [once(name, settings) for name, settings in found[group].items()] for group in study.vary}


def mean_row(rows: list[Row]) -> Row:
    """Return the mean of the runs of one setting, which differ in their seed; and "SCORE_sd" where there are several.

    A score that one of them lacks is None.
    """
    mean = {"seconds": float(np.mean([row["seconds"] for row in rows]))}
    for score in SCORES:
        values = [row[score] for row in rows]
        if None in values:
            mean |= {score: None}
            continue
        mean |= {score: float(np.mean(values))}
        if len(rows) > 1:
            mean |= {f"{score}_sd": float(np.std(values, ddof=1))}
    return rows[0] | mean


def series(study: VariantStudy, dataset: Dataset) -> Series:
    """Return settings by what is varied and by the run's name; no picture is made larger than it is."""
    largest = max(max(camera.width, camera.height) for camera in dataset.cameras)
    base = study.settings(dataset)
    base["longest_side"] = min(base["longest_side"], largest)
    efforts = {name: effort_of(name, clip=size_of(dataset)) for name in PRESETS}
    most = effort_of(study.preset, clip=size_of(dataset)).iterations
    found: Series = {"presets": {name: asdict(e) for name, e in efforts.items() if e.iterations <= most}}
    for group, key in VARIED.items():
        values = [round(base[key] * factor) for factor in (VOXELS if key == "voxels" else FACTORS)]
        found[group] = {f"{group}-{v}": base | {key: v} for v in values if key != "longest_side" or v <= largest}
    return found | {"choices": {name: base | choice for name, choice in CHOICES.items()}}


def _draw_charts(study: VariantStudy, groups: dict[str, list[Row]]) -> None:
    """Draw each score over seconds: one line per group, a mark for each choice; what several groups share is labelled
    once."""
    for key, label in CHARTS.items():
        lines, labelled = {}, set()
        for group, rows in groups.items():
            for row in (row for row in rows if row[key] is not None):
                place = row["seconds"], row[key]
                words = "" if group == "choices" or place in labelled else row["name"].split("-")[-1]
                labelled.add(place)
                line = row["name"] if group == "choices" else WORDS.get(group, group)
                lines.setdefault(line, []).append(Point(*place, words, row.get(f"{key}_sd", 0.0)))
        title = f"{label} against time"
        line_chart(title, "seconds of the reconstruction", label, lines, log="x").write(study.folder / f"{key}.svg")
