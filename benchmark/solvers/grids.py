"""The hand-over of any solver: a flame as grids on a clock. A flame has a source, and this is the source's contract.

    <fire>/fire.json          what it is and where it comes from (`FireDescription`); written last
          velocity.zarr       (T, X, Y, Z, 3) m/s, schema gof-velocity
          emission.zarr       (T, X, Y, Z, 3) linear RGB radiance per metre, schema gof-grid
          temperature.zarr    (T, X, Y, Z) K                 optional, as are those below
          heat_release.zarr   (T, X, Y, Z) W/m3
          fuel.zarr           (T, X, Y, Z) mass fraction of fuel
          history.json        quick records of the solver (`FireHistory`), longer than the clip

All grids are cell-centred cubes of one box, world axes (Z up, metres), on one clock that starts at 0. Emission is
spectral radiance per metre of path, W m^-3 sr^-1 nm^-1 at the three wavelengths that stand for R, G and B, and true
up to one factor for the whole fire, because no solver here knows the amount of soot; absorption is left out (a thin
flame). Chunks are packed with gzip: Blender's Python has no zstd.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from gof.core.drafts import whole_folder
from gof.core.errors import DataFormatError, require_finite
from gof.core.fields import CHUNK, GridSequence, VelocitySequence, open_array
from gof.core.fire import FILE, FireDescription
from gof.core.records import read_record, write_record
from gof.core.zarr_array import ZarrArray

QUANTITIES = {"emission": "W m^-3 sr^-1 nm^-1", "temperature": "K", "heat_release": "W/m3", "fuel": "1"}
COMMON = {"version": 1, "frame": "world", "layout": "cell_centred"}


@dataclass(frozen=True)
class FireHistory:
    """Quick records over more time than the clip, for what needs seconds (puffing): the record `history.json`.

    Args:
        time_s: (N,) on the clip's clock, negative before it; uneven where the solver's steps are.
        heat_release_kw: (N,) of the whole domain.
        probe_position_m: (P, 3).
        rise_m_s: (N, P) vertical speed at the probes.
    """

    SCHEMA: ClassVar[str] = "gof-fire-history"
    VERSION: ClassVar[int] = 1

    time_s: tuple[float, ...]
    heat_release_kw: tuple[float, ...]
    probe_position_m: tuple[tuple[float, float, float], ...]
    rise_m_s: tuple[tuple[float, ...], ...]

    def __post_init__(self):
        same = len(self.time_s) == len(self.heat_release_kw) == len(self.rise_m_s)
        if not same or any(len(row) != len(self.probe_position_m) for row in self.rise_m_s):
            raise DataFormatError(
                "history: time_s, heat_release_kw and rise_m_s must have one row a time, one value a probe"
            )
        if (np.diff(self.time_s) <= 0).any():
            raise DataFormatError("history: time_s must increase")


@dataclass(frozen=True)
class FireFrame:
    """The grids of one time: velocity and emission (X, Y, Z, 3), the others (X, Y, Z) or None where not known."""

    velocity: np.ndarray
    emission: np.ndarray
    temperature: np.ndarray | None = None
    heat_release: np.ndarray | None = None
    fuel: np.ndarray | None = None


@dataclass(frozen=True)
class FireGrids:
    """A fire on disk, opened: `FireGrids.open(folder)`."""

    path: Path
    description: FireDescription
    velocity: VelocitySequence
    grids: dict[str, GridSequence]
    """By quantity: emission always, the others where the solver gave them."""
    history: FireHistory | None

    @property
    def times_s(self) -> np.ndarray:
        return self.velocity.times_s

    @property
    def index_to_world(self) -> np.ndarray:
        return self.velocity.index_to_world

    @property
    def voxel_m(self) -> float:
        """Edge of a cell (grids are cubes)."""
        return float(np.cbrt(abs(np.linalg.det(self.index_to_world[:3, :3]))))

    def centers(self, axis: int) -> np.ndarray:
        """Return world positions (m) of the cells' centres along an axis."""
        n = self.velocity.resolution[axis]
        return self.index_to_world[axis, 3] + self.voxel_m * (np.arange(n) + 0.5)

    @classmethod
    def open(cls, path: str | Path) -> FireGrids:
        """Open a fire for reading.

        Raises:
            DataFormatError: the folder is unfinished, or its grids differ in box or clock (names the file).
        """
        path = Path(path)
        description = read_record(FireDescription, path / FILE)
        velocity = VelocitySequence.open(path / "velocity.zarr")
        if not np.array_equal(velocity.times_s, description.time_s):
            raise DataFormatError(f"{path / 'velocity.zarr'}: its clock is not that of fire.json")
        grids = {}
        for quantity in QUANTITIES:
            store = path / f"{quantity}.zarr"
            if not store.exists() and quantity != "emission":
                continue
            grid = grids[quantity] = GridSequence(open_array(store), quantity)
            if not np.array_equal(grid.times_s, velocity.times_s):
                raise DataFormatError(f"{store}: its clock is not that of velocity.zarr")
            same_box = np.allclose(grid.index_to_world, velocity.index_to_world, rtol=0, atol=1e-9)
            if grid.resolution != velocity.resolution or not same_box:
                raise DataFormatError(f"{store}: its box is not that of velocity.zarr")
        box = velocity.index_to_world[:3, :3]
        if not np.allclose(box, np.eye(3) * box[0, 0]) or box[0, 0] <= 0:
            raise DataFormatError(f"{path / 'velocity.zarr'}: a fire's cells are upright cubes; resample it")
        history = path / "history.json"
        return cls(path, description, velocity, grids, read_record(FireHistory, history) if history.exists() else None)

    def check(self) -> None:
        """Read every frame once.

        Raises:
            DataFormatError: a frame is damaged, not finite, or has negative light, heat or fuel beyond rounding.
        """
        for k in range(len(self.times_s)):
            self.velocity.frame(k)
            for quantity, grid in self.grids.items():
                values = grid.cells(k)
                if values.min() < -1e-3 * max(1.0, np.abs(values).max()):
                    raise DataFormatError(f"{grid.path}: frame {k} holds negative {quantity} ({values.min():.3g})")


def write_fire(
    path: Path,
    description: FireDescription,
    index_to_world: np.ndarray,
    frame: Callable[[int], FireFrame],
    history: FireHistory | None = None,
) -> FireGrids:
    """Write a fire, frame by frame; `path` appears only when it is whole.

    Args:
        index_to_world: (4, 4) continuous cell index to world metres: cell i spans i to i + 1, so (0, 0, 0) is the
            lower corner of the box and (0.5, 0.5, 0.5) the centre of the first cell. Cells are cubes.
        frame: called with 0, 1, ... for the frames of `description.time_s`. A quantity in float16 is stored as such,
            others as float32.
    Raises:
        DataFormatError: the path exists, or the frames differ in shape, quantities or precision.
        NonFiniteError: a frame holds NaN or Inf; names the quantity.
    """
    if path.exists():
        raise DataFormatError(f"{path}: exists already; remove it first or choose another name")
    with whole_folder(path) as partial:
        stores: dict[str, Any] = {}
        for k in range(len(description.time_s)):
            grids = {name: value for name, value in vars(frame(k)).items() if value is not None}
            if k == 0:
                kinds = {name: _kind(value) for name, value in grids.items()}
                stores = {
                    name: _create(partial, name, *kind, description.time_s, index_to_world)
                    for name, kind in kinds.items()
                }
            if {name: _kind(value) for name, value in grids.items()} != kinds:
                raise DataFormatError(
                    f"{path}: frame {k} has other quantities, another shape or another precision than frame 0"
                )
            for name, value in grids.items():
                require_finite(name, value, f"frame {k} of fire '{description.name}'")
                stores[name].write(k, np.asarray(value, kinds[name][1]))
        if history:
            write_record(partial / "history.json", history)
        write_record(partial / FILE, description)
    return FireGrids.open(path)


def _kind(grid: np.ndarray) -> tuple[tuple[int, ...], str]:
    """Return a grid's shape and the precision that it is stored in."""
    return np.shape(grid), "float16" if np.asarray(grid).dtype == np.float16 else "float32"


def _create(
    folder: Path,
    name: str,
    shape: tuple[int, ...],
    dtype: str,
    times_s: tuple[float, ...],
    index_to_world: np.ndarray,
):
    vector = name in ("velocity", "emission")
    if len(shape) != 3 + vector or (vector and shape[3] != 3):
        raise DataFormatError(f"{name}: shape {shape}, expected (X, Y, Z{', 3' if vector else ''})")
    what = {"schema": "gof-velocity", "units": "m/s"}
    if name != "velocity":
        what = {"schema": "gof-grid", "quantity": name, "units": QUANTITIES[name]}
    attributes = {
        **what,
        **COMMON,
        "index_to_world": np.asarray(index_to_world, float).tolist(),
        "voxel_size": float(index_to_world[0][0]),
        "time_s": list(times_s),
    }
    chunks = (1, CHUNK, CHUNK, CHUNK, 3)[: len(shape) + 1]
    return ZarrArray.create(folder / f"{name}.zarr", (len(times_s), *shape), chunks, dtype, attributes, level=1)
