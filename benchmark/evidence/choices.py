"""The worth of each choice of the method today: ours, and ours with one choice after another undone; and the paper's.

    python -m gof_benchmark.evidence.choices DATASET [--out out/choices] [--only "paper's fusion" ...] [--json FILE]

Takes about half a minute a row.

DATASET has true velocity (`gof generate demo`). Every row is a reconstruction by `gof reconstruct`'s own code, with one
field of `gof.reconstruct.methods.OURS` or of its PAPER changed; its folder is OUT/NAME, and finished rows are kept.
Scores are those of `gof evaluate`, at the size of the pictures that are reconstructed. "sides" is the flame's PSNR over
views more than 45 degrees from every given one; "light" the correlation of its light in space with the true one.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
import tyro

from gof.core.errors import GofError
from gof.core.files import read_json, write_json
from gof.dataset import Dataset
from gof.evaluate import evaluate
from gof.evaluate.scores import Scores
from gof.reconstruct.methods import METHODS, OURS, PAPER, Method
from gof.reconstruct.pipeline import reconstruct
from gof.reconstruct.presets import Effort
from gof.reconstruct.settings import ReconstructionSettings
from gof.reconstruct.shrink import shrink

# ----------------------------------------------------------------
# How much work the reconstructions are that evidence compares with each other.

SMALL = Effort(iterations=800, gaussians=15_000, voxels=72, longest_side=160)
"""Under a minute each of two free cores on the demo."""

SIDE_DEG = 45.0


def _seeding(**fields) -> Method:
    return replace(OURS, seeding=replace(OURS.seeding, **fields))


def _rates(**fields) -> Method:
    return replace(OURS, rates=replace(OURS.rates, **fields))


def _one_velocity(times: float) -> Method:
    """Return the method as it was before gas and light had a velocity each: it hardly moves in the optimisation, times
    1."""
    return replace(OURS, gas_apart=False, rates=replace(OURS.rates, velocity=0.0002 * times))


ROWS: dict[str, Method] = {
    "ours": OURS,
    "no flow prior": replace(OURS, flow_prior=False),
    "paper's fusion": replace(OURS, fusion="paper"),
    "no smoothing of the fused flow": replace(OURS, smooth_voxels=0.0),
    "flow of the pictures, to the next frame": replace(OURS, flow_of_light=False),
    "flame is where the flow is": replace(OURS, flow_masks=True),
    "two cameras are enough": replace(OURS, vetoes=False),
    "tomography from the whole hull": replace(OURS, round_flame=False),
    "bright flame alone": replace(OURS, faint_flame=False),
    "plates in the dark": replace(OURS, lit_plates=False, faint_flame=False),
    "plates stay as they are": _rates(plate=0.0),
    "rates that do not fall": _rates(held=None),
    "seeds in half of the voxels": _seeding(by_emission=False),
    "lives of four frame times": _seeding(short_lives=False),
    "seeds of opacity 0.4": _seeding(opacity=PAPER.seeding.opacity),
    "whole pictures": replace(OURS, windows=False),
    "Gaussians cloned, split and pruned": replace(OURS, density_control=True, windows=False),
    "colours of any brightness": replace(OURS, color_of_light=False),
    "nothing holds what no camera sees": replace(OURS, unseen=0.0),
    "free colours, and nothing holds": replace(OURS, color_of_light=False, unseen=0.0),
    "no squared differences": replace(OURS, square_loss=0.0),
    "Adam remembers as usual": _rates(beta_1=PAPER.rates.beta_1, beta_2=PAPER.rates.beta_2),
    "one velocity for gas and light": _one_velocity(1),
    "one velocity, learnt ten times as fast": _one_velocity(10),
    "one velocity, learnt forty times as fast": _one_velocity(40),
    "the paper's method": PAPER,
    "the paper's method without density control": replace(PAPER, density_control=False),
}


@dataclass(frozen=True)
class Choices:
    """Undo one choice of the method at a time. Prints a table."""

    dataset: tyro.conf.Positional[Path]
    """Dataset folder with true velocity."""
    out: Path = Path("out/choices")
    """Folder for the reconstructions; finished ones are kept."""
    only: tuple[str, ...] = ()
    """Names of rows; all of them without."""
    effort: tyro.conf.OmitArgPrefixes[Effort] = SMALL
    """For every reconstruction."""
    seed: int = 0
    json: Path | None = None
    """Also write the figures to this file."""


@dataclass(frozen=True)
class ChoiceScores:
    """A reconstruction's scores; None where the dataset has no truth of their kind.

    Attributes:
        l2, cos_sim: of DVE.   eve_l2: where the fire is.   psnr_flame: dB, held-out pictures of given cameras.
        psnr_sides: dB, of views more than SIDE_DEG from every given one.   light: correlation of light in space.
        seconds: of the reconstruction.
    """

    name: str
    l2: float
    cos_sim: float
    eve_l2: float | None
    psnr_flame: float | None
    psnr_sides: float | None
    light: float | None
    seconds: float

    @classmethod
    def of(cls, name: str, scores: Scores, seconds: float) -> ChoiceScores:
        """Return those of a row that are in a result's scores. Raises GofError: the dataset has no true velocity."""
        if scores.dve is None:
            raise GofError("choices: DATASET has no true velocity; `gof generate` makes one that has")
        sides = [view.psnr_flame for view in scores.around if view.angle_deg > SIDE_DEG]
        return cls(
            name,
            scores.dve.l2,
            scores.dve.cos_sim,
            scores.dve.eve.l2 if scores.dve.eve else None,
            scores.psnr_flame,
            float(np.mean(sides)) if sides else None,
            scores.light.correlation if scores.light else None,
            seconds,
        )

    def __str__(self) -> str:
        figures = (self.l2, 3), (self.cos_sim, 3), (self.eve_l2, 3), (self.psnr_flame, 2), (self.psnr_sides, 2)
        cells = ["-" if value is None else f"{value:.{n}f}" for value, n in (*figures, (self.light, 2))]
        return f"| {self.name} | {' | '.join(cells)} | {self.seconds:.0f} |"


def main(argv: list[str] | None = None) -> None:
    """Print the table."""
    config = tyro.cli(Choices, prog="python -m gof_benchmark.evidence.choices", args=argv)
    unknown = sorted(set(config.only) - ROWS.keys())
    if unknown:
        raise GofError(f"--only {unknown}: no such rows; there are {list(ROWS)}")
    dataset = Dataset.open(config.dataset)
    print("| choice undone | L2 | CosSim | EVE L2 | PSNR flame | sides | light | seconds |")
    print("|---|---|---|---|---|---|---|---|")
    rows = []
    for name in config.only or ROWS:
        rows.append(run_one(dataset, name, config))
        print(rows[-1], flush=True)
    if config.json:
        write_json(config.json, [asdict(row) for row in rows])


def run_one(dataset: Dataset, name: str, config: Choices) -> ChoiceScores:
    """Reconstruct by the row's method and score; kept when it is there already."""
    folder = config.out / name.replace(" ", "_").replace("'", "").replace(",", "")
    settings = ReconstructionSettings.of(dataset, config.effort, seed=config.seed, scene=ROWS[name].scene)
    known = folder / "row.json"
    with patch.dict(METHODS, gof=ROWS[name]):
        result = reconstruct(dataset, settings, folder)  # refuses a row of another dataset or effort
    if not known.exists():
        scores = evaluate(result.path, shrink(dataset, config.effort.longest_side))
        seconds = sum(stage.seconds for stage in result.stages)
        write_json(known, asdict(ChoiceScores.of(name, scores, seconds)))
    return ChoiceScores(**read_json(known))


if __name__ == "__main__":
    main()
