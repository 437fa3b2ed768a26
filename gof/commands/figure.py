"""`gof figure`: names its parts and loads only the one that is asked for."""

from __future__ import annotations

import importlib
import sys

from gof.commands import HELP_WORDS, no_such

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
    if not argv or argv[0] in HELP_WORDS:
        print(HELP.format(parts="\n".join(f"  {name:<11} {text}" for name, (_, text) in PARTS.items())))
        return 0
    if argv[0] not in PARTS:
        print(f"gof figure: {no_such('part', argv[0], PARTS)}", file=sys.stderr)
        return 2
    return importlib.import_module(PARTS[argv[0]][0]).main(argv[1:]) or 0
