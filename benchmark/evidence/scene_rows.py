"""One scene's rows in full: pooled figures of every submission, as `gof evaluate` gives them, and the trivial
baselines."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from gof.evaluate.leaderboard import COLUMNS, EvaluatedResult
from gof.evaluate.scores import Scores
from gof.evaluate.submission import SCORES, Submission
from gof.evaluate.training_curve import FILE, TrainingCurve

FIGURES = ("gaussians", "train_s", "memory_mb", "l2", "cos_sim", "inside_l2", "inside_cos", "eve_l2")
FIGURES += ("eve_cos", "psnr_flame", "ssim_flame", "psnr")
PLATE = ("psnr_flame", "ssim_flame", "psnr")  # of them the plate alone has
SHOWN = ("zero", "constant", "height_mean")


def table(submissions: list[Path], scene: str) -> str:
    """Markdown: a line for each submission that has the scene (means over its runs), then the trivial baselines.

    The last column is by how much the mean training loss fell from the fourth fifth of the steps to the last. Trivial
    baselines are on the Gaussians of the first flame alone, where there is one: a whole scene's are mostly its room.

    Args:
        submissions: folders (`gof.evaluate.submission`); what their scores.json say is taken as it is.
    """
    headings = [COLUMNS[key].heading for key in FIGURES]
    lines = [f"| {scene} | {' | '.join(headings)} | last fall of the loss |", "|---|" + "---:|" * (len(FIGURES) + 1)]
    there: list[EvaluatedResult] = []
    for submission in map(Submission.open, submissions):
        folders = submission.runs.get(scene, ())
        about = replace(submission.method, train_seconds=None, memory_mb=None)  # of the run, not of the mean scene
        runs = [EvaluatedResult.of(folder, about, Scores.read(folder / SCORES)) for folder in folders]
        if runs:
            cells = [_mean(key, runs) for key in FIGURES]
            lines.append(f"| {submission.name} | {' | '.join(cells)} | {_fall(folders[0])} |")
            there.append(runs[0])
    if there:
        whose = next((run for run in there if run.scores.import_.over_plates), there[0])
        lines += [*_trivial_lines(whose.scores), "", f"Trivial baselines: on the Gaussians of {whose.name}."]
    return "\n".join(lines) + "\n"


def _mean(key: str, runs: list[EvaluatedResult]) -> str:
    found = [COLUMNS[key].value(run) for run in runs]
    return _cell(key, None if None in found else float(np.mean(found)))


def _fall(run: Path) -> str:
    return f"{100 * TrainingCurve.read(run / FILE).last_fall:.0f} %" if (run / FILE).is_file() else ""


def _trivial_lines(scores: Scores) -> list[str]:
    """Return the trivial baselines' lines: pooled over frames as the methods' own figures are."""
    known = {
        name: {"l2": trivial_baseline.l2, "cos_sim": trivial_baseline.cos_sim}
        for name, trivial_baseline in scores.trivial_baselines.items()
    }
    eve = None if scores.dve is None else scores.dve.eve
    if eve is not None and "constant" in known:
        known["constant"] |= {"eve_l2": eve.baselines["constant"].l2, "eve_cos": eve.baselines["constant"].cos_sim}
    rows = {f"trivial: {name}": known[name] for name in SHOWN if name in known}
    rows["trivial: fire-free background"] = {key: getattr(scores, f"{key}_plate") for key in PLATE}
    return [f"| {name} | {' | '.join(_cell(key, of.get(key)) for key in FIGURES)} | |" for name, of in rows.items()]


def _cell(key: str, figure: float | None) -> str:
    kind = COLUMNS[key].format
    return "" if figure is None else format(round(figure) if kind == "d" else figure, kind)
