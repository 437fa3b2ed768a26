"""`gof sample`: a small fire, a finished result of it, a submission and three films, to start from without Blender."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from gof.commands.everywhere import write_figures
from gof.commands.read import read_options
from gof.sample import CONTENTS, unpack_sample

NEXT = """\
try, in this order:
  gof evaluate {out}/result --dataset {out}/fire
  gof report {out}/result --dataset {out}/fire
  gof share {out}/result --dataset {out}/fire
  gof leaderboard {out}/result {out}/submission/fire --dataset {out}/fire
  gof capture sync {out}/clip/cam_0.mp4 {out}/clip/cam_1.mp4 {out}/clip/cam_2.mp4 --out {out}/sync
  gof ingest {out}/clip/cam_0.mp4 {out}/clip/cam_1.mp4 {out}/clip/cam_2.mp4 --times {out}/sync/times.json \
--cameras {out}/clip/cameras.json --out {out}/filmed
  gof reconstruct {out}/filmed --out {out}/filmed_flame"""


@dataclass
class SampleConfig:
    """Unpack a small fire to start from: no network, no Blender, no simulation.

    Examples:
      gof sample sample

    OUT/fire is a dataset with ground-truth velocity: three cameras, 14 frames, two of them held out.
    OUT/result is a finished reconstruction of it, OUT/submission another method's result with its scores.
    OUT/clip holds three films of a fire with the LED board in the picture, and the lenses of their cameras.
    """

    out: tyro.conf.Positional[Annotated[Path, tyro.conf.arg(metavar="OUT")]] = Path("sample")
    """Folder for them. Files that are there already and equal are kept; another file of that name is an error."""


def main(argv: list[str]) -> int:
    """Run `gof sample`."""
    config = read_options(SampleConfig, "sample", argv)
    count, size = unpack_sample(config.out)
    for name, text in CONTENTS.items():
        print(f"{config.out / name}: {text}")
    print(f"{count} files, {size / 1e6:.1f} MB")
    print(NEXT.format(out=config.out.as_posix()))
    write_figures({name: (config.out / name).as_posix() for name in CONTENTS})
    return 0
