"""`gof study WHAT`: accuracy against time of one part of the software; each writes its table with --json FILE."""

from __future__ import annotations

import importlib
from dataclasses import dataclass

from gof.commands import HELP_WORDS, no_such
from gof.core.errors import GofError


@dataclass(frozen=True)
class Study:
    """One `gof study NAME`: where its `main(argv) -> exit status` is, what it finds out, and how it is called."""

    module: str
    help: str
    example: str


STUDIES = {
    "dve": Study(
        "gof_benchmark.studies.dve",
        "the score: quadrature order, grid resolution, precision, Monte Carlo, against closed forms",
        "gof study dve",
    ),
    "score": Study(
        "gof_benchmark.studies.score",
        "the score of one result: orders of quadrature, weights of Gaussians",
        "gof study score out/fire --dataset data/fire --order 3 5",
    ),
    "generate": Study(
        "gof_benchmark.studies.generator",
        "a scene: resolution of the simulation, samples per pixel, storage of the velocity",
        "gof study generate --out out/study_generate",
    ),
    "reconstruct": Study(
        "gof_benchmark.studies.reconstruction",
        "a reconstruction: presets, steps, Gaussians and picture size, in DVE and PSNR",
        "gof study reconstruct data/fire --out out/settings",
    ),
    "ablations": Study(
        "gof_benchmark.studies.ablations",
        "the method: the paper's NoSync, RandFlow, JointOpt and NoMask, and the paper's own choices",
        "gof study ablations data/fire --out out/ablations",
    ),
}

HELP = """\
usage: gof study WHAT [OPTIONS]        gof study WHAT --help explains one study

What accuracy costs in time: each study measures it on this machine and writes tables and charts to --out.
A study that was stopped goes on where it was.

{studies}

examples:
{examples}
  gof study dve --gaussians 2000 --json rows.json       a quick look; --json also writes the figures to a file
"""


def main(argv: list[str]) -> int:
    """Run the study that the first argument names; each explains itself with --help.

    Raises:
        GofError: no study of that name.
    """
    if argv and argv[0] in HELP_WORDS:
        studies = "\n".join(f"  {name:<12} {study.help}" for name, study in STUDIES.items())
        examples = "\n".join(f"  {study.example}" for study in STUDIES.values())
        print(HELP.format(studies=studies, examples=examples))
        return 0
    if not argv or argv[0] not in STUDIES:
        named = no_such("study", argv[0], STUDIES) if argv else f"name what to study: {', '.join(STUDIES)}"
        raise GofError(f"{named}; gof study --help explains them")
    return importlib.import_module(STUDIES[argv[0]].module).main(argv[1:]) or 0
