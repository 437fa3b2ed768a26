"""Evaluated results side by side: the rows of the leaderboard, the best of each column, CSV and Markdown."""

from __future__ import annotations

import csv
import html
import io
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

from gof.core.costs import StageCost, StageLog
from gof.core.errors import DataFormatError, printable
from gof.evaluate.authors_figures import NAME, OTHER_FOOTAGE, THEIRS
from gof.evaluate.method import AboutMethod
from gof.evaluate.scores import (
    OPACITY,
    ORDER,
    Agreement,
    Origin,
    PublishedFigures,
    Scores,
    TrivialScore,
    velocity_of,
)
from gof.evaluate.trivial_baselines import BOUNDS

LOWER, NEITHER, HIGHER = -1, 0, 1  # which values of a column are better


@dataclass(frozen=True)
class EvaluatedResult:
    """A folder with a scores.json, and what else it says.

    Attributes:
        train_s, memory_mb: seconds of the training, and the most memory it needed; None when the folder does not say.
        unfinished, notes: see `AboutMethod`.
    """

    folder: Path
    name: str
    scores: Scores
    train_s: float | None
    unfinished: str | None = None
    notes: tuple[str, ...] = ()
    memory_mb: float | None = None

    @classmethod
    def of(cls, folder: Path, about: AboutMethod, scores: Scores) -> EvaluatedResult:
        """Return a folder's result: what method.json says of its costs, else what the costs.json of its training
        does."""
        stages = _training(folder, scores)
        train_s, memory_mb = about.train_seconds, about.memory_mb
        if train_s is None and stages:
            train_s = float(sum(stage.seconds for stage in stages))
        if memory_mb is None and stages:
            memory_mb = max(stage.peak_mb for stage in stages) or None  # 0: not measured
        return cls(folder, about.title(folder), scores, train_s, about.unfinished, about.notes, memory_mb)


@dataclass(frozen=True)
class Column:
    """A column of the leaderboard; `value` gives None where there is nothing to show."""

    heading: str
    better: int
    format: str
    value: Callable[[EvaluatedResult], float | int | str | None]


def _velocity(value: Callable) -> Callable[[EvaluatedResult], float | None]:
    """Return a figure of the `VelocityScore`; None without true velocities."""
    return lambda result: None if result.scores.dve is None else value(result.scores.dve)


def _eve(value: Callable) -> Callable[[EvaluatedResult], float | None]:
    """Return a figure of EVE; None where there is no such score."""
    return _velocity(lambda dve: None if dve.eve is None else value(dve.eve))


def _gradients(value: Callable) -> Callable[[EvaluatedResult], float | None]:
    """Return an error of the velocity's gradients; None where there is none."""
    return _velocity(lambda dve: None if dve.gradients is None else value(dve.gradients))


def _published(value: Callable[[PublishedFigures], float | None]) -> Callable[[EvaluatedResult], float | None]:
    """Return one of the authors' figures; None where they were not requested."""
    return lambda result: None if result.scores.published is None else value(result.scores.published)


def _flow_prior(result: EvaluatedResult) -> str | None:
    used = result.scores.flow_prior
    return None if used is None else "yes" if used else "no"


def _epe_px(result: EvaluatedResult) -> float | None:
    flow = result.scores.flow
    return None if flow is None else flow.result.epe_px


def best_baseline(baselines: Mapping[str, Agreement | TrivialScore], key: str) -> tuple[str, float] | None:
    """Return the trivial baseline that is best in "l2" or "cos_sim", and its figure; None where none has one.

    Those that know the truth at every place are left out.
    """
    better = {"l2": LOWER, "cos_sim": HIGHER}[key]
    found = [(name, getattr(one, key)) for name, one in baselines.items() if name not in BOUNDS]
    return max((one for one in found if one[1] is not None), key=lambda one: better * one[1], default=None)


def _baseline(key: str) -> Callable[[EvaluatedResult], float | None]:
    """Return the best trivial baseline's figure on the result's own Gaussians."""
    return lambda result: (best_baseline(result.scores.trivial_baselines, key) or (None, None))[1]


def _eve_baseline(key: str) -> Callable[[EvaluatedResult], float | None]:
    """Return the figure of the best of EVE's trivial baselines."""
    return _eve(lambda eve: (best_baseline(eve.baselines, key) or (None, None))[1])


COLUMNS = {
    "velocity_of": Column("velocity of", NEITHER, "s", lambda result: velocity_of([result.scores])),
    "flow_prior": Column("learned flow prior", NEITHER, "s", _flow_prior),
    "eve_l2": Column("EVE L2", LOWER, ".3f", _eve(lambda eve: eve.l2)),
    "eve_cos": Column("EVE CosSim", HIGHER, ".3f", _eve(lambda eve: eve.cos_sim)),
    "eve_fluctuation_l2": Column("EVE fluctuation L2", LOWER, ".3f", _eve(lambda eve: eve.fluctuation.l2)),
    "eve_fluctuation_cos": Column("EVE fluctuation CosSim", HIGHER, ".3f", _eve(lambda eve: eve.fluctuation.cos_sim)),
    "eve_baseline_l2": Column("EVE best baseline L2", NEITHER, ".3f", _eve_baseline("l2")),
    "eve_baseline_cos": Column("EVE best baseline CosSim", NEITHER, ".3f", _eve_baseline("cos_sim")),
    "l2": Column("DVE L2", LOWER, ".3f", _velocity(lambda dve: dve.l2)),
    "cos_sim": Column("DVE CosSim", HIGHER, ".3f", _velocity(lambda dve: dve.cos_sim)),
    "baseline_l2": Column("best baseline L2", NEITHER, ".3f", _baseline("l2")),
    "baseline_cos": Column("best baseline CosSim", NEITHER, ".3f", _baseline("cos_sim")),
    "inside_l2": Column("in the domain L2", LOWER, ".3f", _velocity(lambda dve: dve.inside.l2)),
    "inside_cos": Column("in the domain CosSim", HIGHER, ".3f", _velocity(lambda dve: dve.inside.cos_sim)),
    "fluctuation_l2": Column("fluctuation L2", LOWER, ".3f", _velocity(lambda dve: dve.fluctuation.l2)),
    "fluctuation_cos": Column("fluctuation CosSim", HIGHER, ".3f", _velocity(lambda dve: dve.fluctuation.cos_sim)),
    "vorticity_l2": Column("vorticity L2", LOWER, ".3f", _gradients(lambda gradients: gradients.vorticity_l2)),
    "divergence_l2": Column("divergence L2", LOWER, ".3f", _gradients(lambda gradients: gradients.divergence_l2)),
    "skill": Column("skill over constant", HIGHER, ".3f", _velocity(lambda dve: dve.skill_over_constant)),
    "speed_ratio": Column("speed ratio", NEITHER, ".2f", _velocity(lambda dve: dve.speed_ratio)),
    "epe_px": Column("EPE (px)", LOWER, ".3f", _epe_px),
    "psnr_flame": Column("PSNR flame (dB)", HIGHER, ".2f", lambda result: result.scores.psnr_flame),
    "ssim_flame": Column("SSIM flame", HIGHER, ".4f", lambda result: result.scores.ssim_flame),
    "psnr": Column("PSNR (dB)", HIGHER, ".2f", lambda result: result.scores.psnr),
    "ssim": Column("SSIM", HIGHER, ".4f", lambda result: result.scores.ssim),
    "lpips": Column("LPIPS", LOWER, ".4f", lambda result: result.scores.lpips),
    "flip": Column("FLIP", LOWER, ".4f", lambda result: result.scores.flip),
    "temporal_l2": Column("frame-to-frame change L2", LOWER, ".3f", lambda result: result.scores.temporal_l2),
    "rmse_depth": Column("RMSE depth (m)", LOWER, ".3f", lambda result: result.scores.rmse_depth),
    "published_psnr_flame": Column("PSNR moving pixels (dB)", HIGHER, ".2f", _published(lambda p: p.psnr_flame)),
    "published_ssim_flame": Column("SSIM moving pixels", HIGHER, ".3f", _published(lambda p: p.ssim_flame)),
    "published_rmse_depth": Column("RMSE 1/depth, moving", LOWER, ".3f", _published(lambda p: p.rmse_depth_flame)),
    "published_lpips": Column("LPIPS whole picture", LOWER, ".3f", _published(lambda p: p.lpips)),
    "published_psnr_no_sync": Column("PSNR without board (dB)", HIGHER, ".2f", _published(lambda p: p.psnr_no_sync)),
    "published_ssim_no_sync": Column("SSIM without board", HIGHER, ".3f", _published(lambda p: p.ssim_no_sync)),
    "train_s": Column("training (s)", LOWER, ".1f", lambda result: result.train_s),
    "memory_mb": Column("memory (MB)", LOWER, ".0f", lambda result: result.memory_mb),
    "evaluate_s": Column("scoring (s)", LOWER, ".1f", lambda result: sum(result.scores.costs.values()) or None),
    "gaussians": Column("Gaussians", NEITHER, "d", lambda result: result.scores.gaussians),
}


@dataclass(frozen=True, kw_only=True)
class LeaderboardRow:
    """A line of the leaderboard: a result, or a trivial baseline of the only one. The figures are named as in COLUMNS.

    A line with `other_footage` shows what authors published for other fires, or a score of another dataset or kind, and
    one with `unfinished` a training that was stopped before its end; they are not ranked.
    """

    FORMER: ClassVar[dict[str, str]] = {"control": "trivial_baseline"}  # of 0.2; goes with the next version

    name: str
    method: str
    trivial_baseline: bool = False
    other_footage: bool = False
    unfinished: str | None = None
    notes: tuple[str, ...] = ()
    velocity_of: str | None = None
    flow_prior: str | None = None
    eve_l2: float | None = None
    eve_cos: float | None = None
    eve_fluctuation_l2: float | None = None
    eve_fluctuation_cos: float | None = None
    eve_baseline_l2: float | None = None
    eve_baseline_cos: float | None = None
    l2: float | None = None
    cos_sim: float | None = None
    baseline_l2: float | None = None
    baseline_cos: float | None = None
    inside_l2: float | None = None
    inside_cos: float | None = None
    fluctuation_l2: float | None = None
    fluctuation_cos: float | None = None
    vorticity_l2: float | None = None
    divergence_l2: float | None = None
    skill: float | None = None
    speed_ratio: float | None = None
    epe_px: float | None = None
    psnr_flame: float | None = None
    ssim_flame: float | None = None
    psnr: float | None = None
    ssim: float | None = None
    lpips: float | None = None
    flip: float | None = None
    temporal_l2: float | None = None
    rmse_depth: float | None = None
    published_psnr_flame: float | None = None
    published_ssim_flame: float | None = None
    published_rmse_depth: float | None = None
    published_lpips: float | None = None
    published_psnr_no_sync: float | None = None
    published_ssim_no_sync: float | None = None
    train_s: float | None = None
    memory_mb: float | None = None
    evaluate_s: float | None = None
    gaussians: int | None = None

    @property
    def competes(self) -> bool:
        """Return whether its figures may be the best of a column."""
        return not self.trivial_baseline and not self.other_footage and not self.unfinished

    def text(self, column: str) -> str:
        value = getattr(self, column)
        return "-" if value is None else format(value, COLUMNS[column].format)


@dataclass(frozen=True)
class Leaderboard:
    """`leaderboard.json`."""

    SCHEMA: ClassVar[str] = "gof-leaderboard"
    VERSION: ClassVar[int] = 1

    rows: tuple[LeaderboardRow, ...]


def about(folder: Path) -> AboutMethod:
    """Return the authors' description of a method: beside its scores, or, of a scene of a submission, one folder up."""
    has_own = (folder / "method.json").is_file()
    return AboutMethod.read(folder if has_own else folder.resolve().parent)


def collect(folders: Sequence[Path]) -> list[EvaluatedResult]:
    """Return the results in folders with a scores.json of `gof evaluate` (or of that file), with names that differ.

    Seconds to train: "train_seconds" of DIR/method.json (see `AboutMethod`), or the sum of
    DIR/reconstruct/costs.json, DIR/costs.json or the one beside the result that was scored; None when there is none.

    Raises:
        DataFormatError: a folder has no scores.json, or it is not one of this version's `gof evaluate`.
    """
    results = []
    for folder in (path.parent if path.name == "scores.json" and not path.is_dir() else path for path in folders):
        if folder.is_file():
            raise DataFormatError(f"{folder}: a file; name the folder that 'gof evaluate --out' wrote scores.json into")
        if not (folder / "scores.json").is_file():
            raise DataFormatError(
                f"{folder}: no scores.json; run 'gof evaluate RESULT --dataset DATASET --out {folder}' first"
            )
        scores = Scores.read(folder / "scores.json")
        results.append(EvaluatedResult.of(folder, about(folder), scores))
    names = [result.name for result in results]
    return [
        replace(result, name=f"{result.name} ({i + 1})") if names.count(result.name) > 1 else result
        for i, result in enumerate(results)
    ]


def _training(folder: Path, scores: Scores) -> tuple[StageCost, ...]:
    homes = [folder / "reconstruct", folder]
    if scores.import_.path is not None:
        homes.append(Path(scores.import_.path).parent)
    for home in homes:
        if (home / "costs.json").is_file():
            return StageLog(home / "costs.json").stages()
    return ()


def rows_of(results: Sequence[EvaluatedResult], dataset: str | None = None) -> list[LeaderboardRow]:
    """Return one row per result, what the authors published if a result has their figures, then the trivial baselines
    of a single one.

    A trivial baseline is worth something on one result's Gaussians alone: beside several, each row has the best of its
    own. A result that was scored on another dataset, or in another way, does not compete, and says so.

    Args:
        dataset: on which the results are compared (`Dataset.scored_as`); default: that of most of them.
    """
    known = [result.scores.dataset for result in results if result.scores.dataset]
    dataset = dataset or max(known, key=known.count, default=None)
    apart = [_apart(result.scores, dataset) for result in results]
    rows = [
        LeaderboardRow(
            name=result.name,
            method=result.scores.import_.method,
            unfinished=result.unfinished,
            other_footage=why is not None,
            notes=(
                *([f"{why}: it does not compete"] if why else []),
                *result.notes,
                *result.scores.import_.notes,
                *result.scores.warnings,
            ),
            **_figures(result, COLUMNS),
        )
        for result, why in zip(results, apart, strict=True)
    ]
    if any(result.scores.published is not None for result in results):
        rows.append(_authors_row())
    trivial_baselines = results[0].scores.trivial_baselines if len(results) == 1 else {}
    return rows + [
        LeaderboardRow(
            name=f"trivial: {name}",
            method=trivial_baseline.meaning,
            trivial_baseline=True,
            l2=trivial_baseline.l2,
            cos_sim=trivial_baseline.cos_sim,
            speed_ratio=trivial_baseline.speed_ratio,
        )
        for name, trivial_baseline in trivial_baselines.items()
    ]


def _apart(scores: Scores, dataset: str | None) -> str | None:
    """Return why a result cannot be compared with those of a dataset, in words; None: it can."""
    if scores.dataset not in (None, dataset):
        return f"scored on another dataset, {scores.dataset}"
    if scores.dve is not None and (scores.dve.order, scores.dve.opacity) != (ORDER, OPACITY):
        return f"its DVE is of order {scores.dve.order} and {scores.dve.opacity} opacity, not {ORDER} and {OPACITY}"
    return None


def _figures(result: EvaluatedResult, keys: Iterable[str]) -> dict[str, Any]:
    """Return the fields of a `LeaderboardRow` with these names."""
    return {key: COLUMNS[key].value(result) for key in keys}


def _authors_row() -> LeaderboardRow:
    """Return the authors' own figures, of other footage."""
    about = EvaluatedResult(
        Path(), NAME, Scores(gaussians=0, dynamic_gaussians=0, import_=Origin(NAME), published=THEIRS), None
    )
    figures = _figures(about, [key for key in COLUMNS if key.startswith("published_")])
    return LeaderboardRow(name=f"{NAME}, other footage", method=OTHER_FOOTAGE, other_footage=True, **figures)


def used_columns(rows: Sequence[LeaderboardRow]) -> list[str]:
    """Return the columns in which any row has a value."""
    return [key for key in COLUMNS if any(getattr(row, key) is not None for row in rows)]


def best_rows(rows: Sequence[LeaderboardRow]) -> dict[str, int]:
    """Return column -> number of the row with its best value, the first of equals; only rows that compete take part."""
    best = {}
    for key, column in COLUMNS.items():
        if not column.better:
            continue
        values = {i: getattr(row, key) for i, row in enumerate(rows) if row.competes}
        values = {i: column.better * value for i, value in values.items() if value is not None}
        if len(values) > 1:
            best[key] = max(values, key=values.__getitem__)
    return best


def to_csv(rows: Sequence[LeaderboardRow]) -> str:
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["name", "method", "trivial_baseline", "other_footage", *COLUMNS])
    for row in rows:
        values = [getattr(row, key) for key in COLUMNS]
        kind = [int(row.trivial_baseline), int(row.other_footage)]
        writer.writerow([in_csv(row.name), in_csv(row.method), *kind, *("" if v is None else v for v in values)])
    return out.getvalue()


def to_markdown(rows: Sequence[LeaderboardRow]) -> str:
    """Return the best value of every column in bold; trivial baselines and rows of other footage in italics, never
    bold."""
    keys, best = used_columns(rows), best_rows(rows)
    headings = " | ".join(COLUMNS[key].heading for key in keys)
    lines = [f"| method | {headings} |", "|---|" + "---:|" * len(keys)]
    for i, row in enumerate(rows):
        name = in_markdown(row.name)
        cells = [f"**{row.text(key)}**" if best.get(key) == i else row.text(key) for key in keys]
        lines.append(f"| {name if row.competes else f'*{name}*'} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def pareto(points: Sequence[tuple[float, float]], better: int) -> list[int]:
    """Return indices of the points (cost, score) on the Pareto front, by rising cost; `better` +1: high scores win."""
    best, front = None, []
    for i in sorted(range(len(points)), key=lambda i: (points[i][0], -better * points[i][1])):
        if best is None or better * points[i][1] > better * best:
            best = points[i][1]
            front.append(i)
    return front


# ----------------------------------------------------------------
# Names as text in the cells of tables that other programs read: a name from a file is no formula, link or markup.


def in_csv(name: str) -> str:
    """Spreadsheets run cells that begin like a formula, also in quotes, but not after an apostrophe."""
    line = one_line(name)
    return f"'{line}" if line.startswith(("=", "+", "-", "@")) else line


def in_markdown(name: str) -> str:
    """Return one line, without another column, a link, a style or HTML."""
    return re.sub(r"([\\`*_\[\]()|!~#])", r"\\\1", html.escape(one_line(name), quote=False))


def one_line(name: str) -> str:
    """Without line ends, tabs, and what acts on terminals."""
    return printable(" ".join(name.split()))
