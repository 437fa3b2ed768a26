"""`gof flow`: motion of every pixel by a result, as files, and beside the exact optical flow of a simulated fire."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import tyro
from rich.table import Table

from gof.commands.everywhere import beside, require_free, write_figures
from gof.commands.read import read_options
from gof.core.errors import GofError
from gof.dataset import Dataset
from gof.dataset.leaks import print_of_others
from gof.evaluate.flow import CameraFrames, FlowScores, score_views, views
from gof.host.terminal import console, progress_bar
from gof.look.flow import FlowFile, write_views
from gof.look.player.opened import newest, open_moving

UNIT = "pixels per frame, right and down"


@dataclass
class FlowConfig:
    """Write how every pixel moves by a result, seen by a dataset's cameras, and score it against the simulation.

    Examples:
      gof flow out/fire --dataset data/fire
      gof flow out/fire --dataset data/fire --cameras cam_1 --all-frames --files flo png --out out/fire_flow

    A pixel moves as the Gaussians that it shows, each by its velocity times the derivative of the projection, weighted
    as their colours are. OUT/CAMERA/000000.exr holds the channels flow.X and flow.Y, in pixels per frame to the right
    and down, and weight, the flame's opacity; .flo is Middlebury's; a .png shows direction as hue and speed as
    brightness, with the true motion right of it. The command prints the frame time, which makes px/s of them.

    Where the dataset has exact optical flow (`ground_truth: flow` in the scene of gof generate) the errors inside the
    flame masks are printed: end-point error, Fl-all of KITTI, angular error of Barron; and those of two trivial
    baselines, no motion and each camera's mean true motion.
    """

    FIRST: ClassVar = ("dataset", "out", "cameras", "all_frames", "files")

    result: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="RESULT")]]
    """Folder of `gof reconstruct`, or a file of any method that docs/importers.md lists."""
    dataset: Path
    """Dataset folder: its cameras and frame times, and the true motion."""
    out: Path | None = None
    """Folder for the files; default: the folder flow beside the result."""
    cameras: tuple[str, ...] = ()
    """Names of cameras, of every role; default: all."""
    all_frames: bool = False
    """All frames, not the held-out ones alone."""
    files: tuple[FlowFile, ...] = ("exr", "png")
    """Kinds of files to write."""


def main(argv: list[str]) -> int:
    """Run `gof flow`."""
    config = read_options(FlowConfig, "flow", argv)
    dataset = Dataset.open(config.dataset)
    frame_time_s = dataset.frame_time_s
    if not frame_time_s:
        raise GofError(f"{config.dataset}: has a single frame, and motion is counted per frame")
    frames = range(len(dataset.times_s)) if config.all_frames else dataset.test_frames
    if not frames:
        raise GofError(f"{config.dataset}: no frame is held out; give --all-frames")
    chosen = _choose(views(dataset, frames), config)
    out_folder = config.out or beside(newest(config.result), "flow")
    require_free(out_folder)
    result = open_moving(config.result)
    print_of_others([result.path], dataset)
    gaussians = result.gaussians.measured_from(dataset.datum)
    with progress_bar("flow") as progress:
        longest = write_views(gaussians, chosen, out_folder, config.files, progress)
    out = console()
    count = sum(len(view.frames) for view in chosen)
    out.print(f"{count} pictures of {len(chosen)} cameras -> {out_folder}: {UNIT}; one frame is {frame_time_s:.6g} s")
    if "png" in config.files:
        out.print(f"full brightness in the pictures: {longest:.4g} px/s ({longest * frame_time_s:.4g} px per frame)")
    with progress_bar("errors") as progress:
        scores = score_views(gaussians, chosen, progress)
    if scores is None:
        out.print("no errors: the dataset has no exact optical flow of these pictures (ground_truth: flow)")
    else:
        out.print(motion_table(scores))
    figures = {"out": str(out_folder), "unit": UNIT, "frame_time_s": frame_time_s, "pictures": count}
    write_figures(figures | {"full_brightness_px_s": longest, "scores": scores and asdict(scores)})
    return 0


def _choose(found: list[CameraFrames], config: FlowConfig) -> list[CameraFrames]:
    """Return the views of the cameras that were named, or of all, which have pictures of the frames.

    Raises:
        GofError: there is no such camera, or none has such a frame.
    """
    names = {view.name for view in found}
    unknown = [name for name in config.cameras if name not in names]
    if unknown:
        raise GofError(f"--cameras {unknown[0]}: {config.dataset} has {', '.join(view.name for view in found)}")
    chosen = [view for view in found if view.frames and (not config.cameras or view.name in config.cameras)]
    if not chosen:
        raise GofError(f"{config.dataset}: those cameras have no picture of these frames; try --all-frames")
    return chosen


def motion_table(scores: FlowScores) -> Table:
    """Return the errors of motion, with those of two trivial baselines."""
    title = (
        f"Motion inside the flame: {scores.result.pixels:,} pixels of {scores.pictures} pictures; the result draws "
        f"something in {scores.covered:.1%} of them"
    )
    table = Table(title=title, title_justify="left")
    table.add_column("motion")
    for column in ("end-point error (px per frame)", "(px/s)", "Fl-all", "angular error (degrees)"):
        table.add_column(column, justify="right")
    rows = {"the result's": scores.result, "trivial: none": scores.zero, "trivial: true mean": scores.mean}
    for name, score in rows.items():
        per_second = score.epe_px / scores.frame_time_s
        table.add_row(
            name, f"{score.epe_px:.3f}", f"{per_second:.1f}", f"{score.fl_all:.1%}", f"{score.angular_deg:.2f}"
        )
    return table
