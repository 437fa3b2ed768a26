"""`gof study PART`: accuracy against time of one part of the software; each writes its table with --json FILE."""

from __future__ import annotations

from gof.commands import run_part

PARTS = {
    "score": (
        "gof_benchmark.studies.score",
        "the score of one result: orders of quadrature, weights of Gaussians",
    ),
    "generate": (
        "gof_benchmark.studies.generator",
        "a scene: resolution of the simulation, samples per pixel, storage of the velocity",
    ),
    "reconstruct": (
        "gof_benchmark.studies.reconstruction",
        "a reconstruction: presets, steps, Gaussians and picture size, in DVE and PSNR",
    ),
    "ablations": (
        "gof_benchmark.studies.ablations",
        "the method: the paper's NoSync, RandFlow, JointOpt and NoMask, and the paper's own choices",
    ),
}

HELP = """\
usage: gof study PART [OPTIONS]        gof study PART --help explains one study

Measure on this machine what accuracy costs in time. Each study writes tables and charts to --out.
Start a stopped study again, and it continues.

{parts}

examples:
  gof study score out/fire --dataset data/fire --order 3 5
  gof study generate --out out/study_generate
  gof study reconstruct data/fire --out out/settings
  gof study ablations data/fire --out out/ablations
  gof study score out/fire --dataset data/fire --json rows.json       --json also writes the figures to a file
"""


def main(argv: list[str]) -> int:
    """Run one study."""
    return run_part("study", PARTS, HELP, argv)
