"""`gof figure compare`: results side by side with enlarged parts, errors and velocities."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import tyro

from gof.commands.foreign_options import ForeignOptions
from gof.commands.video import camera_number
from gof.core.errors import GofError
from gof.core.files import write_json
from gof.dataset import Dataset
from gof.evaluate.leaderboard import collect
from gof.host.options import require_number
from gof.host.terminal import console
from gof.io.importers import ImportOptions
from gof.look.charts import require_figure
from gof.look.comparison import KINDS, Kind, Moment, comparison, scored_subject, subject
from gof.look.panels import Subject
from gof.look.paper import WIDTH_IN, write_sheet
from gof.look.player.opened import dataset_beside, open_moving
from gof.look.tiles import Box, facts

MOST_PARTS = 4


@dataclass
class CompareConfig:
    """Draw results beside what was recorded: pictures, enlarged parts, errors, velocities.

    Each column is a result, drawn as `gof evaluate` scores it: a flame alone over its plates, another method's
    Gaussians over black. The first column has what was recorded, the error of the plate alone, and the true velocity
    where it is known. The figure is of a held-out frame, unless --time names another.

    What people type:
      gof figure compare out/fire out/other.ply --names ours theirs --dataset data/fire --out compare.pdf
      gof figure compare boards/ours boards/theirs --dataset data/fire --box 60 120 40 40 --camera cam_0
    """

    results: tyro.conf.Positional[Annotated[tuple[Path, ...], tyro.conf.arg(metavar="RESULT ...")]]
    """Folders of `gof reconstruct`; folders of `gof evaluate --out`, whose results are read and drawn as they were
    scored; or files of any method of docs/importers.md, in one world and on one clock."""
    other_method: tyro.conf.OmitArgPrefixes[ForeignOptions]
    dataset: Path | None = None
    """Dataset folder; default: the one in a demo's folder."""
    out: tuple[Path, ...] = (Path("compare.pdf"),)
    """Files to write (.pdf, .svg, .png)."""
    camera: str | None = None
    """Name of the camera; default: the middle one."""
    time: float | None = None
    """Seconds on the dataset clock, of which the nearest frame is taken; default: the held-out one with most flame."""
    show: tuple[Kind, ...] = KINDS
    """Which rows."""
    parts: int = 2
    """How many parts are enlarged, where the results' mean error is largest."""
    box: tuple[tuple[int, int, int, int], ...] = ()
    """These parts instead: left, top, width and height in pixels, one after another."""
    names: tuple[str, ...] = ()
    """What the results are called, in their order; default: their folders' names."""
    flame_only: bool = False
    """Other methods' results are flames alone: draw them over the plates too."""
    frame_time: float | None = None
    """Seconds between two frames, for results that count frames."""
    width: float = WIDTH_IN
    """Inches of the page."""
    json: Path | None = None
    """Also write camera, frame and tiles, with their figures, to this file."""


def main(argv: list[str]) -> int:
    """The command line of `gof figure compare`."""
    config = tyro.cli(CompareConfig, prog="gof figure compare", args=argv)
    require_number("--time", config.time)
    require_number("--parts", config.parts, least=0, most=MOST_PARTS)
    require_number("--width", config.width, least=1, most=100)
    if not config.show:
        raise GofError(f"--show: name at least one of {', '.join(KINDS)}")
    if not config.results:
        raise GofError("name a result: a folder of `gof reconstruct`, or a file of a method")
    if config.names and len(config.names) != len(config.results):
        raise GofError(f"--names: {len(config.names)} names for {len(config.results)} results; give one for each")
    folder = config.dataset or dataset_beside(config.results[0])
    if folder is None:
        raise GofError("name the dataset that the results are of (--dataset)")
    require_figure(*config.out)
    dataset = Dataset.open(folder)
    moment = Moment.near(dataset, camera_number(config.camera, dataset), config.time)
    boxes = [_box(numbers, moment) for numbers in config.box]
    options = config.other_method.options(config.frame_time)
    names = config.names or (None,) * len(config.results)
    subjects = [
        _subject(path, name, options, moment, config.flame_only)
        for path, name in zip(config.results, names, strict=True)
    ]
    rows = comparison(subjects, moment, boxes or config.parts, config.show)
    out = console()
    held_out = "held out" if moment.frame in dataset.test_frames else "NOT held out: methods may have learned from it"
    out.print(f"{moment.camera.name}, frame {moment.frame} at {moment.time_s:.4f} s, {held_out}")
    for one in subjects:
        if one.plate is None and one.gaussians.dynamic.all():
            out.print(f"{one.name}: over black, as gof evaluate scores it (--flame-only draws it over the plate)")
    for file in config.out:
        write_sheet(file, rows, config.width, lettered=False)
        out.print(f"{file}: {len(subjects)} results")
    if config.json:
        write_json(config.json, {"camera": moment.camera.name, "frame": moment.frame} | facts(rows))
    return 0


def _subject(path: Path, name: str | None, options: ImportOptions, moment: Moment, flame_only: bool) -> Subject:
    scored = (path / "scores.json").is_file() and not (path / "settings.json").is_file()
    if scored and not (path / "reconstruct").is_dir():
        found = scored_subject(collect([path])[0], moment)
        return replace(found, name=name or found.name)
    opened = open_moving(path, options, name)
    gaussians = opened.gaussians.measured_from(moment.dataset.datum)
    return subject(opened.name, gaussians, opened.method, opened.path, moment, flame_only)


def _box(numbers: tuple[int, int, int, int], moment: Moment) -> Box:
    box, size = Box(*numbers), (moment.camera.width, moment.camera.height)
    if box.width < 1 or box.height < 1 or min(box.x, box.y) < 0:
        raise GofError(f"--box {' '.join(map(str, numbers))}: left, top, width and height, the last two 1 or more")
    if box.x + box.width > size[0] or box.y + box.height > size[1]:
        raise GofError(f"--box {' '.join(map(str, numbers))}: leaves the picture, which is {size[0]}x{size[1]}")
    return box
