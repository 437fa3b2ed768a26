"""`gof convert`: any known result to our formats, or to those of other programs."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import tyro

from gof.commands.foreign_options import ForeignOptions
from gof.core.errors import GofError
from gof.core.files import write_json
from gof.dataset import Dataset
from gof.host.terminal import console
from gof.io.convert import convert
from gof.io.importers import Imported, read_result
from gof.io.importers.alignment import align_cameras, read_cameras


@dataclass
class ConvertConfig:
    """Read a result of any known method and write it for gof or for another program.

    The suffix of OUT chooses: .npz (exact), .ply (3DGS attributes, time and velocity), .ftgs.ply (FreeTimeGS players),
    .glb (glTF with KHR_gaussian_splatting at one instant, with velocities); .spz and .sog (one instant, compressed); a
    name without a suffix is a folder of 3DGS PLYs, one for each frame.

    What people type:
      gof convert out/fire/result.npz fire.glb --time 0.15
      gof convert out/fire/result.npz frames --frame-time 0.01 --start 0 --end 0.35
      gof convert chkpnt30000.pth mine.npz --time-unit 0.35 --align sparse/0 --dataset data/fire
    """

    result: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="RESULT")]]
    """File or folder of any method that docs/importers.md lists."""
    out: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="OUT")]]
    """File or folder to write; the suffix says which format. What exists is not replaced."""
    other_method: tyro.conf.OmitArgPrefixes[ForeignOptions]
    frame_time: float | None = None
    """Seconds between two frames, for results that count frames and for a folder of PLYs."""
    time: float | None = None
    """Second of the instant in a .glb, .spz or .sog; default: the middle of the Gaussians' times."""
    start: float | None = None
    """First second of the clip in an .ftgs.ply (time 0) or a folder; default: when the first Gaussian appears."""
    end: float | None = None
    """Last second of the clip in an .ftgs.ply (time 1) or a folder; default: when the last Gaussian is gone."""
    align: Path | None = None
    """The method's own cameras (COLMAP folder, dataset.json, transforms.json, or JSON of name to 4x4
    world_to_camera): the result is moved by the similarity that maps them onto the cameras of --dataset."""
    dataset: Path | None = None
    """The dataset into whose world --align moves the result; its cameras have the same names."""
    json: Path | None = None
    """File to write what was read and written to."""


def _moved(imported: Imported, cameras: Path, dataset: Dataset) -> Imported:
    """A result in the dataset's world."""
    found = align_cameras(read_cameras(cameras), {c.name: c.world_to_camera for c in dataset.cameras})
    moved, notes = imported.gaussians.transformed(found.matrix), (*imported.notes, found.in_words(cameras))
    return replace(imported, gaussians=moved, notes=notes)


def main(argv: list[str]) -> int:
    """The command line of `gof convert`."""
    config = tyro.cli(ConvertConfig, prog="gof convert", args=argv)
    began = time.perf_counter()
    if (config.align is None) != (config.dataset is None):
        raise GofError("--align and --dataset go together: cameras of the method's world, and those to map them onto")
    imported = read_result(config.result, config.other_method.options(config.frame_time))
    if config.align is not None:
        imported = _moved(imported, config.align, Dataset.open(config.dataset))
    made = convert(imported, config.out, config.start, config.end, config.frame_time, config.time)
    seconds = time.perf_counter() - began
    count = len(imported.gaussians)
    out = console()
    out.print(f"{imported.method}: {count} Gaussians from {imported.path} written to {config.out} in {seconds:.1f} s")
    notes = [*imported.notes, *made]
    for note in notes:
        out.print("note:", note, style="yellow")
    if config.json:
        done = {"method": imported.method, "gaussians": count, "notes": notes, "out": str(config.out)}
        write_json(config.json, done | {"seconds": round(seconds, 3)})
    return 0
