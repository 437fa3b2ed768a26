"""The commands: their options, and their output. The work is done by the packages they call.

A package adds commands of its own by an entry point of the group `gof.commands` that names a table like `COMMANDS`.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from difflib import get_close_matches

HELP_WORDS = ("-h", "--help", "--help-all", "help")  # of a command line that asks for help

GROUPS = {
    "make": "a fire to start from, or one with ground truth",
    "film": "your own fire",
    "reconstruct": "",
    "score": "and compare",
    "show": "",
    "publish": "and pass on",
    "help": "",
}


@dataclass(frozen=True)
class Command:
    """One `gof NAME`: where its `main(argv) -> exit status` is, its line in `gof --help`, and where that stands.

    Attributes:
        group: one of GROUPS.
        figures: whether it writes figures with --json.
        foreign: whether all words behind its name are another program's: options of ours stand before it.
    """

    module: str
    help: str
    group: str
    figures: bool = True
    foreign: bool = False


def no_such(kind: str, name: str, known: Iterable[str]) -> str:
    """Return the message on a word that names no command or part: the nearest one that there is, and all."""
    near = get_close_matches(name.lower(), known := list(known), n=1)
    return f"no {kind} '{name}'{f', did you mean {near[0]}? There are' if near else '; there are'}: {', '.join(known)}"


COMMANDS = {
    "sample": Command("gof.commands.sample", "a small fire, a result, a submission, three films: no Blender", "make"),
    "capture": Command("gof.commands.capture", "the camera rig: LED board, frame times, calibration, masks", "film"),
    "ingest": Command("gof.commands.ingest", "videos of a fire -> dataset: plates, camera poses, frame times", "film"),
    "reconstruct": Command("gof.commands.reconstruct", "three videos -> flame Gaussians that move", "reconstruct"),
    "background": Command("gof.commands.background", "the scene without fire as static Gaussians", "reconstruct"),
    "baseline": Command(
        "gof.commands.baseline", "other methods' own training code, without CUDA", "reconstruct", False, True
    ),
    "evaluate": Command(
        "gof.commands.evaluate", "result + ground truth -> DVE, PSNR, SSIM, and trivial baselines", "score"
    ),
    "leaderboard": Command("gof.commands.leaderboard", "evaluated results side by side on one page", "score"),
    "depth": Command("gof.commands.depth", "depth maps of frames, for the scores of depth", "score"),
    "flow": Command("gof.commands.flow", "motion of every pixel by a result, beside the exact optical flow", "score"),
    "report": Command("gof.commands.report", "pictures, scores and costs of a result on one page", "show"),
    "share": Command("gof.commands.share", "results in one HTML file that plays anywhere", "show"),
    "view": Command("gof.commands.view", "a result in the browser, also while it is being made", "show", False),
    "video": Command("gof.commands.video", "results as a film from any view", "show"),
    "figure": Command("gof.commands.figure", "figures for papers, as PDF, SVG or PNG", "show"),
    "convert": Command(
        "gof.commands.convert", "any method's result -> another format; a note of its units and axes", "publish"
    ),
    "pack": Command("gof.commands.pack", "datasets -> archives for a data host", "publish"),
    "unpack": Command("gof.commands.unpack", "archives of gof pack -> datasets", "publish"),
    "doctor": Command("gof.commands.doctor", "check this machine", "help"),
    "completion": Command("gof.commands.completion", "completion of commands and options in a shell", "help", False),
}


# ----------------------------------------------------------------
# Commands of several parts: `gof NAME PART` lists its parts and loads only the part that is run.

Parts = dict[str, tuple[str, str]]  # by name: the module with `main(argv) -> exit status`, and what it does in a line


def run_part(command: str, parts: Parts, text: str, argv: list[str]) -> int:
    """Run the part that the first word names, or print the help: by --help, or where no part is named.

    Args:
        text: the help, in which {parts} stands for a line of each part.
    Returns:
        the part's exit status; 2 where there is no such part.
    """
    if not argv or argv[0] in HELP_WORDS:
        width = max(map(len, parts)) + 1
        print(text.format(parts="\n".join(f"  {name:<{width}} {line}" for name, (_, line) in parts.items())))
        return 0
    if argv[0] not in parts:
        print(f"gof {command}: {no_such('part', argv[0], parts)}; gof {command} --help explains them", file=sys.stderr)
        return 2
    return importlib.import_module(parts[argv[0]][0]).main(argv[1:]) or 0
