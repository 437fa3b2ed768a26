"""Scores of finished reconstructions, runs of other seeds in one row, as `gof evaluate` wrote them beside each result.

    python -m gof_benchmark.evidence.run_scores NAME=RESULT,RESULT ...

Takes seconds, after `gof evaluate`.

Figures are means over the runs of a name; where there are several, the standard deviation stands behind L2.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from gof.core.errors import GofError
from gof.evaluate.scores import Agreement, Scores

ANGLES = (0, 10, 55, 85, 100, 144)  # degrees from the nearest training camera; a view counts for the nearest of them


@dataclass(frozen=True)
class RunScores:
    """Print the scores of finished reconstructions as tables."""

    runs: tyro.conf.Positional[tuple[str, ...]]
    """NAME=FOLDER,FOLDER,...: folders with `scores.json`, each of another seed."""


def read_runs(text: str) -> tuple[str, list[Scores]]:
    """Return the name and the scores of NAME=FOLDER,FOLDER. Raises GofError: it is not written so."""
    name, equals, folders = text.partition("=")
    if not (name and equals and folders):
        raise GofError(f"{text}: give NAME=FOLDER,FOLDER with folders that hold scores.json")
    return name, [Scores.read(Path(folder) / "scores.json") for folder in folders.split(",")]


def mean(runs: Sequence[Scores], figure: Callable[[Scores], float | None], digits: int = 3) -> str:
    """Return the mean of a figure over runs, "-" where a run has none."""
    values = [figure(scores) for scores in runs]
    return "-" if None in values else f"{np.mean(values):.{digits}f}"


def pair(runs: Sequence[Scores], of: Callable[[Scores], Any]) -> list[str]:
    """Return L2 and CosSim of a part of the scores, "-" where a run has no such part."""
    return [mean(runs, lambda s, f=figure: getattr(of(s), f, None)) for figure in ("l2", "cos_sim")]


def l2_with_spread(runs: Sequence[Scores]) -> str:
    """Return the mean L2 of DVE, with the standard deviation over several runs."""
    spread = f" ± {np.std([s.dve.l2 for s in runs], ddof=1):.3f}" if len(runs) > 1 else ""
    return mean(runs, lambda s: s.dve.l2) + spread


def by_angle(runs: Sequence[Scores], figure: str, digits: int) -> list[str]:
    """Return the mean figure of the views at each of ANGLES, "-" where there is none."""
    views = [(np.abs(np.subtract(ANGLES, v.angle_deg)).argmin(), getattr(v, figure)) for s in runs for v in s.around]
    found = [[value for k, value in views if k == angle] for angle in range(len(ANGLES))]
    return [f"{np.mean(values):.{digits}f}" if values else "-" for values in found]


def main(argv: list[str] | None = None) -> None:
    """Print a table over all names, one table a name beside its baselines, and the views from all around."""
    config = tyro.cli(RunScores, prog="python -m gof_benchmark.evidence.run_scores", args=argv)
    all_runs = dict(map(read_runs, config.runs))
    scored = {name: runs for name, runs in all_runs.items() if all(s.dve for s in runs)}
    print("| fire | L2 | CosSim | constant: L2, CosSim | mean per height: L2, CosSim | speed / true | PSNR flame |")
    print("|---|---|---|---|---|---|---|")
    for name, runs in scored.items():
        trivial = [", ".join(pair(runs, lambda s, n=n: s.trivial_baselines[n])) for n in ("constant", "height_mean")]
        ours = [l2_with_spread(runs), mean(runs, lambda s: s.dve.cos_sim), *trivial]
        print(f"| {' | '.join([name, *ours, mean(runs, lambda s: s.dve.speed_ratio, 2), mean(runs, _flame, 2)])} |")
    for name, runs in scored.items():
        rows = {
            "this reconstruction": [l2_with_spread(runs), mean(runs, lambda s: s.dve.cos_sim)],
            "trivial baseline: true mean of each height": pair(runs, lambda s: s.trivial_baselines["height_mean"]),
            "this reconstruction, where the fire is": pair(runs, lambda s: s.dve.eve),
            "that baseline, where the fire is": pair(runs, partial(_baseline_of_eve, name="height_mean")),
            "strongest baseline there: true mean of each place": pair(
                runs, partial(_baseline_of_eve, name="mean_field")
            ),
        }
        print(f"\n| {name} | L2 | CosSim |\n|---|---|---|")
        print("\n".join(f"| {row} | {' | '.join(cells)} |" for row, cells in rows.items()))
    for figure, digits in (("psnr_flame", 1), ("gradient_ratio", 2)):
        print(f"\n| {figure} at degrees | {' | '.join(map(str, ANGLES))} |\n|{'---|' * (len(ANGLES) + 1)}")
        for name, runs in all_runs.items():
            if all(s.around for s in runs):
                print(f"| {name}{', sharpness' * (digits == 2)} | {' | '.join(by_angle(runs, figure, digits))} |")


def _flame(scores: Scores) -> float | None:
    return scores.psnr_flame


def _baseline_of_eve(scores: Scores, name: str) -> Agreement | None:
    return scores.dve.eve and scores.dve.eve.baselines.get(name)


if __name__ == "__main__":
    main()
