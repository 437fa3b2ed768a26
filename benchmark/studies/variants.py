"""Parts that the studies of the reconstruction share: one reconstruction with changed settings, its scores, and
tables."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from gof.commands.everywhere import next_to, write_figures
from gof.commands.read import Pixels, Preset
from gof.core.costs import StageLog
from gof.core.files import atomic_path, read_json, write_json
from gof.dataset import Dataset
from gof.evaluate import evaluate
from gof.host.processes import python_command
from gof.host.worker import run_worker
from gof.reconstruct.curve import Curve
from gof.reconstruct.presets import FLAGS, effort_of, size_of

Setting = int | str | bool
Row = dict[str, Any]
"""A reconstruction in a table: "name", the settings that were given, "seconds", and its scores by name."""


@dataclass
class VariantStudy:
    """Options of every study of the reconstruction."""

    dataset: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="DATASET")]]
    """Dataset folder, with true velocity."""
    out: Path | None = None
    """Folder for the reconstructions, the tables (Markdown) and the charts. Default: beside the dataset,
    DATASET_study."""
    preset: Preset = "preview"
    """How much work every reconstruction is, before a setting is varied."""
    steps: int | None = None
    """Instead of the preset's."""
    gaussians: int | None = None
    """Instead of the preset's."""
    max_size: Pixels | None = None
    """Instead of the preset's."""

    def settings(self, dataset: Dataset) -> dict[str, int]:
        """Return the settings of every reconstruction of a dataset, before something is varied: options of
        `gof reconstruct` by name."""
        preset = effort_of(self.preset, clip=size_of(dataset))
        given = {"iterations": self.steps, "gaussians": self.gaussians, "longest_side": self.max_size}
        return asdict(preset) | {name: value for name, value in given.items() if value is not None}

    @property
    def folder(self) -> Path:
        """Where everything goes."""
        return self.out or next_to(self.dataset, "_study")

    def finish(self, name: str, rows: list[Row]) -> None:
        """Write the figures, and show the tables in OUT/NAME.md."""
        write_json(self.folder / f"{name}.json", rows)
        write_figures(rows)
        print((self.folder / f"{name}.md").read_text(encoding="utf-8"))


def run_one(study: VariantStudy, dataset: Dataset, name: str, settings: dict[str, Setting]) -> Row:
    """Return one reconstruction in OUT/NAME and its scores; one of the same dataset and settings is kept."""
    folder = study.folder / name
    known = _known_row(study, dataset, name, settings)
    if known is None:
        options = [word for key, value in settings.items() for word in _option(key, value)]
        study.folder.mkdir(parents=True, exist_ok=True)
        command = python_command("-m", "gof", "reconstruct", str(study.dataset), "--out", str(folder), *options)
        run_worker(command, name, study.folder / f"{name}.log")
        velocity = evaluate(folder / "result.npz", dataset, images=False).dve
        seconds = sum(stage.seconds for stage in StageLog(folder / "costs.json").stages())
        row = {"name": name, **settings, "seconds": round(seconds, 1)}
        row |= {"l2": velocity.l2, "cos_sim": velocity.cos_sim}
        known = row | asdict(Curve.read(folder).points[-1].scores)
        write_row(study, dataset, name, settings, known)
    return known


def _option(name: str, value: Setting) -> list[str]:
    """Return a setting in the words of the command line."""
    if isinstance(value, bool):
        return [f"--{name.replace('_', '-')}" if value else f"--no-{name.replace('_', '-')}"]
    return [FLAGS.get(name, f"--{name.replace('_', '-')}"), str(value)]


def write_row(study: VariantStudy, dataset: Dataset, name: str, settings: dict[str, Setting], row: Row) -> None:
    """Keep a row in OUT/NAME/study.json, with what it was made from."""
    made_from = {"dataset": dataset.identity(), "settings": settings}
    write_json(study.folder / name / "study.json", {"made_from": made_from, "row": row})


def _known_row(study: VariantStudy, dataset: Dataset, name: str, settings: dict[str, Setting]) -> Row | None:
    path = study.folder / name / "study.json"
    kept = read_json(path) if path.exists() else {}
    made_from = {"dataset": dataset.identity(), "settings": settings}
    return kept["row"] if kept.get("made_from") == made_from else None


def table(header: list[str], labels: list[str], rows: list[Row], keys: list[str]) -> str:
    """Markdown; columns that no row has a value for are left out."""
    used = [k for k, key in enumerate(keys) if any(row.get(key) is not None for row in rows)]
    lines = [[header[0], *(header[k + 1] for k in used)], ["---"] * (len(used) + 1)]
    lines += [[label, *(_text(row.get(keys[k])) for k in used)] for label, row in zip(labels, rows, strict=True)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def write_page(path: Path, parts: list[str]) -> None:
    with atomic_path(path) as temporary:
        temporary.write_text("\n\n".join(parts) + "\n")


def _text(value: float | int | str | None) -> str:
    """Return a figure in a table: three decimals below 10, two below 100, none above."""
    if value is None:
        return "-"
    if not isinstance(value, float):
        return str(value)
    if abs(value) < 10:
        return f"{value:.3f}"
    return f"{value:.2f}" if abs(value) < 100 else f"{value:.0f}"
