"""`gof figure compare`: results side by side with enlarged parts, errors and velocities."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import tyro

from gof.commands.everywhere import beside, require_free, write_figures
from gof.commands.read import Inches, Results, Seconds, named, read_options
from gof.commands.video import camera_number
from gof.core.errors import GofError
from gof.dataset import Dataset
from gof.dataset.leaks import print_of_others
from gof.evaluate.leaderboard import collect
from gof.host.options import require_number
from gof.host.terminal import console
from gof.look.comparison import KINDS, Kind, Moment, comparison, scored_subject, subject
from gof.look.drawing import require_figure
from gof.look.panels import Subject
from gof.look.paper import WIDTH_IN, write_sheet
from gof.look.player.opened import dataset_beside, newest, open_moving
from gof.look.tiles import Box, facts

MOST_PARTS = 4


@dataclass
class CompareConfig:
    """Draw results beside what was recorded: pictures, enlarged parts, errors, velocities.

    Examples:
      gof figure compare ours=out/fire theirs=out/other.ply --dataset data/fire --out compare.pdf
      gof figure compare boards/ours boards/theirs --dataset data/fire --parts 60,120,40,40 --camera cam_0

    Each column is a result, drawn as `gof evaluate` scores it: a flame alone over its plates, another method's
    Gaussians over black. The first column has what was recorded, the error of the plate alone, and the true velocity
    where it is known. The figure is of a held-out frame, unless --time names another.
    """

    results: Results
    """Folders of `gof reconstruct`; folders of `gof evaluate --out`, whose results are read and drawn as they were
    scored; or files of any method of docs/importers.md, in one world and on one clock. The name is what people read,
    default: the folder's."""
    dataset: Path | None = None
    """Dataset folder; default: the one in a demo's folder."""
    out: tuple[Path, ...] = ()
    """Files to write (.pdf, .svg, .png). Default: compare.pdf beside the first result, where an older one is
    replaced."""
    camera: str | None = None
    """Name of the camera; default: the middle one."""
    time: Seconds | None = None
    """On the dataset clock, of which the nearest frame is taken; default: the held-out one with most flame."""
    show: tuple[Kind, ...] = KINDS
    """Rows to show."""
    parts: Annotated[tuple[str, ...], tyro.conf.arg(metavar="N|X,Y,W,H")] = ("2",)
    """Number of enlarged parts, where the results' mean error is largest; or the parts, each as left, top, width and
    height in pixels: 60,120,40,40."""
    width_in: Inches = WIDTH_IN
    """Width of the page."""


def main(argv: list[str]) -> int:
    """Run `gof figure compare`."""
    config = read_options(CompareConfig, "figure compare", argv)
    require_number("--time", config.time)
    count = int(config.parts[0]) if len(config.parts) == 1 and config.parts[0].isdecimal() else None
    require_number("--parts", count, least=0, most=MOST_PARTS)
    require_number("--width-in", config.width_in, least=1, most=100)
    if not config.show:
        raise GofError(f"--show: name at least one of {', '.join(KINDS)}")
    asked = named(config.results)
    folder = config.dataset or dataset_beside(asked[0][1])
    if folder is None:
        raise GofError("name the dataset that the results are of (--dataset)")
    require_free(*config.out)
    files = config.out or (beside(asked[0][1], "compare.pdf"),)
    require_figure(*files)
    dataset = Dataset.open(folder)
    moment = Moment.near(dataset, camera_number(config.camera, dataset), config.time)
    parts = count if count is not None else [_box(words, moment) for words in config.parts]
    print_of_others((newest(path) for _, path in asked), dataset)
    subjects = [_subject(path, name, moment) for name, path in asked]
    rows = comparison(subjects, moment, parts, config.show)
    out = console()
    held_out = "held out" if moment.frame in dataset.test_frames else "NOT held out: methods may have learned from it"
    out.print(f"{moment.camera.name}, frame {moment.frame} at {moment.time_s:.4f} s, {held_out}")
    for one in subjects:
        if one.plate is None and one.gaussians.dynamic.all():
            out.print(
                f"{one.name}: over black, as gof evaluate scores it (a flame alone: gof convert RESULT --flame-only)"
            )
    for file in files:
        write_sheet(file, rows, config.width_in, lettered=False)
        out.print(f"{file}: {len(subjects)} results")
    write_figures({"camera": moment.camera.name, "frame": moment.frame} | facts(rows))
    return 0


def _subject(path: Path, name: str | None, moment: Moment) -> Subject:
    scored = (path / "scores.json").is_file() and not (path / "settings.json").is_file()
    if scored and not (path / "reconstruct").is_dir():
        found = scored_subject(collect([path])[0], moment)
        return replace(found, name=name or found.name)
    opened = open_moving(path, name=name)
    gaussians = opened.gaussians.measured_from(moment.dataset.datum)
    return subject(opened.name, gaussians, opened.method, opened.path, moment, opened.flame_only)


def _box(words: str, moment: Moment) -> Box:
    """Return a part of the picture. Raises GofError: it is not four numbers, or leaves the picture."""
    option = f"--parts {words}"
    try:
        box = Box(*map(int, words.split(",")))
    except (TypeError, ValueError) as e:
        raise GofError(f"{option}: give a number of parts, or each as left,top,width,height: 60,120,40,40") from e
    size = moment.camera.width, moment.camera.height
    if box.width < 1 or box.height < 1 or min(box.x, box.y) < 0:
        raise GofError(f"{option}: left, top, width and height, the last two 1 or more")
    if box.x + box.width > size[0] or box.y + box.height > size[1]:
        raise GofError(f"{option}: leaves the picture, which is {size[0]}x{size[1]}")
    return box
