"""`gof study reconstruct`: what the settings of the reconstruction are worth, in tables and charts over seconds."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import tyro

from gof.dataset import Dataset
from gof.reconstruct.presets import PRESETS
from gof.show import line_chart
from gof.show.paper import require_figure
from gof_benchmark.studies.variants import Row, VariantStudy, run_one, table, write_page

FACTORS = (0.25, 0.5, 1, 2)  # of the preset's iterations, Gaussians and picture size
VARIED = ("iterations", "gaussians", "longest_side")
CHARTS = {"l2": "DVE L2", "cos_sim": "DVE CosSim", "psnr_flame": "held-out flame PSNR, dB"}
COLUMNS = [*VARIED, "seconds", "l2", "cos_sim", "psnr_flame", "ssim_flame", "psnr_flame_novel"]


@dataclass
class SettingsStudy(VariantStudy):
    """Reconstruct a dataset with more and less work: velocity (DVE) and held-out pictures against seconds.

    The presets up to --preset, then that preset with 1/4, 1/2, 1 and 2 times its iterations, Gaussians and picture
    size. Every reconstruction has a folder in OUT; finished ones are kept, so a stopped study goes on where it was.
    """


def main(argv: list[str]) -> int:
    """`gof study reconstruct DATASET`; see --help."""
    study = tyro.cli(SettingsStudy, prog="gof study reconstruct", args=argv)
    require_figure()
    dataset = Dataset.open(study.dataset)
    groups = run_all(study, dataset)
    _draw_charts(study, groups)
    parts = [f"![{label}]({key}.svg)" for key, label in CHARTS.items()]
    for group, rows in groups.items():
        parts += [f"## {group}", table(["run", *COLUMNS], [row["name"] for row in rows], rows, COLUMNS)]
    write_page(study.out / "reconstruct.md", parts)
    study.finish("reconstruct", [{"group": group} | row for group, rows in groups.items() for row in rows])
    return 0


def run_all(study: VariantStudy, dataset: Dataset) -> dict[str, list[Row]]:
    """Rows by what was varied: the presets, then single settings of one preset."""
    known: dict[tuple, Row] = {}  # the preset itself is a point of every series

    def once(name: str, settings: dict[str, int]) -> Row:
        key = tuple(sorted(settings.items()))
        if key not in known:
            known[key] = run_one(study, dataset, name, settings)
        return known[key] | {"name": name}

    return {
        group: [once(name, settings) for name, settings in runs.items()]
        for group, runs in series(study, dataset).items()
    }


def series(study: VariantStudy, dataset: Dataset) -> dict[str, dict[str, dict[str, int]]]:
    """Settings by what is varied and by the run's name; no picture is made larger than it is."""
    largest = max(max(camera.width, camera.height) for camera in dataset.cameras)
    base = study.settings()
    base["longest_side"] = min(base["longest_side"], largest)
    presets = list(PRESETS)[: list(PRESETS).index(study.preset) + 1]
    found = {"presets": {name: asdict(PRESETS[name]) for name in presets}}
    for key in VARIED:
        values = [round(base[key] * factor) for factor in FACTORS]
        found[key] = {f"{key}-{v}": base | {key: v} for v in values if key != "longest_side" or v <= largest}
    return found


def _draw_charts(study: VariantStudy, groups: dict[str, list[Row]]) -> None:
    """Each score over seconds, one line per group; a point that several groups share is labelled once."""
    for key, label in CHARTS.items():
        lines, labelled = {}, set()
        for group, rows in groups.items():
            points = [(row["seconds"], row[key], row["name"].split("-")[-1]) for row in rows if row[key] is not None]
            lines[group] = [(x, y, "" if (x, y) in labelled else name) for x, y, name in points]
            labelled |= {(x, y) for x, y, _ in points}
        title = f"{label} against time"
        line_chart.write(study.out / f"{key}.svg", title, "seconds of the reconstruction", label, lines, log="x")
