"""`gof benchmark`: lists its parts and loads only the part that is run."""

from __future__ import annotations

from gof.commands import run_part

PARTS = {
    "list": (
        "gof_benchmark.commands.benchmark_list",
        "the scenes: fire, cameras, light, and which are for development",
    ),
    "make": ("gof_benchmark.commands.benchmark_make", "make the scenes of a size, and compare their truth"),
    "add": ("gof_benchmark.commands.benchmark_add", "put a result into a submission: scores, frames, pictures"),
    "check": ("gof_benchmark.commands.benchmark_check", "a submission -> ticks and crosses; a cross refuses it"),
    "score": ("gof_benchmark.commands.benchmark_score", "submissions -> one page: means, intervals, ranks, wins"),
}

HELP = """\
usage: gof benchmark PART [OPTIONS]        gof benchmark PART --help explains one part

GoF-Bench 2, a frozen list of scenes that methods are compared on (docs/benchmark.md).

{parts}

to enter it:
  gof benchmark make bench --size preview                        three small scenes, some minutes
  gof reconstruct bench/preview/demo --out out/demo              or your own method's training
  gof benchmark add out/demo mine --dataset bench/preview/demo   a run into the submission 'mine'
  (write mine/method.json)                                       gof benchmark check says what is missing
  gof benchmark check mine bench/preview
  gof benchmark score mine others bench/preview --out board      board/board.html
"""


def main(argv: list[str]) -> int:
    """Run one part of `gof benchmark`."""
    return run_part("benchmark", PARTS, HELP, argv)
