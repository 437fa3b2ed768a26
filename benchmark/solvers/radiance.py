"""How bright to burn a fire of grids: `python -m gof_benchmark.solvers.radiance GRIDS...` suggests `fire.radiance`."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import tyro

from gof.core.errors import DataFormatError, GofError
from gof_benchmark.solvers.grids import FireGrids

BRIGHTEST = 10.0  # linear red of the brightest pixels, as of our own fires: what display transform and exposure expect


@dataclass
class Radiance:
    """Print the `fire.radiance` of a spec that makes a fire's brightest pixels 10 in linear red (`flame.R` in the EXR).

    A solver knows its light up to one factor. The brightest line of sight of the whole clip, straight through the
    flame along X or Y, decides.
    """

    grids: tyro.conf.Positional[tuple[Path, ...]]
    """Folders of fires (schema gof-fire), for example fires/openfoam/pool_methane/grids."""


def brightest_column(fire: FireGrids) -> float:
    """Return the largest line integral of the red emission along X or Y in any frame, W m^-2 sr^-1 nm^-1 up to the
    factor.

    Raises:
        DataFormatError: a frame is damaged.
    """
    frames = (fire.grids["emission"].cells(k)[..., 0] for k in range(len(fire.times_s)))
    return (
        max(float(max(red.sum(0, dtype=float).max(), red.sum(1, dtype=float).max())) for red in frames) * fire.voxel_m
    )


def suggested_radiance(fire: FireGrids, brightest: float = BRIGHTEST) -> float:
    """Return the `fire.radiance` with which the brightest line of sight becomes `brightest` in linear red.

    Raises:
        DataFormatError: a frame is damaged, or the fire does not shine.
    """
    column = brightest_column(fire)
    if not column > 0:
        raise DataFormatError(f"{fire.grids['emission'].path}: no light in any frame; bake the fire again")
    return brightest / column


def main(argv: list[str] | None = None) -> int:
    config = tyro.cli(Radiance, prog="python -m gof_benchmark.solvers.radiance", args=argv)
    try:
        for path in config.grids:
            print(f"{path}: radiance {suggested_radiance(FireGrids.open(path)):.3g}")
    except GofError as e:
        print(f"radiance: {e}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
