"""The description of a fire for fireFoam, and the fires that come with the benchmark, by name."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np
from scipy.optimize import brentq

from gof.core.errors import DataFormatError
from gof.core.files import is_name
from gof.core.records import read_record
from gof_benchmark.solvers.openfoam.chemistry import FUELS, FuelName, Hydrocarbon

Vector = tuple[float, float, float]
FIRES = Path(__file__).parent / "fires"


@dataclass(frozen=True)
class FoamBurner:
    """Where fuel comes out of the floor, straight up.

    Args:
        heat_release_kw: of its fuel, burnt completely; sets the mass that flows out.
        size_m: side of the square, or diameter of the circle.
        center_m: (x, y) on the floor.
    """

    heat_release_kw: float
    size_m: float
    center_m: tuple[float, float] = (0.0, 0.0)
    shape: Literal["square", "round"] = "square"

    @property
    def area_m2(self) -> float:
        return self.size_m**2 * (math.pi / 4 if self.shape == "round" else 1.0)

    @property
    def diameter_m(self) -> float:
        """Return the diameter of the circle of equal area, which the laws of pool fires speak of."""
        return math.sqrt(4 * self.area_m2 / math.pi)

    def mass_flow(self, fuel: Hydrocarbon) -> float:
        """kg/s."""
        return self.heat_release_kw * 1e3 / fuel.heat_of_combustion

    def speed(self, fuel: Hydrocarbon) -> float:
        """Return the speed of the cold fuel at the burner, m/s: centimetres for a pool, metres for a jet."""
        return self.mass_flow(fuel) / (fuel.density * self.area_m2)


@dataclass(frozen=True)
class FoamFire:
    """One fire of fireFoam, enough to bake it again: a record, `fires/*.json`.

    Args:
        wind_m_s: (x, y) velocity of the air that comes in at the sides it blows from.
        core_low_m, core_high_m: corners of the box of uniform cells, which is also the box of the grids; z starts at 0.
        domain_low_m, domain_high_m: corners of the whole domain; z starts at 0.
        cell_m: (x, y, z) edges of a cell of the core.
        voxel_m: edge of the grids' cubes; by default the cells' x edge.
        stretch: largest ratio between neighbouring cells outside the core.
        coarse: the flame develops on cells this many times as large.
        warm_up_s: on the coarse mesh, from still air.
        settle_s: on the fine mesh, until detail below the coarse cells has grown, and puffing with it: cells of a tenth
            of the burner damp it.
        courant: largest Courant number, which sets the time step.
        radiating_share: of the heat release that soot radiates away at once (the gases' own radiation is solved for).
        draught_m_s: standard deviation of the air's motion at the start, and of what the flame is shaken with on the
            fine mesh; `seed` draws it, and with it the whole flame.
        emission: how light follows from the gas (`fields.py`).
    """

    SCHEMA: ClassVar[str] = "gof-foam-fire"
    VERSION: ClassVar[int] = 1

    name: str
    burners: tuple[FoamBurner, ...]
    core_low_m: Vector
    core_high_m: Vector
    domain_low_m: Vector
    domain_high_m: Vector
    cell_m: Vector
    voxel_m: float | None = None
    fuel: FuelName = "methane"
    wind_m_s: tuple[float, float] = (0.0, 0.0)
    frames: int = 37
    frame_rate_hz: float = 100.0
    warm_up_s: float = 1.2
    settle_s: float = 0.9
    coarse: float = 2.0
    stretch: float = 1.35
    courant: float = 0.8
    les_model: Literal["kEqn", "WALE"] = "kEqn"
    radiating_share: float = 0.0
    draught_m_s: float = 0.2
    seed: int = 0
    emission: Literal["polynomial", "planck"] = "polynomial"

    def __post_init__(self):
        if not is_name(self.name):
            raise DataFormatError(f"fire {self.name[:80]!r}: its folder is named after it; give it a plain name")
        box = np.array([self.domain_low_m, self.core_low_m, self.core_high_m, self.domain_high_m])
        wrong = [
            (not self.burners, "burners: at least one"),
            (any(b.heat_release_kw <= 0 or b.size_m <= 0 for b in self.burners), "burners: heat and size above 0"),
            (not np.isfinite(box).all() or (np.diff(box, axis=0) < 0).any(), "boxes: the core inside the domain"),
            (box[0, 2] != 0 or box[1, 2] != 0, "boxes: both start at z = 0, the floor"),
            (min(self.cell_m) <= 0, "cell_m: above 0"),
            ((box[2] - box[1] < 4 * np.array(self.cell_m)).any(), "core: at least 4 cells a side"),
            (self.coarse < 1 or not 1 < self.stretch <= 2, "coarse: at least 1; stretch: above 1, at most 2"),
            (self.frames < 2 or self.frame_rate_hz <= 0, "frames: at least 2, at a rate above 0"),
            (min(self.warm_up_s, self.settle_s) <= 0, "warm_up_s, settle_s: above 0"),
            (not 0 <= self.radiating_share < 0.6, "radiating_share: 0 to 0.6"),
        ]
        for bad, what in wrong:
            if bad:
                raise DataFormatError(f"fire '{self.name}': {what}")
        for b in self.burners:
            low, high = np.subtract(b.center_m, b.size_m / 2), np.add(b.center_m, b.size_m / 2)
            if (low < box[1, :2]).any() or (high > box[2, :2]).any():
                raise DataFormatError(f"fire '{self.name}': a burner of {b.size_m} m at {b.center_m} leaves the core")

    @property
    def gas(self) -> Hydrocarbon:
        return FUELS[self.fuel]

    @property
    def heat_release_kw(self) -> float:
        return sum(b.heat_release_kw for b in self.burners)

    @property
    def start_s(self) -> float:
        """Solver time of the clip's frame 0, a whole number of milliseconds, so that folders' names are exact."""
        return round(self.warm_up_s + self.settle_s, 3)

    @property
    def end_s(self) -> float:
        return self.start_s + (self.frames - 1) / self.frame_rate_hz

    def axes(self, level: Literal["coarse", "fine"]) -> list[list[tuple[float, int, float]]]:
        """Per axis the sections (length m, cells, last cell / first cell), as blockMesh's grading wants them."""
        factor = self.coarse if level == "coarse" else 1.0
        return [self._axis(i, self.cell_m[i] * factor) for i in range(3)]

    def _axis(self, i: int, cell: float) -> list[tuple[float, int, float]]:
        low, high = self.core_low_m[i], self.core_high_m[i]
        cells = max(1, round((high - low) / cell))
        cell = (high - low) / cells
        before, after = low - self.domain_low_m[i], self.domain_high_m[i] - high
        sections = [(high - low, cells, 1.0)]
        if before > 0:
            count, ratio = growing(cell, before, self.stretch)
            sections.insert(0, (before, count, 1 / ratio))
        if after > 0:
            sections.append((after, *growing(cell, after, self.stretch)))
        return sections

    def cells(self, level: Literal["coarse", "fine"]) -> tuple[int, int, int]:
        return tuple(sum(n for _, n, _ in axis) for axis in self.axes(level))


def growing(first: float, length: float, stretch: float) -> tuple[int, float]:
    """Return cells of a section that starts with cells of `first` m and grows by at most `stretch`: (count, last /
    first)."""
    if length <= first:
        return 1, 1.0
    count = max(2, math.ceil(math.log(1 + length * (stretch - 1) / first) / math.log(stretch)))
    if count * first >= length:  # no growth needed
        return max(1, round(length / first)), 1.0

    def excess(ratio: float) -> float:
        return first * (ratio**count - 1) / (ratio - 1) - length

    return count, brentq(excess, 1 + 1e-9, stretch + 1e-6) ** (count - 1)


def find_fire(name: str) -> FoamFire:
    """Return the description of a file, or of a fire that comes with the benchmark.

    Raises:
        DataFormatError: neither; names those that there are.
    """
    path = Path(name) if name.endswith(".json") else FIRES / f"{name}.json"
    if not path.exists():
        raise DataFormatError(
            f"{path}: no such file; fires by name: {', '.join(sorted(p.stem for p in FIRES.glob('*.json')))}"
        )
    return read_record(FoamFire, path)
