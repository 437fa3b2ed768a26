"""Bake fires with OpenFOAM: `python -m gof_benchmark.solvers.openfoam pool_methane jet --out fires/openfoam`."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import tyro

from gof.core.errors import GofError
from gof.core.files import path_in
from gof_benchmark.solvers.openfoam.foam_fire import find_fire
from gof_benchmark.solvers.openfoam.run import bake


@dataclass
class Bake:
    """Bake fires with OpenFOAM's fireFoam, one after the other: velocity, light, temperature, heat on a uniform grid.

    The flame first develops on a coarse mesh, is mapped to the fine one, settles there and is then written frame by
    frame. A fire takes one core 15 to 30 minutes; stopped at any time (also by kill), the same command goes on where it
    was. Needs OpenFOAM (`apt-get install openfoam`).
    Then `python -m gof_benchmark.fires.how_real OUT/*/grids` says how close to real fires they are.

    Fires that come with the benchmark: pool_methane (0.2 m square), pool_small (0.1 m), pool_wide (0.4 m),
    pool_propane (0.3 m round), jet, two_burners, pool_wind. A description of your own: copy one of their files in
    gof_benchmark/solvers/openfoam/fires and change it; what its fields mean: FoamFire in foam_fire.py there.
    """

    fires: tyro.conf.Positional[tuple[str, ...]]
    """Names of fires that come with the benchmark, or descriptions (FILE.json)."""
    out: Path = Path("fires/openfoam")
    """Each fire gets the folder OUT/<its name>; what it hands over is OUT/<its name>/grids."""
    keep_raw: bool = False
    """Keep OpenFOAM's own fields of the clip, about 2 GB a fire."""


def main(argv: list[str] | None = None) -> int:
    config = tyro.cli(Bake, prog="python -m gof_benchmark.solvers.openfoam", args=argv)
    try:
        for fire in [find_fire(name) for name in config.fires]:
            print(bake(fire, path_in(config.out, fire.name), config.keep_raw).path)
    except GofError as e:
        print(f"openfoam: {e}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
