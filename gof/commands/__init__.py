"""The commands: what each is asked and what it prints. The work is done by the rooms they call.

A package adds commands of its own by an entry point of the group `gof.commands` that names a table like `COMMANDS`.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from difflib import get_close_matches


@dataclass(frozen=True)
class Command:
    """One `gof NAME`: where its `main(argv) -> exit status` is, what `gof --help` says, and where it says it."""

    module: str
    help: str
    place: int
    """Commands are listed in this order, which is that of the work."""


def no_such(kind: str, name: str, known: Iterable[str]) -> str:
    """What to say of a word that names no command or part: the nearest one that there is, and all."""
    near = get_close_matches(name.lower(), known := list(known), n=1)
    return f"no {kind} '{name}'{f', did you mean {near[0]}? There are' if near else '; there are'}: {', '.join(known)}"


COMMANDS = {
    "sample": Command(
        "gof.commands.sample", "a small fire, a result, a submission and three films to start from, without Blender", 5
    ),
    "ingest": Command(
        "gof.commands.ingest", "videos of a fire -> dataset: fire-free plates, camera poses, frame times", 30
    ),
    "background": Command(
        "gof.commands.background", "the scene without fire as static Gaussians, for views no camera took", 40
    ),
    "reconstruct": Command("gof.commands.reconstruct", "three videos -> transient flame Gaussians with velocities", 50),
    "depth": Command(
        "gof.commands.depth", "depth maps of a dataset's frames, for the scores of depth of gof evaluate", 55
    ),
    "evaluate": Command(
        "gof.commands.evaluate", "result + ground truth -> DVE, PSNR, SSIM, and controls to compare with", 60
    ),
    "convert": Command(
        "gof.commands.convert",
        "any method's result -> .npz, .ply, .ftgs.ply, .glb, .spz, .sog or PLYs by frame, in metres, seconds and m/s",
        70,
    ),
    "baseline": Command(
        "gof.commands.baseline", "other methods' own training code, unmodified, without CUDA: for their rows", 75
    ),
    "leaderboard": Command(
        "gof.commands.leaderboard", "evaluated results side by side: table, stream plots, accuracy against time", 80
    ),
    "view": Command(
        "gof.commands.view", "result in the browser, in 3D with a time slider; also while it is being optimised", 110
    ),
    "share": Command(
        "gof.commands.share", "results in one HTML file that plays anywhere, to send to somebody; side by side", 105
    ),
    "video": Command(
        "gof.commands.video", "results as a film from any view: picture, depth, velocity, side by side", 108
    ),
    "figure": Command(
        "gof.commands.figure",
        "figures for papers, of your own data: what a method sees and makes, as PDF, SVG or PNG",
        109,
    ),
    "capture": Command(
        "gof.commands.capture", "the camera rig: LED board, frame times from footage, calibration, board masks", 120
    ),
    "pack": Command("gof.commands.pack", "datasets -> archives for a data host: checksums, a card, a licence", 125),
    "unpack": Command("gof.commands.unpack", "archives of gof pack -> datasets, every file compared", 126),
    "report": Command(
        "gof.commands.report", "pictures, animation, scores and costs on one self-contained HTML page", 130
    ),
    "doctor": Command(
        "gof.commands.doctor", "check this machine: Blender, Mantaflow, Dr.Jit, CUDA, OpenEXR, disk, weights", 140
    ),
}
