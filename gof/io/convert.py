"""`gof convert`: any known result to our formats, or to FTGS-PLY for the FreeTimeGS players."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from gof.errors import DataFormatError
from gof.io.importers import Imported, ImportOptions, Trajectory, life, read_result


@dataclass
class ForeignOptions:
    """What a foreign result does not say about itself; see docs/importers.md."""

    time_unit: float | None = None
    """Seconds per unit of the method's time (FreeTimeGS: of the whole sequence; a PLY sequence: between two numbers)."""
    time_zero: float = 0.0
    """Dataset time in seconds at the method's time 0."""
    world: Path | None = None
    """COLMAP model (folder) the method normalised its world from, or JSON with "training_to_world": undone when given."""

    def options(self, frame_time_s: float | None = None) -> ImportOptions:
        return ImportOptions(self.time_unit, self.time_zero, frame_time_s, self.world)


@dataclass
class ConvertConfig:
    """Read a result of any known method; write .npz (exact), .ply (3DGS attributes plus time and velocity) or .ftgs.ply."""

    result: tyro.conf.Positional[Path]
    """File or folder: ours, the paper's checkpoint, Yang's 4DGS, FreeTimeGS, a folder of PLYs, a trajectory."""
    out: tyro.conf.Positional[Path]
    """File to write; the suffix says which format. An existing file is not replaced."""
    foreign: tyro.conf.OmitArgPrefixes[ForeignOptions]
    frame_time: float | None = None
    """Seconds between two frames, for results that count frames."""
    start: float | None = None
    """First second of the clip in an .ftgs.ply (time 0); default: when the first Gaussian appears."""
    end: float | None = None
    """Last second of the clip in an .ftgs.ply (time 1); default: when the last Gaussian is gone."""
    json: Path | None = None
    """File to write what was read and written to."""


def convert(
    imported: Imported, out: Path, start_s: float | None = None, end_s: float | None = None, frames: int | None = None
) -> Path:
    """Write a result by suffix: .ftgs.ply, .ply, .npz.

    Raises:
        DataFormatError: the file exists, the suffix is unknown, or a trajectory is asked to become a closed form.
    """
    from gof.io.importers import freetime

    if out.exists():
        raise DataFormatError(f"{out}: exists already; remove it or choose another name")
    source = f"{imported.method}: {imported.path.name}"
    if isinstance(imported.gaussians, Trajectory):
        if out.suffix != ".npz":
            raise DataFormatError(
                f"{out}: positions sampled in time have no closed form; write .npz (gof-trajectory/1)"
            )
        return imported.gaussians.save(out, source)
    if out.name.endswith(".ftgs.ply"):
        born, dead = life(imported.gaussians) if imported.gaussians.dynamic.any() else (0.0, 1.0)
        if not np.isfinite([born, dead]).all() and None in (start_s, end_s):
            raise DataFormatError(f"{out}: some Gaussians are always on, so the clip's --start and --end must be given")
        return freetime.save(
            imported.gaussians, out, born if start_s is None else start_s, dead if end_s is None else end_s, frames
        )
    return imported.gaussians.save(out, source)


def main(argv: list[str]) -> int:
    """The command line of `gof convert`."""
    from rich.console import Console

    from gof.io.files import write_json

    config = tyro.cli(ConvertConfig, prog="gof convert", args=argv)
    began = time.perf_counter()
    imported = read_result(config.result, config.foreign.options(config.frame_time))
    frames = None
    if config.frame_time and config.start is not None and config.end is not None:
        frames = round((config.end - config.start) / config.frame_time) + 1
    convert(imported, config.out, config.start, config.end, frames)
    seconds = time.perf_counter() - began
    console = Console()
    console.print(
        f"{imported.method}: {len(imported.gaussians)} Gaussians from {imported.path} written to {config.out} in {seconds:.1f} s"
    )
    for note in imported.notes:
        console.print("note:", note, style="yellow", markup=False, highlight=False)
    if config.json:
        write_json(
            config.json,
            {
                "method": imported.method,
                "gaussians": len(imported.gaussians),
                "notes": imported.notes,
                "out": str(config.out),
                "seconds": round(seconds, 3),
            },
        )
    return 0
