"""`gof convert`: any known result to our formats, or to those of other programs; and what its files do not say."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, ClassVar

import tyro

from gof.commands.everywhere import may_overwrite, write_figures
from gof.commands.read import Seconds, read_options
from gof.core.errors import GofError
from gof.dataset import Dataset
from gof.host.terminal import console
from gof.io.convert import convert
from gof.io.importers import Imported, ImportOptions, read_result
from gof.io.importers.alignment import align_cameras, align_result, read_cameras
from gof.io.importers.sidecar import FIELDS, in_words, with_sidecar, write_sidecar
from gof.io.importers.source import WorldBy


@dataclass
class ConvertConfig:
    """Read a result of any known method, and write it for gof or for another program.

    Examples:
      gof convert out/fire/result.npz fire.glb --time 0.15
      gof convert out/fire/result.npz fire.4dgs --clip 0 0.35
      gof convert out/fire/result.npz frames --frame-time 0.01 --clip 0 0.35
      gof convert out/fire/result.npz lit.4dgs --clip 0 0.35 --into room.ply
      gof convert chkpnt30000.pth mine.npz --time-unit 0.35 --align sparse/0 --dataset data/fire
      gof convert chkpnt30000.pth --time-unit 0.35

    The suffix of OUT chooses. Exact: .npz, .ply (3DGS attributes, time and velocity), .ftgs.ply (FreeTimeGS players).
    Small files that move, whose loss in dB and mm/s is printed: .4dgs, .tsog, .dgs. Frames: .usda and .usdc (OpenUSD,
    which plays in Blender 5.3); a name without a suffix is a folder of 3DGS PLYs. One instant: .glb (glTF with
    KHR_gaussian_splatting, with velocities), .spz and .sog. Y is up in .tsog, .dgs, .glb, .spz and .sog, as their
    viewers expect; Z elsewhere.

    Without OUT, the options that describe another method's files are written to RESULT.gof.json beside them, and every
    command that reads RESULT uses them. docs/importers.md lists what each method needs.
    """

    FIRST: ClassVar = ("time", "clip", "frame_time", "into", "time_unit", "time_zero", "world", "flame_only")

    result: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="RESULT")]]
    """File or folder of any method that docs/importers.md lists."""
    out: tyro.conf.Positional[Annotated[Path | None, tyro.conf.arg(metavar="OUT")]] = None
    """File or folder to write; its suffix chooses the format."""
    time: Seconds | None = None
    """The instant in a .glb, .spz or .sog; default: the middle of the Gaussians' times."""
    clip: tuple[Seconds, Seconds] | None = None
    """First and last second of the clip, in formats that have one; default: when the first Gaussian appears, and when
    the last one is gone."""
    frame_time: Seconds | None = None
    """From one frame to the next, for results that count frames, for USD and for a folder of PLYs."""
    into: Path | None = None
    """Room in which the flame is to stand, with its light on it: a 3DGS PLY, or JSON that also says where (keys room,
    at, scale, turn_deg, up, start_s, light)."""
    time_unit: Seconds | None = None
    """One unit of the method's time (FreeTimeGS: the whole clip; PLY sequence: from one number to the next)."""
    time_zero: Seconds | None = None
    """Dataset time at the method's time 0. Default: 0."""
    world: Path | None = None
    """COLMAP model (folder), or JSON with "training_to_world": the method's normalisation of that world is undone."""
    world_by: WorldBy | None = None
    """Program that normalised the world: FreeTimeGsVanilla's own, or gsplat's; default: found out from the result."""
    flame_only: bool = False
    """Mark another method's result as a flame alone: it is then drawn over the fire-free backgrounds, as gof's own."""
    align: Path | None = None
    """The method's own cameras (COLMAP folder, dataset.json, transforms.json, or JSON of name to 4x4
    world_to_camera): the result is moved by the similarity that maps them onto the cameras of --dataset."""
    dataset: Path | None = None
    """The dataset into whose world --align moves the result; its cameras have the same names."""

    def foreign(self) -> ImportOptions:
        """Return the options' statements on the result. Raises GofError: see `ImportOptions`."""
        times = self.time_unit, self.time_zero or 0.0, self.frame_time
        return ImportOptions(*times, self.world, self.world_by, flame_only=self.flame_only)

    def merged(self) -> tuple[ImportOptions, Path | None]:
        """Return the same with what the file beside the result says of the rest, as `with_sidecar`."""
        return with_sidecar(self.result, self.foreign(), () if self.time_zero is None else ("time_zero_s",))


def main(argv: list[str]) -> int:
    """Run `gof convert`."""
    config = read_options(ConvertConfig, "convert", argv)
    began = time.perf_counter()
    if (config.align is None) != (config.dataset is None):
        raise GofError("--align and --dataset go together: cameras of the method's world, and those to map them onto")
    if config.out is None:
        return _write_down(config)
    options, sidecar = config.merged()
    imported = read_result(config.result, options)
    if config.align is not None and config.dataset is not None:
        imported = _moved(imported, config.align, Dataset.open(config.dataset))
    first, last = config.clip or (None, None)
    made = convert(imported, config.out, first, last, options.frame_time_s, config.time, may_overwrite(), config.into)
    seconds = time.perf_counter() - began
    count = len(imported.gaussians)
    out = console()
    out.print(f"{imported.method}: {count} Gaussians from {imported.path} written to {config.out} in {seconds:.1f} s")
    notes = [*([in_words(sidecar, options)] if sidecar else []), *imported.notes, *made]
    for note in notes:
        out.print("note:", note, style="yellow")
    done = {"method": imported.method, "gaussians": count, "notes": notes, "out": str(config.out)}
    write_figures(done | {"seconds": round(seconds, 3)})
    return 0


def _write_down(config: ConvertConfig) -> int:
    """RESULT.gof.json. Raises GofError: it holds nothing, or nothing about how the result is to be read."""
    options = config.foreign()
    if config.time_zero is None and not any(getattr(options, name) for name in FIELDS):
        raise GofError(
            "name a file to write (OUT), or say something of RESULT that its files do not: --time-unit, --time-zero, "
            "--frame-time, --world, --world-by, --flame-only"
        )
    if (config.time, config.clip, config.align, config.into) != (None,) * 4:
        raise GofError("--time, --clip, --align and --into are for a file that is written; name it (OUT)")
    options, _ = config.merged()
    imported = read_result(config.result, options)
    path = write_sidecar(config.result, options)
    out = console()
    out.print(f"{imported.method}: {len(imported.gaussians)} Gaussians in {imported.path}")
    for note in imported.notes:
        out.print("note:", note, style="yellow")
    out.print(in_words(path, options))
    out.print(f"{path}: written; every command that reads {config.result} reads it. To start anew, remove it")
    write_figures({"method": imported.method, "notes": imported.notes, "out": str(path)})
    return 0


def _moved(imported: Imported, cameras: Path, dataset: Dataset) -> Imported:
    """Return a result in the dataset's world."""
    found = align_cameras(read_cameras(cameras), {c.name: c.world_to_camera for c in dataset.cameras})
    moved = align_result(imported.gaussians, found, dataset.datum)
    return replace(imported, gaussians=moved, notes=[*imported.notes, found.in_words(cameras)])
