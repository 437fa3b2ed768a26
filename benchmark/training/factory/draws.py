"""What burns, how it shines and who looks: all of a fire from its number."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gof_benchmark.training.factory.light import LAWS, Law
from gof_benchmark.training.factory.solver import (
    AMBIENT_DENSITY,
    AMBIENT_K,
    GRAVITY,
    HEAT_CAPACITY,
    Box,
    Burner,
    Chemistry,
    Drive,
    Gas,
)

KINDS = ("pool", "line", "ring", "logs", "wall", "corner", "glass", "whirl", "jet", "two", "wind")
CELLS_UP = 26  # of the box's height: a fire in seconds
LEAST_HZ, MOST_HZ = 25.0, 400.0


@dataclass(frozen=True)
class Draw:
    """A fire before it burns.

    Attributes:
        number: which one.    kind: of `KINDS`.    law, sharpness_k: as of `light.emission`.
        gas: ready to start.    warm_s: until it burns as it will.
        flame_m, flame_speed: how long and how fast it should be, m and m/s, by Heskestad and McCaffrey.
        frames, rate_hz: of the clip.
        azimuth_deg, height_deg: (C,) where the cameras stand.    away, longest_px: as of `pictures.around`.
        exposure: linear light of the picture's bright parts.    thickness: optical depth there.
        colour: (3,) of the light.    plate: its brightness, linear.    plate_fire: of the mean flame left in the plate.
        noise: std-dev, display values.
    """

    number: int
    kind: str
    law: Law
    sharpness_k: float
    gas: Gas
    warm_s: float
    flame_m: float
    flame_speed: float
    frames: int
    rate_hz: float
    azimuth_deg: np.ndarray
    height_deg: np.ndarray
    away: float
    longest_px: int
    exposure: float
    thickness: float
    colour: np.ndarray
    plate: float
    plate_fire: float
    noise: float

    @classmethod
    def of(cls, number: int) -> Draw:
        """Return the fire of a number >= 0; kinds and laws take turns, so that any few dozen in a row hold them all."""
        rng = np.random.default_rng([2207, number])
        kind, law = KINDS[number % len(KINDS)], LAWS[sum(divmod(number, len(KINDS))) % len(LAWS)]
        place = _Place(kind, rng)
        gas = place.gas()
        speed = 0.55 * 6.84 * place.flame_m**0.5 + 0.3 * place.jet
        rate = float(np.clip(speed / (_log(rng, 0.012, 0.08) * place.flame_m), LEAST_HZ, MOST_HZ))
        count = int(rng.choice([1, 2, 3, 4, 5, 6], p=[0.04, 0.1, 0.56, 0.14, 0.08, 0.08]))
        spread = rng.uniform(-0.5, 0.5) if count == 1 else np.linspace(-0.5, 0.5, count)
        return cls(
            number=number,
            kind=kind,
            law=law,
            sharpness_k=float(rng.uniform(5_000, 16_000)),
            gas=gas,
            warm_s=2.2 * place.flame_m / speed + 0.5 * place.flame_m**0.5,
            flame_m=place.flame_m,
            flame_speed=speed,
            frames=15,
            rate_hz=rate,
            azimuth_deg=rng.uniform(0, 360) + rng.uniform(40, 130) * spread + rng.normal(0, 3, count),
            height_deg=rng.uniform(-5, 28) + rng.normal(0, 2, count),
            away=float(rng.uniform(1.4, 3)),
            longest_px=int(rng.integers(150, 215)),
            exposure=_log(rng, 0.4, 3),
            thickness=float(rng.choice([0.0, _log(rng, 0.2, 3)])),
            colour=np.array([1.0, rng.uniform(0.3, 0.6), rng.uniform(0.04, 0.2)]),
            plate=float(rng.uniform(0.002, 0.05)),
            plate_fire=float(rng.choice([0.0, rng.uniform(0.0, 0.15)], p=[0.8, 0.2])),
            noise=float(rng.uniform(0.001, 0.008)),
        )


def _log(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


class _Place:
    """The burner, the walls and the air around of a kind of fire."""

    def __init__(self, kind: str, rng: np.random.Generator):
        self.kind, self.rng = kind, rng
        self.jet = 0.0
        self.chemistry = Chemistry(mixing=_log(rng, 0.4, 1.4), radiated=float(rng.uniform(0.15, 0.4)))
        self.size = _log(rng, 0.02, 2.0)  # of the burner, m
        if kind == "jet":
            self._draw_jet()
        else:
            strong = {"line": (0.15, 0.5), "logs": (0.4, 1.2), "wall": (0.3, 1.0), "two": (0.6, 2.5)}
            self.vigour = _log(rng, *strong.get(kind, (0.4, 2.5)))  # Q*, heat over what buoyancy carries away
            flow = AMBIENT_DENSITY * HEAT_CAPACITY * AMBIENT_K * (GRAVITY * self.size) ** 0.5 * self.size**2
            self.power = self.vigour * flow
            self.flame_m = (3.7 * self.vigour**0.4 - 1.02) * self.size  # Heskestad 1983
        self.flame_m = max(self.flame_m, 0.9 * self.size)
        wide, deep = self._room()
        self.height = 1.35 * self.flame_m
        cell = self.height / CELLS_UP
        self.chemistry = Chemistry(
            strength=self.chemistry.strength,
            mixing=self.chemistry.mixing,
            radiated=self.chemistry.radiated,
            soot_s=0.15 * self.flame_m**0.5 / 3,
            burn_off_s=_log(rng, 0.02, 0.2) * self.flame_m**0.5 / 3,
        )
        cells = tuple(max(12, round(side / cell)) for side in (wide, deep)) + (CELLS_UP,)
        floor = kind in ("glass", "whirl") or (kind != "wall" and rng.random() < 0.3)
        shut = {"wall": ((False, True), (True, True)), "corner": ((False, True), (False, True))}
        shut |= dict.fromkeys(("glass", "whirl"), ((False, False), (False, False)))
        sides = shut.get(kind, ((True, True), (True, True)))
        origin = (-cells[0] * cell / 2, -cells[1] * cell / 2, 0.0)
        self.box = Box(cells, cell, origin, (*sides, (floor, True)))

    def _draw_jet(self) -> None:
        """Draw a jet of diluted fuel: some five diameters long for every kilogram of air that one of it needs."""
        strength = self.rng.uniform(0.12, 0.3)
        self.chemistry = Chemistry(strength, self.chemistry.mixing, self.chemistry.radiated)
        self.size = _log(self.rng, 0.01, 0.12)
        self.jet = float(self.rng.uniform(0.3, 8.0))
        self.flame_m = 4.5 * (1 + self.chemistry.air_per_fuel) * self.size
        self.power = np.pi / 4 * self.size**2 * self.jet * AMBIENT_DENSITY * self.chemistry.fuel_heat
        self.lean = float(np.radians(self.rng.choice([0.0, self.rng.uniform(10, 80)], p=[0.4, 0.6])))

    def _room(self) -> tuple[float, float]:
        """Return how wide and deep the box is, m."""
        near = max(2.0 * self.size, 0.6 * self.flame_m)
        if self.kind == "line":
            return max(1.9 * self.size, 0.6 * self.flame_m), max(0.5 * self.size, 0.55 * self.flame_m)
        if self.kind == "jet":
            return max(0.45, 1.7 * np.sin(self.lean)) * self.flame_m, 0.45 * self.flame_m
        wide = {"wind": 1.6, "two": 1.7}.get(self.kind, 1.0)
        return wide * near, near

    def gas(self) -> Gas:
        """Return the gas, ready to start."""
        drive, start = None, None
        if self.kind == "wind":
            drive, start = self._wind()
        elif self.kind == "whirl":
            drive = self._vanes()
        return Gas(self.box, tuple(self._burners()), self.chemistry, drive, start)

    # ---- burners ----------------------------------------------------------------------------------------------------

    def _burners(self) -> list[Burner]:
        x, y, z = self.box.centres()
        cell, size, rng = self.box.cell, self.size, self.rng
        low = z < max(1.5 * cell, 0.08 * size)
        left, front = -self.box.origin[0], -self.box.origin[1]
        if self.kind == "two":
            return self._two(x, y, low)
        if self.kind == "jet":
            return [self._nozzle(x, y, z)]
        if self.kind == "line":
            where = (abs(x) < size / 2) & (abs(y) < max(0.05 * size, 0.8 * cell)) & low
        elif self.kind == "ring":
            where = (abs(np.hypot(x, y) - 0.4 * size) < max(0.1 * size, 0.6 * cell)) & low
        elif self.kind == "logs":
            where = self._logs(x, y, z)
        elif self.kind == "wall":
            up = rng.uniform(0.1, 0.5) * self.flame_m
            where = (x + left < max(0.08 * size, 1.2 * cell)) & (abs(y) < size / 2) & (z < max(up, 2 * cell))
        elif self.kind == "corner":
            where = (x + left < 0.8 * size) & (y + front < 0.8 * size) & low
        else:
            where = (np.hypot(x + (0.3 * left if self.kind == "wind" else 0), y) < size / 2) & low
        return [Burner(_share(where), self.power, self._supply(x, y))]

    def _two(self, x: np.ndarray, y: np.ndarray, low: np.ndarray) -> list[Burner]:
        """Two that are unlike: another size, another vigour."""
        apart = 0.45 * max(2.0 * self.size, 0.6 * self.flame_m)
        smaller = self.rng.uniform(0.5, 0.95)
        weaker = self.rng.uniform(0.35, 1.0)
        burners = []
        for place, size, factor in ((-apart, self.size, 1.0), (apart, smaller * self.size, weaker * smaller**2.5)):
            where = (np.hypot(x - place, y) < size / 2) & low
            burners.append(Burner(_share(where), factor * self.power, self._supply(x, y)))
        return burners

    def _nozzle(self, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> Burner:
        out = np.array([np.sin(self.lean), 0.0, np.cos(self.lean)])
        side = self.box.origin[0] * 0.75 * np.sin(self.lean)
        rise = 0.12 * self.height + 0.25 * self.height * np.sin(self.lean) ** 2
        place = np.stack(np.broadcast_arrays(x - side, y, z - rise), -1)
        along = place @ out
        across = np.linalg.norm(place - along[..., None] * out, axis=-1)
        radius = max(self.size / 2, 1.2 * self.box.cell)
        where = (across < radius) & (abs(along) < 1.2 * self.box.cell)
        widened = (self.size / 2 / radius) ** 2  # a wider mouth lets out as much, no faster than the nozzle would
        speed = self.jet * max(widened, 0.5)
        return Burner(_share(where), self.power, velocity=tuple((speed * out).tolist()))

    def _logs(self, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        where = np.zeros(self.box.cells, bool)
        thick = max(0.1 * self.size, 0.9 * self.box.cell)
        for k in range(int(self.rng.integers(2, 6))):
            turn = self.rng.uniform(0, np.pi)
            aside = abs(-np.sin(turn) * x + np.cos(turn) * y - self.rng.uniform(-0.15, 0.15) * self.size)
            along = abs(np.cos(turn) * x + np.sin(turn) * y)
            where |= (np.hypot(aside, z - thick * (1 + 1.5 * (k % 2))) < thick) & (along < self.size / 2)
        return where

    def _supply(self, x: np.ndarray, y: np.ndarray):
        """Return a supply in large patches that wander, flare up, and in some fires nearly go out."""
        rng = self.rng
        strength = float(rng.choice([0.15, rng.uniform(0.3, 1.2)]))
        flare = float(rng.choice([0.0, rng.uniform(0.3, 1.6)], p=[0.6, 0.4]))
        crossing = (self.size / GRAVITY) ** 0.5
        waves = rng.normal(0, 2 * np.pi / self.size, (4, 2))
        turns, phases = rng.normal(0, 2 / crossing, 4), rng.uniform(0, 2 * np.pi, 4)
        swing = 2 * np.pi / (crossing * _log(rng, 2, 12))

        def supply(time_s: float) -> np.ndarray:
            patches = sum(
                np.cos(kx * x + ky * y + turn * time_s + phase)
                for (kx, ky), turn, phase in zip(waves, turns, phases, strict=True)
            )
            level = max(1 + flare * np.sin(swing * time_s), 0.0)
            return level * np.clip(1 + 0.7 * strength * patches, 0, 3)

        return supply

    # ---- air --------------------------------------------------------------------------------------------------------

    def _wind(self) -> tuple[Drive, tuple[np.ndarray, ...]]:
        """Return air that blows along +X, weaker at the floor, and is kept blowing at the rim."""
        z = self.box.centres()[2]
        shape = self.box.cells
        speed = self.rng.uniform(0.1, 0.5) * (GRAVITY * self.flame_m) ** 0.5
        gusts, period = self.rng.uniform(0, 0.6), _log(self.rng, 1, 6) * self.flame_m**0.5
        profile = np.broadcast_to(np.clip(z / (0.15 * self.height), 0.3, 1) ** 0.3, shape)
        edge = np.minimum.reduce([_from_ends(shape, 0), _from_ends(shape, 1)])
        strength = np.clip(1 - edge / 3, 0, 1) * 4 * speed / (3 * self.box.cell)
        still = np.zeros((1, 1, 1))

        def blowing(time_s: float):
            return speed * (1 + gusts * np.sin(2 * np.pi * time_s / period)) * profile, still, still

        nx, ny, nz = shape
        u = np.broadcast_to(speed * profile[:1], (nx + 1, ny, nz))
        return Drive(strength, blowing), (u, np.zeros((nx, ny + 1, nz)), np.zeros((nx, ny, nz + 1)))

    def _vanes(self) -> Drive:
        """Return air that is turned about the axis along the glass, as vanes at its slits would."""
        x, y = self.box.centres()[:2]
        shape = self.box.cells
        speed = self.rng.uniform(0.3, 1.1) * 2 * self.flame_m**0.5
        radius = np.hypot(x, y) + 1e-9
        edge = np.minimum.reduce([_from_ends(shape, 0), _from_ends(shape, 1)])
        strength = np.clip(1 - edge / 4, 0, 1) * 3 * speed / (3 * self.box.cell)
        still = np.zeros((1, 1, 1))
        rising = still + 0.3 * self.flame_m**0.5
        return Drive(strength, lambda time_s: (-speed * y / radius, speed * x / radius, rising))


def _share(where: np.ndarray) -> np.ndarray:
    """Return a mask's cells with the same share each."""
    if not where.any():
        raise ValueError("a burner that covers no cell")
    return (where / where.sum()).astype(np.float32)


def _from_ends(shape: tuple[int, int, int], axis: int) -> np.ndarray:
    """Return how many cells lie between each cell and the nearer end of an axis, (X, Y, Z)."""
    n = shape[axis]
    number = np.arange(n)
    size = [1, 1, 1]
    size[axis] = n
    return np.broadcast_to(np.minimum(number, number[::-1]).reshape(size), shape)
