"""The table of scores: a result above what it has to beat, for a page and for LaTeX."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import NamedTuple

from gof.evaluate.eve import BASELINES
from gof.evaluate.leaderboard import COLUMNS
from gof.evaluate.scores import Agreement, ClipScore, EveFigures, Scores
from gof.evaluate.trivial_baselines import TRIVIAL_BASELINES

Figures = dict[str, float | None]

OWN = "this reconstruction"
PLAIN = {  # the trivial baselines' names in words
    "zero": "standing still",
    "random": "its speeds, in random directions",
    "shuffled": "its velocities, dealt out at random",
    "light": "motion of its light, not of its gas",
    "constant": "one constant vector",
    "height_mean": "mean true velocity of each height",
    "mean_field": "mean true velocity of each place",
    "true_centre": "true velocity at each centre",
}
EVE, DVE, PICTURES = ("eve_l2", "eve_cos"), ("l2", "cos_sim"), ("psnr_flame", "ssim_flame", "psnr", "ssim")
OTHERS = {
    "_plate": ("background alone", "what a result without any flame would show"),
    "_between": ("two frames around", "of the very camera, carried half way along their optical flow: what 2D can do"),
}
WITHOUT_MEAN = (
    "EVE: without each place's own mean over time; DVE: without the mean of each height. "
    "Every steady flow has 1 and 0 there"
)
IN_LATEX = {
    "±": r"$\pm$",
    "↓": r"$\downarrow$",
    "↑": r"$\uparrow$",
    "L2": "$L_2$",
    "\N{NO-BREAK SPACE}": " ",
}


class Cell(NamedTuple):
    """A figure in words, and whether a baseline is better there than the result."""

    text: str
    beats: bool = False


@dataclass(frozen=True)
class ScoreRow:
    """A row: its name, a sentence about it, and its cells in the order of the headings."""

    name: str
    meaning: str
    cells: list[Cell]
    own: bool = False


@dataclass(frozen=True)
class ScoreTable:
    """Headings with their units and the direction that is better, and rows, the result first."""

    headings: list[str] = field(default_factory=list)
    rows: list[ScoreRow] = field(default_factory=list)

    @property
    def is_beaten(self) -> bool:
        """Whether a baseline is better in any column."""
        return any(cell.beats for row in self.rows for cell in row.cells)

    @classmethod
    def of(cls, scores: Scores) -> ScoreTable:
        """Make the table of the scores that there are; without any it has no rows."""
        dve = scores.dve
        keys = [*(EVE if dve and dve.eve else ()), *(DVE if dve else ()), *(PICTURES if scores.images else ())]
        if not keys:
            return cls()
        own = _velocities(dve.eve if dve else None, dve) | {key: getattr(scores, key) for key in PICTURES}

        def row(name: str, meaning: str, figures: Figures, spread: Figures | None = None, judged: bool = False):
            return ScoreRow(name, meaning, [_cell(key, figures, spread or {}, own if judged else {}) for key in keys])

        first = row(OWN, "", own)
        rows = [ScoreRow(OWN, "", [Cell(cell.text or "n/a") for cell in first.cells], own=True)]
        rows += [row(*parts) for parts in _parts(scores)]
        eve = dve.eve.baselines if dve and dve.eve else {}
        for name in PLAIN:
            if name in scores.trivial_baselines or name in eve:
                meaning = TRIVIAL_BASELINES.get(name) or BASELINES[name]
                figures = _velocities(eve.get(name), scores.trivial_baselines.get(name))
                rows.append(row(PLAIN[name], meaning, figures, judged=True))
        for suffix, (name, meaning) in OTHERS.items():
            figures = {key: getattr(scores, key + suffix) for key in PICTURES}
            if scores.images and any(value is not None for value in figures.values()):
                rows.append(row(name, meaning, figures, judged=True))
        return cls([_heading(key) for key in keys], rows)

    def latex(self, about: str) -> str:
        """Return a whole tabular, which needs no package; `about` stands before it as a comment."""
        lines = [["velocities and pictures", *self.headings]]
        lines += [[row.name, *(cell.text for cell in row.cells)] for row in self.rows]
        head, own, *others = [" & ".join(_in_latex(word) for word in line) + r" \\" for line in lines]
        columns = "l" + "r" * len(self.headings)
        return "\n".join(
            [
                f"% {' '.join(about.split())}; L2, CosSim and SSIM have no unit",
                rf"\begin{{tabular}}{{{columns}}}",
                *(r"\hline", head, r"\hline", own, *others, r"\hline"),
                r"\end{tabular}",
            ]
        )


def _velocities(eve: EveFigures | Agreement | None, dve: ClipScore | Agreement | None) -> Figures:
    both = [(EVE, eve), (DVE, dve)]
    return {key: value for keys, of in both if of for key, value in zip(keys, (of.l2, of.cos_sim), strict=True)}


def _parts(scores: Scores) -> list[tuple]:
    """Return the result's own further rows: single frames and pictures, and what is left without the mean motion."""
    dve, images = scores.dve, scores.images
    means: Figures = {}
    spread: Figures = {}
    counted = []
    if dve:
        means |= dict(zip(DVE, (dve.l2_frame_mean, dve.cos_sim_frame_mean), strict=True))
        spread |= dict(zip(DVE, (dve.l2_frame_std, dve.cos_sim_frame_std), strict=True))
        counted.append(f"mean and spread of {dve.frames_scored} frames")
    if images:
        spread |= {key: getattr(images, f"{key}_std") for key in PICTURES}
        counted.append(f"spread of {images.count} pictures")
    rows: list[tuple] = [("single frames and pictures", "; ".join(counted), means, spread)]
    if dve:
        left = _velocities(dve.eve.fluctuation if dve.eve else None, Agreement.of(dve.fluctuation))
        rows.append(("without the mean motion", WITHOUT_MEAN, left))
    return rows


def _cell(key: str, figures: Figures, spread: Figures, own: Figures) -> Cell:
    value, kept, mine = figures.get(key), COLUMNS[key], own.get(key)
    words = "" if value is None else f"{value:{kept.format}}"
    if spread.get(key) is not None:
        words += f" ± {spread[key]:{kept.format}}"
    beats = value is not None and mine is not None and kept.better * (value - mine) > 0
    return Cell(words.strip(), beats)


def _heading(key: str) -> str:
    return f"{COLUMNS[key].heading}\N{NO-BREAK SPACE}{'↓' if COLUMNS[key].better < 0 else '↑'}"


def _in_latex(words: str) -> str:
    return re.sub("|".join(map(re.escape, IN_LATEX)), lambda found: IN_LATEX[found[0]], words)
