"""`gof study reconstruct` and `gof study ablations`: what the settings and the parts of the method are worth."""

from __future__ import annotations

import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import tyro

from gof.commands.evaluate import evaluate
from gof.costs import StageLog
from gof.dataset import Dataset
from gof.evaluate import line_chart
from gof.io.files import atomic_path, read_json, write_json
from gof.reconstruct.presets import PRESETS
from gof.worker import run_worker

ABLATIONS = {
    "full method": {"ablation": "none"},
    "NoSync": {"ablation": "no-sync"},
    "RandFlow": {"ablation": "rand-flow"},
    "JointOpt": {"ablation": "joint-opt"},
    "NoMask": {"ablation": "no-mask"},
    "the paper's choices": {"method": "paper"},
}
FACTORS = (0.25, 0.5, 1, 2)  # of the preset's iterations, Gaussians and picture size


@dataclass
class StudyConfig:
    """Reconstruct a dataset many times and compare: velocity (DVE) and held-out pictures against seconds.

    ablations: the full method, the paper's NoSync, RandFlow, JointOpt and NoMask, and the paper's own choices wherever ours differ.
    reconstruct: the presets up to --preset, then that preset with 1/4, 1/2, 1 and 2 times its iterations, Gaussians and picture size.
    Every reconstruction has a folder in OUT; finished ones are kept, so a stopped study goes on where it was.
    """

    what: tyro.conf.Positional[Literal["reconstruct", "ablations"]]
    dataset: tyro.conf.Positional[Path]
    """Dataset folder, with true velocity."""
    out: Path = Path("out/study")
    """Folder for the reconstructions, the tables (Markdown) and the charts."""
    preset: Literal["preview", "draft", "standard", "paper"] = "preview"
    """How much work every reconstruction is, before a setting is varied."""
    gaussians: int | None = None
    """Instead of the preset's."""
    iterations: int | None = None
    """Instead of the preset's."""
    longest_side: int | None = None
    """Instead of the preset's."""
    json: Path | None = None
    """Also write the figures to this file."""


def main(argv: list[str]) -> int:
    """`gof study reconstruct DATASET` and `gof study ablations DATASET`; see --help."""
    config = tyro.cli(StudyConfig, prog="gof study", args=argv)
    dataset = Dataset.open(config.dataset)
    config.out.mkdir(parents=True, exist_ok=True)
    base = asdict(PRESETS[config.preset])
    base |= {name: value for name in base if (value := getattr(config, name, None)) is not None}
    study = study_ablations if config.what == "ablations" else study_settings
    rows = study(config, dataset, base)
    write_json(config.out / f"{config.what}.json", rows)
    if config.json:
        write_json(config.json, rows)
    print((config.out / f"{config.what}.md").read_text())
    return 0


def run_one(config: StudyConfig, dataset: Dataset, name: str, settings: dict) -> dict:
    """One reconstruction and its scores; kept when it is there already."""
    folder = config.out / name
    scores = folder / "study.json"
    if not scores.exists():
        options = [x for key, value in settings.items() for x in (f"--{key.replace('_', '-')}", str(value))]
        command = [sys.executable, "-m", "gof", "reconstruct", str(config.dataset), "--out", str(folder), *options]
        run_worker(command, name, config.out / f"{name}.log")
        dve = evaluate(folder / "result.npz", dataset, images=False)["dve"]
        stages = {stage.name: stage.seconds for stage in StageLog(folder / "costs.json").stages()}
        held_out = read_json(folder / "curve.json")[-1]
        row = {
            "name": name,
            **settings,
            "seconds": round(sum(stages.values()), 1),
            "l2": dve["l2"],
            "cos_sim": dve["cos_sim"],
        }
        write_json(scores, row | {key: value for key, value in held_out.items() if key not in ("step", "seconds")})
    return read_json(scores)


def study_ablations(config: StudyConfig, dataset: Dataset, base: dict) -> list[dict]:
    """The variants' scores, and the paper's two tables of them in ablations.md."""
    rows = [run_one(config, dataset, *change.values(), base | change) for change in ABLATIONS.values()]
    labels = list(ABLATIONS)
    velocity = _table(
        ["ablation", "L2 (lower)", "CosSim (higher)", "seconds"], labels, rows, ["l2", "cos_sim", "seconds"]
    )
    pictures = _table(
        ["ablation", "PSNR flame", "SSIM flame", "PSNR", "SSIM", "PSNR flame, novel view"],
        labels,
        rows,
        ["psnr_flame", "ssim_flame", "psnr", "ssim", "psnr_flame_novel"],
    )
    title = f"{dataset.meta['name']}: " + ", ".join(f"{key} {value}" for key, value in base.items())
    _write(config.out / "ablations.md", [title, "## Velocity", velocity, "## Held-out pictures", pictures])
    return rows


def study_settings(config: StudyConfig, dataset: Dataset, base: dict) -> list[dict]:
    """Scores of presets and of single settings varied, with charts against seconds, in reconstruct.md."""
    largest = max(max(camera.width, camera.height) for camera in dataset.cameras)
    base |= {"longest_side": min(base["longest_side"], largest)}
    presets = list(PRESETS)[: list(PRESETS).index(config.preset) + 1]
    series = {"presets": {name: asdict(PRESETS[name]) for name in presets}}
    for key in ("iterations", "gaussians", "longest_side"):
        values = [round(base[key] * factor) for factor in FACTORS]
        series[key] = {f"{key}-{v}": base | {key: v} for v in values if key != "longest_side" or v <= largest}
    known: dict[tuple, dict] = {}  # the preset itself is a point of every series

    def once(name: str, settings: dict) -> dict:
        key = tuple(sorted(settings.items()))
        if key not in known:
            known[key] = run_one(config, dataset, name, settings)
        return known[key] | {"name": name}

    groups = {group: [once(name, settings) for name, settings in runs.items()] for group, runs in series.items()}
    parts = []
    for key, label in (("l2", "DVE L2"), ("cos_sim", "DVE CosSim"), ("psnr_flame", "held-out flame PSNR, dB")):
        lines, labelled = {}, set()
        for group, rows in groups.items():
            points = [(row["seconds"], row[key] or 0, row["name"].split("-")[-1]) for row in rows]
            lines[group] = [(x, y, "" if (x, y) in labelled else name) for x, y, name in points]
            labelled |= {(x, y) for x, y, _ in points}
        line_chart.write(
            config.out / f"{key}.svg", f"{label} against time", "seconds of the reconstruction", label, lines
        )
        parts.append(f"![{label}]({key}.svg)")
    columns = [
        "iterations",
        "gaussians",
        "longest_side",
        "seconds",
        "l2",
        "cos_sim",
        "psnr_flame",
        "ssim_flame",
        "psnr_flame_novel",
    ]
    for group, rows in groups.items():
        parts += [f"## {group}", _table(["run", *columns], [row["name"] for row in rows], rows, columns)]
    _write(config.out / "reconstruct.md", parts)
    return [{"group": group} | row for group, rows in groups.items() for row in rows]


def _table(header: list[str], labels: list[str], rows: list[dict], keys: list[str]) -> str:
    """Markdown; columns that no row has a value for are left out."""
    used = [k for k, key in enumerate(keys) if any(row.get(key) is not None for row in rows)]
    lines = [[header[0], *(header[k + 1] for k in used)], ["---"] * (len(used) + 1)]
    lines += [[label, *(_text(row.get(keys[k])) for k in used)] for label, row in zip(labels, rows, strict=True)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _text(value) -> str:
    if value is None:
        return "-"
    return (
        str(value) if isinstance(value, int) else f"{value:.{3 if abs(value) < 10 else 2 if abs(value) < 100 else 0}f}"
    )


def _write(path: Path, parts: list[str]) -> None:
    with atomic_path(path) as temporary:
        temporary.write_text("\n\n".join(parts) + "\n")
