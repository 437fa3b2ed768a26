"""`gof figure removal`: picture, plate, what was taken out, and what is left where no fire is."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from gof.commands.everywhere import next_to, require_free, write_figures
from gof.commands.read import Inches, Seconds, read_options
from gof.commands.video import camera_number
from gof.dataset import Dataset
from gof.dataset.plates import has_own_plate
from gof.host.options import require_number
from gof.host.terminal import console
from gof.look.comparison import Moment, fire_removal
from gof.look.drawing import require_figure
from gof.look.paper import WIDTH_IN, write_sheet
from gof.look.player.opened import require_result
from gof.look.tiles import facts


@dataclass
class RemovalConfig:
    """Draw how the fire was removed: picture, plate, the light above the plate, and the difference.

    Examples:
      gof figure removal data/fire
      gof figure removal data/fire --result out/fire --camera cam_1 --time 0.11 --out removal.png

    The plate is the dataset's: of `gof ingest` the one it made of the clip, of `gof generate` the scene rendered
    without fire. With --result also the plate in the fire's light, which that reconstruction made of it.
    """

    dataset: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="DATASET")]]
    """Dataset folder."""
    result: Path | None = None
    """Folder of a `gof reconstruct` of it."""
    out: tuple[Path, ...] = ()
    """Files to write (.pdf, .svg, .png). Default: DATASET_removal.pdf beside the dataset, where an older one is
    replaced."""
    camera: str | None = None
    """Name of a camera; default: all, a row each."""
    time: Seconds | None = None
    """On the dataset clock, of which the nearest frame is taken; default: the held-out one with most flame."""
    width_in: Inches = WIDTH_IN
    """Width of the page."""


def main(argv: list[str]) -> int:
    """Run `gof figure removal`."""
    config = read_options(RemovalConfig, "figure removal", argv)
    require_number("--time", config.time)
    require_number("--width-in", config.width_in, least=1, most=100)
    require_free(*config.out)
    files = config.out or (next_to(config.dataset, "_removal.pdf"),)
    require_figure(*files)
    result = None if config.result is None else require_result(config.result)
    dataset = Dataset.open(config.dataset)
    everyone = range(len(dataset.cameras))
    cameras = list(everyone) if config.camera is None else [camera_number(config.camera, dataset)]
    moment = Moment.near(dataset, cameras[len(cameras) // 2], config.time)
    rows = fire_removal(dataset, moment.frame, cameras, result)
    out = console()
    out.print(f"frame {moment.frame} at {moment.time_s:.4f} s")
    bare = (
        []
        if result is None
        else [dataset.cameras[c].name for c in cameras if not has_own_plate(result, dataset.cameras[c].name)]
    )
    notes = [f"{result} has no plates of its own beside it for {', '.join(bare)}: the dataset's are shown"] * bool(bare)
    for note in notes:
        out.print("note:", note, style="yellow")
    for file in files:
        write_sheet(file, rows, config.width_in)
        out.print(f"{file}: {len(cameras)} cameras")
    write_figures({"frame": moment.frame, "notes": notes} | facts(rows))
    return 0
