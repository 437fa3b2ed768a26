"""A fire from OpenVDB files, one for each frame, as Houdini, EmberGen or Blender write them.

    python -m gof_benchmark.solvers.vdb cache/*.vdb --out fire --rate-hz 24 --velocity vel --flame flame --up y

Programs name their grids and scale their numbers as they like: the options are the table of names and units. The result
is a folder that `fire.grids` of a spec names (`gof_benchmark.solvers.grids`). Light is the files' own emission, or that
of black bodies of the flame's temperature, in proportion to the flame.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro

from gof.core.errors import DataFormatError, GofError
from gof.core.fire import FireDescription
from gof.core.numbered import missing_numbers, number_files, usual_step
from gof.host import extras
from gof.host.terminal import console
from gof_benchmark.solvers.grids import FireFrame, write_fire
from gof_blender.pure.soot import black_body


@dataclass(frozen=True)
class FromVdb:
    """Bring a sequence of OpenVDB files into a folder of grids that a scene can burn."""

    files: tyro.conf.Positional[tuple[Path, ...]]
    """One for each frame; the last number in a name, sizes such as 512x512 aside, says which."""
    out: Path
    """Folder to write; its name is the fire's."""
    rate_hz: float
    """Frames per second of the fire's clock: the first file is at 0 s, others by their numbers."""
    velocity: str = "velocity"
    """Name of the grid of vectors that moves the gas, or of three grids of numbers: vel for vel.x, vel.y and vel.z."""
    velocity_m_s: float = 1.0
    """Value of one unit in that grid, m/s."""
    metres: float = 1.0
    """Value of one unit of length in the files, m."""
    up: Literal["z", "y"] = "z"
    """Axis that points up in the files."""
    emission: str | None = None
    """Grid of linear RGB light per unit of length; without it the light is that of `flame` and `temperature`."""
    flame: str = "flame"
    """Grid of how much glows. Frames without this grid are dark."""
    temperature: str | None = None
    """Grid of temperature; without it all that glows has the temperature `kelvin_at_0`."""
    kelvin: float = 1.0
    """Value of one unit in that grid, K."""
    kelvin_at_0: float = 0.0
    """Value of zero in that grid, K: 273.15 for degrees Celsius."""

    def __post_init__(self):
        for name in ("rate_hz", "metres"):
            if not 0 < getattr(self, name) < np.inf:
                raise GofError(f"--{name.replace('_', '-')} {getattr(self, name)}: must be positive")
        if not self.emission and not self.temperature and self.kelvin_at_0 < 500:
            raise GofError("name the grid of --temperature, or give --kelvin-at-0 of all that glows, such as 1700")


@dataclass(frozen=True)
class GridExtent:
    """Cells of all frames: index of the first, how many, a cell's edge and the place of index 0 in the files' units."""

    low: tuple[int, int, int]
    shape: tuple[int, int, int]
    cell: float
    origin: tuple[float, float, float]

    def index_to_world(self, config: FromVdb) -> np.ndarray:
        """Return (4, 4) of cells as `upright` turns them, to metres. OpenVDB's values stand at the centres of cells."""
        edge = self.cell * config.metres
        first = config.metres * (np.array(self.origin) + self.cell * (np.array(self.low) - 0.5))
        if config.up == "y":
            first = np.array([first[0], -first[2] - edge * self.shape[2], first[1]])
        matrix = np.diag([edge, edge, edge, 1.0])
        matrix[:3, 3] = first
        return matrix


class Sequence:
    """The files by the numbers in their names, which are the fire's clock.

    Attributes:
        time_s: (T,) from the first file on.
        dark: files without the grid that glows: nothing burns there yet, or any more.
        notes: what a user should know, in words.

    Raises:
        DataFormatError: the files are not one sequence; one is no OpenVDB file, lacks a grid, or its cells are no
            upright cubes that fit the first file's.
    """

    def __init__(self, config: FromVdb):
        self.config, self._vdb = config, _openvdb()
        found = number_files(config.files)
        if not found:
            raise DataFormatError("no OpenVDB files were named")
        numbers, self.files = [number for number, _ in found], [path for _, path in found]
        self.time_s = tuple((number - numbers[0]) / config.rate_hz for number in numbers)
        count, which = missing_numbers(numbers)
        self.notes = [f"{count} files are missing ({which}): a gap in the fire's clock"] if count else []
        if (step := usual_step(numbers)) > 1:
            self.notes.append(f"the files' numbers go in steps of {step}: {step / config.rate_hz:g} s apart")
        names_in = {path: self._names_in(path) for path in self.files}
        self.velocity = self._parts_of_velocity(names_in[self.files[0]])
        self.glow = config.emission or config.flame
        heat = None if config.emission else config.temperature
        self.names = [*self.velocity, self.glow, *([heat] if heat else [])]
        self.dark = {path for path, names in names_in.items() if self.glow not in names}
        for path, names in names_in.items():
            needed = self.velocity if path in self.dark else self.names
            for name in needed:
                self._require(path, name, names)
        if len(self.dark) == len(self.files):
            self._require(self.files[0], self.glow, names_in[self.files[0]])
        if self.dark:
            dark = ", ".join(path.name for path in self.files if path in self.dark)
            self.notes.append(f"{dark}: without the grid '{self.glow}', taken as dark")

    @cached_property
    def box(self) -> GridExtent:
        """Around what is stored of any of the grids in any frame."""
        lows, highs, first = [], [], None
        for path in self.files:
            for name in self._names_of(path):
                grid = self._grid(path, name)
                place = _place(path, grid)
                first = first or place
                if not np.allclose(place, first, rtol=1e-5, atol=1e-6 * first[0]):
                    raise DataFormatError(f"{path}: grid '{name}' has other cells than the first grid; resample it")
                low, high = grid.evalActiveVoxelBoundingBox()
                if low[0] <= high[0]:  # something is stored
                    lows.append(low)
                    highs.append(high)
        if not lows:
            raise DataFormatError(f"{self.files[0]} and the others are empty")
        low, high = np.min(lows, axis=0), np.max(highs, axis=0)
        return GridExtent(tuple(low.tolist()), tuple((high - low + 1).tolist()), first[0], first[1:])

    def frame(self, index: int) -> FireFrame:
        config, path = self.config, self.files[index]
        values = {name: self._values(path, name) for name in self._names_of(path)}
        parts = [values[name] for name in self.velocity]
        velocity = (np.stack(parts, axis=-1) if len(parts) == 3 else parts[0]) * config.velocity_m_s
        if path in self.dark:
            emission = np.zeros((*self.box.shape, 3))
        elif config.emission:
            emission = values[config.emission] / config.metres
        else:
            heat = values[config.temperature] if config.temperature else 0.0
            kelvin = np.maximum(config.kelvin_at_0 + config.kelvin * heat, 1.0) * np.ones(self.box.shape)
            emission = values[config.flame][..., None] * black_body(kelvin)
        if config.up == "y":
            velocity = np.stack([velocity[..., 0], -velocity[..., 2], velocity[..., 1]], axis=-1)
            velocity, emission = _upright(velocity), _upright(emission)
        return FireFrame(velocity.astype(np.float32), np.maximum(emission, 0).astype(np.float32))

    def _values(self, path: Path, name: str) -> np.ndarray:
        """Return (X, Y, Z) or (X, Y, Z, 3) of the box. Raises DataFormatError: vectors for numbers, or numbers for
        vectors."""
        grid = self._grid(path, name)
        vectors = name in (self.config.velocity, self.config.emission)  # velocity's parts have other names
        values = np.zeros((*self.box.shape, 3) if vectors else self.box.shape, np.float32)
        try:
            grid.copyToArray(values, ijk=self.box.low)
        except (TypeError, ValueError) as error:
            raise DataFormatError(f"{path}: grid '{name}' holds no {'vectors' if vectors else 'numbers'}") from error
        if vectors and grid.gridClass == self._vdb.GridClass.STAGGERED:  # each component on its own lower face
            for axis in range(3):
                values[..., axis] += np.roll(values[..., axis], -1, axis)
            values /= 2
        return values

    def _names_of(self, path: Path) -> list[str]:
        """Grids that are read of a file."""
        return self.velocity if path in self.dark else self.names

    def _names_in(self, path: Path) -> set[str]:
        """Return names of the grids in a file."""
        try:
            return {grid.name for grid in self._vdb.readAllGridMetadata(str(path))}
        except Exception as error:  # its own types are not exported
            raise DataFormatError(f"{path}: is no OpenVDB file: {error}") from error

    def _require(self, path: Path, name: str, names: set[str]) -> None:
        if name not in names:
            raise DataFormatError(
                f"{path}: no grid '{name}' can be read there; it has {', '.join(sorted(names)) or 'none'}"
            )

    def _parts_of_velocity(self, names: set[str]) -> list[str]:
        """Return names of the one or three grids of velocity, by those in the first file."""
        name = self.config.velocity
        ways = [[f"{name}{link}{axis}" for axis in "xyz"] for link in (".", "_", "")]
        return next((parts for parts in ways if name not in names and names.issuperset(parts)), [name])

    def _grid(self, path: Path, name: str) -> Any:
        try:
            return self._vdb.read(str(path), name)
        except Exception as error:  # its own types are not exported
            raise DataFormatError(f"{path}: no grid '{name}' can be read there: {error}") from error


def _place(path: Path, grid: Any) -> tuple[float, float, float, float]:
    """Edge of a cell and the place of index 0. Raises DataFormatError: cells are no upright cubes."""
    origin = np.array(grid.transform.indexToWorld((0, 0, 0)))
    axes = np.array([grid.transform.indexToWorld(tuple(row)) for row in np.eye(3)]) - origin
    if not np.allclose(axes, np.eye(3) * axes[0, 0], atol=1e-5 * abs(axes[0, 0])) or axes[0, 0] <= 0:
        raise DataFormatError(f"{path}: grid '{grid.name}': cells are no upright cubes; resample it")
    return (float(axes[0, 0]), *origin.tolist())


def _upright(values: np.ndarray) -> np.ndarray:
    """Grids with y up as grids with z up: (x, y, z) becomes (x, -z, y)."""
    return np.swapaxes(values, 1, 2)[:, ::-1]


def _openvdb() -> Any:
    """Blender's library, which its Python packages bring."""
    extras.require("bpy", "blender", "reading OpenVDB files")
    from gof_blender.scene import images  # noqa: F401  (it puts Blender's libraries on the path)

    import openvdb  # isort: skip

    return openvdb


def main(argv: list[str] | None = None) -> int:
    """Write the folder and say what it holds."""
    try:
        config = tyro.cli(FromVdb, prog="python -m gof_benchmark.solvers.vdb", args=argv)
        sequence = Sequence(config)
        light = f"grid '{config.emission}'" if config.emission else f"grid '{config.flame}' times black bodies"
        description = FireDescription(
            name=config.out.name,
            solver="OpenVDB files",
            time_s=sequence.time_s,
            emission_law=light,
        )
        write_fire(config.out, description, sequence.box.index_to_world(config), sequence.frame)
    except GofError as error:
        console().print("error:", error, style="red")
        return 1
    for note in sequence.notes:
        print(f"note: {note}")
    print(f"{config.out}: {len(sequence.files)} frames, {' x '.join(map(str, sequence.box.shape))} cells of the files")
    return 0


if __name__ == "__main__":
    sys.exit(main())
