"""`gof figure`: lists its parts and loads only the part that is run."""

from __future__ import annotations

from gof.commands import run_part

PARTS = {
    "modalities": (
        "gof.commands.figure_modalities",
        "of one camera and time: picture, plate, mask, depth, optical flow, flow field, seeds, result, velocities",
    ),
    "compare": (
        "gof.commands.figure_compare",
        "results beside what was recorded: pictures, enlarged parts, errors, velocities",
    ),
    "removal": ("gof.commands.figure_removal", "fire removal: picture, plate, what was taken out, what is left"),
}

HELP = """\
gof figure - figures for papers, of your own data: PDF and SVG with letters and lines as vectors, or PNG.

usage: gof figure PART [OPTIONS]        gof figure PART --help explains one part

{parts}

examples:
  gof figure modalities out/fire --dataset data/fire --out modalities.pdf
  gof figure compare ours=out/fire theirs=out/other.ply --dataset data/fire --out compare.pdf
  gof figure removal data/fire --out removal.pdf

With --json FILE every part writes what its tiles show. Films and single panels: gof video.
"""


def main(argv: list[str]) -> int:
    """Make one figure."""
    return run_part("figure", PARTS, HELP, argv)
