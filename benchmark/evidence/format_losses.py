"""Write a result in each format of `gof convert` that can be read again, and measure the loss.

    python -m gof_benchmark.evidence.format_losses RESULT

Takes about 20 s. Needs the extras `splats` and `usd`.

The result is written as its whole life, or at the middle of it, and read again: by gof, .spz and .sog by GaussForge. A
GLB, whose numbers are float32, is read by its test (tests/io/test_gltf.py). A file of frames is compared at frames.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro

from gof.core import ftgs
from gof.core.errors import DataFormatError, MissingDependencyError
from gof.core.gaussians import TransientGaussians
from gof.core.similarity import Y_UP
from gof.host import extras
from gof.io import compressed, usd
from gof.io.convert import MOVING, save_frames
from gof.io.importers import ImportOptions, read_result
from gof.io.into_room import read_room
from gof.io.losses import INSTANTS, Distance, Loss, measure_loss, picture_psnr


@dataclass
class FormatLossesConfig:
    """Write a result in every format, and compare what is read. Prints a table."""

    result: tyro.conf.Positional[Path]
    """Result of gof reconstruct."""
    frame_time: float = 0.01
    """Seconds between two frames of USD and of a folder of PLYs."""


@dataclass(frozen=True)
class FlameClip:
    """A flame and its life, s."""

    flame: TransientGaussians
    start_s: float
    end_s: float
    frame_s: float

    def time_s(self, share: float) -> float:
        return self.start_s + share * (self.end_s - self.start_s)

    def frame(self, share: float) -> int:
        return round((self.time_s(share) - self.start_s) / self.frame_s)


def main(argv: list[str] | None = None) -> None:
    """Print bytes and losses of every format."""
    options = tyro.cli(FormatLossesConfig, prog="python -m gof_benchmark.evidence.format_losses", args=argv)
    flame = read_result(options.result).gaussians
    if not isinstance(flame, TransientGaussians):
        raise DataFormatError(f"{options.result}: positions sampled in time have no closed form; give another result")
    clip = FlameClip(flame, *flame.life(), options.frame_time)
    print(f"{len(flame)} Gaussians, {clip.end_s - clip.start_s:.3f} s\n")
    print(
        "| format | MB | pictures, dB | places, mm | velocities, mm/s | of the gas, mm/s |\n|---|---|---|---|---|---|"
    )
    for name, measure in FORMATS.items():
        with tempfile.TemporaryDirectory(prefix="gof-") as folder:
            out = Path(folder) / ("frames" if name == "folder" else f"out{name}")
            try:
                lost = measure(clip, out)
            except MissingDependencyError as e:
                print(f"{name}: {e}", file=sys.stderr)
                continue
            files = out.iterdir() if out.is_dir() else [out]
            size = sum(path.stat().st_size for path in files) / 1e6
        print(f"| `{name}` | {size:.2f} | {_cells(lost)} |", flush=True)


def _cells(lost: Loss | float | None) -> str:
    if not isinstance(lost, Loss):
        return f"{_dB(lost)} | | |"
    offs = (f"{off.rms:.2g}" if isinstance(off, Distance) else "" for off in (lost.velocity, lost.gas_velocity))
    return f"{_dB(lost.psnr)} | {lost.place.rms:.2g} | {' | '.join(offs)}"


def _dB(psnr: float | None) -> str:
    return "" if psnr is None else "exact" if np.isinf(psnr) else f"{psnr:.1f}"


def _own(clip: FlameClip, out: Path) -> Loss:
    clip.flame.save(out)
    return measure_loss(clip.flame, _read(out), clip.start_s, clip.end_s)


def _freetime(clip: FlameClip, out: Path) -> Loss:
    ftgs.save(clip.flame, out, clip.start_s, clip.end_s, None)
    return measure_loss(clip.flame, _read(out, emissive=clip.flame.emissive), clip.start_s, clip.end_s)


def _moving(clip: FlameClip, out: Path) -> Loss:
    order = MOVING[out.suffix].save(clip.flame, out, clip.start_s, clip.end_s, "")
    timeless = out.suffix == ".dgs"  # no clock, no emissive flame
    says = {"time_zero_s": clip.start_s, "emissive": clip.flame.emissive} if timeless else {}
    return measure_loss(clip.flame[order], _read(out, **says), clip.start_s, clip.end_s)


def _usd(clip: FlameClip, out: Path) -> Loss:
    seen, _ = usd.save(clip.flame, out, clip.start_s, clip.end_s, clip.frame_s)
    return measure_loss(clip.flame[seen], _read(out), clip.start_s, clip.end_s)


def _frames(clip: FlameClip, out: Path) -> float | None:
    save_frames(clip.flame, out, clip.start_s, clip.end_s, clip.frame_s)
    frames = map(clip.frame, INSTANTS)
    return picture_psnr(
        clip.flame, {clip.start_s + k * clip.frame_s: _still(clip, out / f"frame{k:05d}.ply") for k in frames}
    )


def _instant(clip: FlameClip, out: Path) -> float | None:
    time_s = clip.time_s(0.5)
    compressed.save(clip.flame, out, time_s)
    made = extras.load("gaussforge", "splats", f"reading {out.suffix}").GaussForge()
    ply = out.with_suffix(".ply")
    ply.write_bytes(bytes(made.convert(out.read_bytes(), out.suffix[1:], "ply")["data"]))
    return picture_psnr(clip.flame, {time_s: _still(clip, ply).transformed(np.linalg.inv(Y_UP))})


def _read(path: Path, **says) -> TransientGaussians:
    found = read_result(path, ImportOptions(**says)).gaussians
    assert isinstance(found, TransientGaussians)
    return found


def _still(clip: FlameClip, path: Path) -> TransientGaussians:
    """Return splats of an instant, of the kind that the flame is of."""
    found = read_room(path)
    return replace(found, dynamic=np.ones(len(found), bool), emissive=clip.flame.emissive)


FORMATS: dict[str, Callable[[FlameClip, Path], Loss | float | None]] = {
    ".npz": _own,
    ".ply": _own,
    ".ftgs.ply": _freetime,
    ".4dgs": _moving,
    ".tsog": _moving,
    ".dgs": _moving,
    ".usdc": _usd,
    "folder": _frames,
    ".spz": _instant,
    ".sog": _instant,
}


if __name__ == "__main__":
    main()
