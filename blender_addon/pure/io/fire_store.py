"""A flame that another solver has made: grids on a clock, as `gof_benchmark.solvers.grids` writes them.

    <fire>/fire.json          what it is and where it comes from
          velocity.zarr       (T, X, Y, Z, 3) m/s
          emission.zarr       (T, X, Y, Z, 3) linear RGB radiance per metre, true up to one factor

All on one clock and one box of upright cubes, world axes (Z up, metres). Other grids there are left aside.
"""

from __future__ import annotations

import shlex
from pathlib import Path

import numpy as np

from ...core.errors import DataFormatError
from ...core.fields import SAME_TIME_S, GridSequence, VelocitySequence, open_array
from ...core.fire import FILE, FireDescription
from ...core.numbered import is_hidden
from ...core.records import read_record


class FireStore:
    """A fire's folder, opened.

    Attributes:
        description: of `fire.json`.
        velocity, emission: grids on the same clock and box.

    Raises:
        DataFormatError: the folder is unfinished, or its grids differ in box or clock (names the file).
    """

    def __init__(self, path: Path):
        self.path = path
        if not (path / FILE).is_file():
            raise DataFormatError(f"{path / FILE}: no such file, so the folder holds no fire{_remedy(path)}")
        self.description = read_record(FireDescription, path / FILE)
        self.velocity = VelocitySequence.open(path / "velocity.zarr")
        self.emission = GridSequence(open_array(path / "emission.zarr"), "emission", (3,))
        for stored in (self.velocity, self.emission):
            if not np.array_equal(stored.times_s, self.description.time_s):
                raise DataFormatError(f"{stored.path}: its clock is not that of {FILE}")
        same_box = np.allclose(self.emission.index_to_world, self.index_to_world, rtol=0, atol=1e-9)
        if self.emission.resolution != self.grid or not same_box:
            raise DataFormatError(f"{self.emission.path}: its box is not that of velocity.zarr")
        cell = self.index_to_world[:3, :3]
        if not np.allclose(cell, np.eye(3) * cell[0, 0]) or cell[0, 0] <= 0:
            raise DataFormatError(f"{self.velocity.path}: a fire's cells are upright cubes; resample it")

    @property
    def grid(self) -> tuple[int, int, int]:
        """(X, Y, Z) cells."""
        return self.velocity.resolution

    @property
    def index_to_world(self) -> np.ndarray:
        """(4, 4) continuous cell index (cell i spans [i, i + 1]) to metres on the store's axes."""
        return self.velocity.index_to_world

    @property
    def cell_m(self) -> float:
        """Edge of a cell."""
        return float(self.index_to_world[0, 0])

    def covers(self, first_s: float, last_s: float) -> bool:
        """Return whether all times from first to last lie on its clock."""
        time_s = self.velocity.times_s
        return bool(time_s[0] - SAME_TIME_S <= first_s and last_s <= time_s[-1] + SAME_TIME_S)


def _remedy(path: Path) -> str:
    if any(not is_hidden(file) for file in path.glob("*.vdb")):
        folder = shlex.quote(str(path))
        fire = shlex.quote(f"{path}_fire")
        return (
            "; it holds OpenVDB files, which do not say their rate and units. Run once, where gof is installed: "
            f"python -m gof_benchmark.solvers.vdb {folder}/*.vdb --out {fire} --rate-hz 24 "
            f"--velocity velocity --velocity-m-s 1 --flame flame --kelvin-at-0 1700 --up z; then choose {fire}"
        )
    return "; choose one that gof_benchmark.solvers.grids.write_fire wrote"
