"""Fires of a scene, and their boxes: a fire that we simulate, or the grids of any other solver.

`SceneSpec` asks both kinds the same: ``check(domain, effects)``, ``box(domain, timeline)``, ``bake_steps(timeline)``,
``burner``, ``dims``, ``title``.
"""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ..core.checked_json import SpecError, require
from ..core.errors import DataFormatError, GofError
from ..core.fields import SAME_TIME_S, GridSequence, VelocitySequence, open_array
from ..core.fire import FILE, FireDescription
from ..core.numbered import is_hidden
from ..core.records import read_record
from . import effects as effect_modules
from .fuels import FUELS
from .soot import Sheet, sheet
from .timeline import Timeline
from .timing import Vector


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


MOST_CELLS = 2048  # along the longest side
LEAST_SIDE, MOST_SIDE = 1e-3, 1e3
LEAST_LOGS, MOST_LOGS = 2, 8
MOST_JET = 100.0  # m/s; faster gas is no longer the incompressible gas of the solver


@dataclass(frozen=True)
class Domain:
    """The simulated box. Its cells are cubes with sides of (longest side) / resolution."""

    min: Vector = (-0.4, -0.4, 0.0)
    """Lowest corner, world metres."""
    size: Vector = (0.8, 0.8, 1.6)
    """Side lengths, metres."""
    resolution: int = 64
    """Cells along the longest side."""

    def __post_init__(self):
        rule = f"in [{LEAST_SIDE:g}, {MOST_SIDE:g}] m on every side"
        require(all(LEAST_SIDE <= side <= MOST_SIDE for side in self.size), "domain.size", rule, self.size)
        require(8 <= self.resolution <= MOST_CELLS, "domain.resolution", f"between 8 and {MOST_CELLS}", self.resolution)

    @property
    def max(self) -> Vector:
        return tuple(low + side for low, side in zip(self.min, self.size, strict=True))


@dataclass(frozen=True)
class Burner:
    """The burner that surroundings draw under a flame."""

    position: Vector
    """Centre of the emitter, world metres."""
    radius: float
    """Metres."""
    half_height: float
    """From the centre to where the flame begins, metres."""
    name: str = "burner"
    """Its name in messages."""

    @property
    def bottom(self) -> float:
        """Z of the lowest place that gives fuel, world metres."""
        return self.position[2] - self.half_height


@dataclass(frozen=True)
class Fire:
    """The emitter of fuel and what it burns: a fire that we simulate."""

    fuel: str = "propane_high"
    """Fuel: burning rate, colour of the light and amount of soot."""
    shape: Literal["disc", "sphere", "logs"] = "disc"
    """disc: a flat round burner of 1/3 radius height; sphere: a ball; logs: crossed logs."""
    position: Vector = (0.0, 0.0, 0.12)
    """Centre of the emitter, world metres."""
    radius: float = 0.13
    """Radius of the emitter, metres."""
    jet_speed: float = 0.0
    """Upward speed at which the fuel leaves the burner, m/s."""
    light: Literal["soot", "sheets", "reaction"] = "sheets"
    """sheets: soot glows and absorbs in thin sheets, well exposed at every size (`pure.soot`); soot: wherever gas
    burns, as in specs of version 2; reaction: every metre emits equally and nothing is absorbed, as in version 1."""
    speeds: Literal["physical", "solver"] = "physical"
    """physical: lift and burning follow the fire's size, so that gas is as fast as in real fires (`pure.fire_scaling`);
    solver: one set of constants at every size, as in specs of version 1, which is much too fast below a metre."""
    intensity: float = 1.0
    """Factor on the flame's light."""
    logs: int = 3
    """Number of logs, for the shape logs."""

    def __post_init__(self):
        rule = f"in [{LEAST_LOGS}, {MOST_LOGS}]"
        require(LEAST_LOGS <= self.logs <= MOST_LOGS, "fire.logs", rule, self.logs)
        rule = 'left out unless fire.shape is "logs"'
        require(self.shape == "logs" or self.logs == Fire.logs, "fire.logs", rule, self.logs)
        require(0 <= self.jet_speed <= MOST_JET, "fire.jet_speed", f"in [0, {MOST_JET:g}] m/s", self.jet_speed)
        require(self.fuel in FUELS, "fire.fuel", f"one of {', '.join(sorted(FUELS))}", self.fuel)
        require(self.radius > 0, "fire.radius", "positive", self.radius)
        require(0 < self.intensity <= 1e4, "fire.intensity", "in (0, 10000]", self.intensity)

    @property
    def half_size(self) -> Vector:
        """Half extents of the emitter's bounding box, metres."""
        thickness = {"disc": self.radius / 6, "sphere": self.radius, "logs": self.radius / 2}
        return (self.radius, self.radius, thickness[self.shape])

    def check(self, domain: Domain, effects: tuple[Any, ...]) -> None:
        """Raise SpecError if the spec's domain and effects do not fit this fire."""
        sides = zip("xyz", self.position, self.half_size, domain.min, domain.max, strict=True)
        for axis, centre, half, low, high in sides:
            inside = low <= centre - half and centre + half <= high
            if not inside:
                raise SpecError(
                    f"fire.position: the burner reaches from {centre - half:.3g} to {centre + half:.3g} m along "
                    f"{axis}, the domain from {low:.3g} to {high:.3g} m; move it, or change fire.radius or domain.size"
                )

    def box(self, domain: Domain, timeline: Timeline) -> Domain:
        """Return the box that the flame's cells fill."""
        return domain

    @cached_property
    def sheet(self) -> Sheet:
        """Return the sheet that the flame's light looks up, unless its light is that of the reaction."""
        return sheet(FUELS[self.fuel], 2 * self.radius, self.intensity, thin=self.light == "sheets")

    @property
    def dims(self) -> bool:
        """Return whether the flame dims what is behind it."""
        return self.light != "reaction"

    @property
    def burner(self) -> Burner:
        """Return the burner that surroundings draw under the flame."""
        return Burner(self.position, self.radius, self.half_size[2])

    def bake_steps(self, timeline: Timeline) -> int:
        """Count the steps that the bake makes, from the first that is simulated."""
        return timeline.last_frame

    @property
    def title(self) -> str:
        """Return the name of the fuel, for people."""
        return self.fuel.replace("_", " ")


@dataclass(frozen=True)
class GridFire:
    """A fire of any other solver, as grids on a clock (`FireStore`); nothing is simulated.

    The spec's `clip` says which part of it is seen: dataset frame 0 is `start_s` on the grids' clock, `time_scale`
    below 1 is slow motion, and nothing warms up.
    """

    grids: str
    """Folder of the fire; relative to the folder of the spec, or absolute."""
    start_s: float = 0.0
    """Time of dataset frame 0 on the grids' clock, seconds."""
    position: Vector = (0.0, 0.0, 0.0)
    """Place of the origin of the grids' axes, world metres."""
    radiance: float = 1.0
    """Linear scene radiance per unit of emission, as a solver gives light only up to a factor."""

    def __post_init__(self):
        require(self.radiance > 0, "fire.radiance", "positive", self.radiance)

    @property
    def dims(self) -> bool:
        """Return whether the flame dims what is behind it."""
        return False

    @cached_property
    def store(self) -> FireStore:
        """Return the fire's folder, opened. Raises SpecError if it is not whole."""
        try:
            return FireStore(Path(self.grids))
        except GofError as error:
            raise SpecError(f"fire.grids: {error}") from error

    def check(self, domain: Domain | None, effects: tuple[Any, ...]) -> None:
        """Raise SpecError if the spec's domain and effects do not fit this fire. Its folder is not opened."""
        require(domain is None, "domain", "left out: a fire of grids has its own box", domain)
        changing = [effect_modules.name_of(effect) for effect in effects if effect_modules.changes_bake(effect)]
        require(not changing, "effects", "those of cameras and pictures: a fire of grids is not simulated", changing)

    def require_clock(self, timeline: Timeline) -> None:
        """Raise SpecError if the grids' clock does not cover what pictures and truth look at."""
        steps, time_s = timeline.steps_needed, self.store.velocity.times_s
        first, last = (self.start_s + timeline.simulated_s(step) for step in (steps[0], steps[-1]))
        rule = (
            f"such that the clip, {first:g}..{last:g} s with what its shutters see, lies in the clock of {self.grids}, "
            f"{time_s[0]:g}..{time_s[-1]:g} s"
        )
        require(self.store.covers(first, last), "fire.start_s", rule, self.start_s)

    def box(self, domain: Domain | None, timeline: Timeline) -> Domain:
        """Return the box that the flame's cells fill. Raises SpecError: see `store`, `require_clock`."""
        self.require_clock(timeline)
        low = np.add(self.store.index_to_world[:3, 3], self.position)
        size = np.multiply(self.store.grid, self.store.cell_m)
        return Domain(tuple(low.tolist()), tuple(size.tolist()), max(self.store.grid))

    @property
    def burner(self) -> Burner | None:
        """Return the burner that surroundings draw: a round one around all burners that the solver lists.

        None where the grids are not at hand, as in a dataset that was copied. Raises SpecError: see `store`.
        """
        if not Path(self.grids).exists():
            return None
        hearths = self.store.description.hearths
        if not hearths:
            return None
        places = np.add([hearth.position_m for hearth in hearths], self.position)
        centre = (places.min(0) + places.max(0)) / 2
        reach = np.linalg.norm(places - centre, axis=1) + [hearth.diameter_m / 2 for hearth in hearths]
        name = "hearth of the grids" if len(hearths) == 1 else f"circle around the grids' {len(hearths)} hearths"
        return Burner(tuple(centre.tolist()), float(reach.max()), 0.0, name)

    def bake_steps(self, timeline: Timeline) -> int:
        """Count the steps that the bake makes: those that are looked at."""
        return len(timeline.steps_needed)

    @property
    def title(self) -> str:
        """Return the name of the fuel, for people."""
        return f"grids of {self.grids}"
