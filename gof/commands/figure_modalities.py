"""`gof figure modalities`: all that a method sees and makes of one picture, side by side."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import tyro

from gof.commands.everywhere import beside, require_free, write_figures
from gof.commands.read import Inches, Seconds, read_options
from gof.commands.video import camera_number
from gof.core.errors import GofError
from gof.dataset import Dataset
from gof.host.options import require_number
from gof.host.terminal import console, progress_bar
from gof.look.drawing import require_figure
from gof.look.modalities import Sources, modalities, training_frame
from gof.look.paper import WIDTH_IN, write_sheet
from gof.look.player.opened import dataset_beside
from gof.look.tiles import facts
from gof.reconstruct.run_inputs import recompute_inputs

PORTRAIT, LANDSCAPE = 6, 4  # tiles in a row


@dataclass
class ModalitiesConfig:
    """Draw what a method sees and makes of one camera's picture: the paper's figure of modalities, of your own data.

    Examples:
      gof figure modalities out/demo                                       a demo's, modalities.pdf beside its result
      gof figure modalities out/fire --dataset data/fire --camera cam_1 --time 0.11 --out modalities.png

    Picture, plate, flame mask, depth (stereo; monocular with a checkpoint; depth maps where there are
    such), optical flow, fused flow field, seeds, result, its velocity and, of a simulated fire, the true one.
    Tiles of the stages before the Gaussians are computed again by the run's own settings: seconds to minutes. Tiles
    that cannot be made are left out, with the reason.
    """

    FIRST: ClassVar = ("dataset", "out", "camera", "time", "depth", "columns", "width_in")

    result: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="RESULT")]]
    """Folder of a `gof reconstruct`, finished or not, or of a `gof demo`."""
    dataset: Path | None = None
    """Dataset folder it is of; default: the one in a demo's folder."""
    out: tuple[Path, ...] = ()
    """Files to write (.pdf, .svg, .png). Default: modalities.pdf in the folder of the reconstruction, where an older
    one is replaced."""
    camera: str | None = None
    """Name of the camera; default: the middle one."""
    time: Seconds | None = None
    """On the dataset clock, of which the nearest training frame is taken; default: the brightest one."""
    depth: tuple[Path, ...] = ()
    """Folders of `gof depth --all-frames`, for the depth of this very frame, and of a Depth-Anything-V2 checkpoint, for
    monocular depth; never downloaded."""
    flow_weights: Path | None = None
    """Folder of the MEMFOF checkpoint, where the run had --flow memfof."""
    columns: int | None = None
    """Tiles in a row; default at most 6 of upright pictures, else 4."""
    width_in: Inches = WIDTH_IN
    """Width of the page."""


def main(argv: list[str]) -> int:
    """Run `gof figure modalities`."""
    config = read_options(ModalitiesConfig, "figure modalities", argv)
    require_number("--time", config.time)
    require_number("--columns", config.columns, least=1, most=12)
    require_number("--width-in", config.width_in, least=1, most=100)
    run = run_folder(config.result)
    folder = config.dataset or dataset_beside(run)
    if folder is None:
        raise GofError(f"{run}: name the dataset it was made of (--dataset)")
    require_free(*config.out)
    files = config.out or (beside(run, "modalities.pdf"),)
    require_figure(*files)
    dataset = Dataset.open(folder)
    camera = camera_number(config.camera, dataset)
    frame = training_frame(dataset, camera, config.time)
    with progress_bar("modalities") as progress:
        inputs = recompute_inputs(dataset, run, config.flow_weights, progress)
    found = modalities(dataset, inputs, Sources(run, *depth_sources(config.depth)), camera, frame)
    view = dataset.cameras[camera]
    columns = config.columns or even(len(found.tiles), PORTRAIT if view.height > view.width else LANDSCAPE)
    rows = [found.tiles[k : k + columns] for k in range(0, len(found.tiles), columns)]
    out = console()
    out.print(f"{view.name}, frame {frame} at {dataset.camera_times_s(camera)[frame]:.4f} s")
    for name, why in found.missing.items():
        out.print(f"left out: {name} ({why})")
    for file in files:
        write_sheet(file, rows, config.width_in)
        out.print(f"{file}: {len(found.tiles)} pictures")
    write_figures({"camera": view.name, "frame": frame} | facts(rows) | {"left_out": found.missing})
    return 0


def depth_sources(folders: tuple[Path, ...]) -> tuple[Path | None, Path | None]:
    """Return the folder of a checkpoint, and that of `gof depth`. Raises GofError: a folder is neither, or two are
    one."""
    found: dict[str, Path] = {}
    for folder in folders:
        kinds = [k for k, name in (("weights", "model.safetensors"), ("maps", "depth")) if (folder / name).exists()]
        if len(kinds) != 1 or kinds[0] in found:
            raise GofError(f"--depth {folder}: give one folder of gof depth (depth/ in it), and one with a checkpoint")
        found[kinds[0]] = folder
    return found.get("weights"), found.get("maps")


def even(count: int, most: int) -> int:
    """Return columns of as few rows as `most` columns make, so filled that the last row is not left nearly empty."""
    return math.ceil(count / math.ceil(count / most))


def run_folder(path: Path) -> Path:
    """Return the folder of the reconstruction that a user means by it, or by a demo's folder."""
    if path.is_file() and (path.parent / "settings.json").is_file():  # its result.npz
        return path.parent
    inner = path / "reconstruct"
    return inner if not (path / "settings.json").is_file() and (inner / "settings.json").is_file() else path
