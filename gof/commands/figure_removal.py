"""`gof figure removal`: picture, plate, what was taken out, and what is left where no fire is."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from gof.commands.video import camera_number
from gof.core.files import write_json
from gof.dataset import Dataset
from gof.host.options import require_number
from gof.host.terminal import console
from gof.look.charts import require_figure
from gof.look.comparison import Moment
from gof.look.fire_removal import fire_removal
from gof.look.paper import WIDTH_IN, write_sheet
from gof.look.player.opened import newest
from gof.look.tiles import facts


@dataclass
class RemovalConfig:
    """Draw how the fire was removed: picture, plate, the light above the plate, and the difference.

    The plate is the dataset's: of `gof ingest` the one it made of the clip, of `gof generate` the scene rendered
    without fire. With --result also the plate in the fire's light, which that reconstruction made of it.

    What people type:
      gof figure removal data/fire --out removal.pdf
      gof figure removal data/fire --result out/fire --camera cam_1 --time 0.11 --out removal.png
    """

    dataset: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="DATASET")]]
    """Dataset folder."""
    result: Path | None = None
    """Folder of a `gof reconstruct` of it."""
    out: tuple[Path, ...] = (Path("removal.pdf"),)
    """Files to write (.pdf, .svg, .png)."""
    camera: str | None = None
    """Name of a camera; default: all, a row each."""
    time: float | None = None
    """Seconds on the dataset clock, of which the nearest frame is taken; default: the held-out one with most flame."""
    width: float = WIDTH_IN
    """Inches of the page."""
    json: Path | None = None
    """Also write frame and tiles, with their figures, to this file."""


def main(argv: list[str]) -> int:
    """The command line of `gof figure removal`."""
    config = tyro.cli(RemovalConfig, prog="gof figure removal", args=argv)
    require_number("--time", config.time)
    require_number("--width", config.width, least=1, most=100)
    require_figure(*config.out)
    dataset = Dataset.open(config.dataset)
    everyone = range(len(dataset.cameras))
    cameras = list(everyone) if config.camera is None else [camera_number(config.camera, dataset)]
    moment = Moment.near(dataset, cameras[len(cameras) // 2], config.time)
    result = None if config.result is None else newest(config.result)
    rows = fire_removal(dataset, moment.frame, cameras, result)
    out = console()
    out.print(f"frame {moment.frame} at {moment.time_s:.4f} s")
    for file in config.out:
        write_sheet(file, rows, config.width)
        out.print(f"{file}: {len(cameras)} cameras")
    if config.json:
        write_json(config.json, {"frame": moment.frame} | facts(rows))
    return 0
