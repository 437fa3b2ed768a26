"""A fire as gas at low Mach number: buoyancy, burning and expansion on a staggered grid, by numpy and scipy.

Pressure is uniform but for what moves the gas, so that density times temperature is one constant, and the heat of
burning is the divergence of the velocity. Density, mixture and fuel are carried in conservative form by a limited
second-order scheme (van Leer 1974), so that mass and fuel balance to rounding. The pressure's equation has constant
coefficients (Dodd and Ferrante 2014: the true density meets the last pressure) and is solved by cosine and sine
transforms. Fuel burns with air as fast as a grid's cell mixes them (eddy dissipation; its time is that in which
buoyancy crosses a cell). Nothing damps the motion but the scheme itself; walls are smooth and take no heat.

Where it fails: a pool of 0.3 m and 33 kW, six cells wide and fed evenly, settles to a steady column. It does not puff
(1.5/sqrt(diameter) says 2.7 Hz), so its plume mixes with no air: on the axis the gas is 0.9 to 1.2 times as fast as
McCaffrey's law up to 0.33 m, 1.7 times at 0.78 m and 2.5 times at 1.5 m, and from 1.5 to 5 times as hot above ambient.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.fft import dct, dst, idct, idst

GRAVITY = 9.81  # m/s2
AMBIENT_K, AMBIENT_DENSITY, HEAT_CAPACITY = 293.0, 1.2, 1100.0  # K, kg/m3, J/(kg K): one constant for all gas
HOTTEST_K = 2500.0  # nothing burns in gas as hot: it would come apart
AIR_PER_FUEL, FUEL_HEAT = 15.0, 44e6  # kg, and J/kg, of a kilogram of hydrocarbon that nothing dilutes
COURANT = 0.65  # cells that the gas may cross in a step, the three directions together
FASTEST_START = 0.5  # of buoyancy's time over a cell: the longest step, for gas that still stands

Open = tuple[bool, bool]
"""Whether an axis is open at its low and at its high end; a wall where it is not."""


@dataclass(frozen=True)
class Box:
    """Where the gas is.

    Attributes:
        cells: (3,) along X, Y, Z (up).    cell: their edge, m.    origin: lowest corner, world m.
        open: by axis; see `Open`. The top must be.
    """

    cells: tuple[int, int, int]
    cell: float
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    open: tuple[Open, Open, Open] = ((True, True), (True, True), (False, True))

    def centres(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return x (X, 1, 1), y (1, Y, 1), z (1, 1, Z) of the cells' centres, world m."""
        axes = [o + self.cell * (np.arange(n) + 0.5) for o, n in zip(self.origin, self.cells, strict=True)]
        return tuple(np.meshgrid(*axes, indexing="ij", sparse=True))

    @property
    def index_to_world(self) -> np.ndarray:
        """(4, 4) as of `VelocityField`."""
        matrix = np.diag([self.cell, self.cell, self.cell, 1.0])
        matrix[:3, 3] = self.origin
        return matrix


@dataclass(frozen=True)
class Burner:
    """Cells from which fuel comes.

    Attributes:
        share: (X, Y, Z) of the fuel, sum 1.
        power: W when everything burns.
        supply: time in s -> (X, Y, Z) or a number, factor of the supply, >= 0.
        velocity: (3,) m/s that the gas has where it comes out; None leaves that to the gas.
    """

    share: np.ndarray
    power: float
    supply: Callable[[float], np.ndarray | float] = lambda time_s: 1.0
    velocity: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class Drive:
    """Air that is kept in motion: wind at the rim, or vanes that make a whirl.

    Attributes:
        strength: (X, Y, Z) 1/s, how fast the gas takes the velocity; 0 where it is free.
        velocity: time in s -> three arrays that broadcast to (X, Y, Z), m/s.
    """

    strength: np.ndarray
    velocity: Callable[[float], tuple[np.ndarray, np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Chemistry:
    """How the fuel burns.

    Attributes:
        strength: share of a burner's gas that burns at all; the rest is inert, and makes jets short.
        mixing: time of burning over that in which buoyancy crosses a cell.
        radiated: share of the heat that leaves as light and never warms the gas.
        soot_s, burn_off_s: time in which rich hot gas makes soot, and in which lean hot gas takes it away, s.
    """

    strength: float = 1.0
    mixing: float = 0.7
    radiated: float = 0.3
    soot_s: float = 0.05
    burn_off_s: float = 0.02

    @property
    def air_per_fuel(self) -> float:
        """Mass of air that burns a unit of the burner's gas."""
        return AIR_PER_FUEL * self.strength

    @property
    def fuel_heat(self) -> float:
        """Heat of a kilogram of the burner's gas, J/kg, light included."""
        return FUEL_HEAT * self.strength

    @property
    def stoichiometric(self) -> float:
        """Mixture fraction at which neither fuel nor air is left."""
        return 1 / (1 + self.air_per_fuel)


@dataclass
class Gas:
    """The gas of a box, which `step` moves on.

    Attributes:
        u, v, w: velocities on the faces, (X + 1, Y, Z), (X, Y + 1, Z), (X, Y, Z + 1), m/s.
        density: kg/m3.    mixture: mass fraction that came from a burner, burnt or not.    fuel: unburnt.
        soot: relative, any unit; all (X, Y, Z).
        heat: W/m3 that the last step set free, light included.
        time_s: since the start.
        budget: kg and J that went in and out since the start; see `Budget`.
    """

    box: Box
    burners: tuple[Burner, ...]
    chemistry: Chemistry = field(default_factory=Chemistry)
    drive: Drive | None = None
    start: tuple[np.ndarray, np.ndarray, np.ndarray] | None = None

    def __post_init__(self):
        shape = self.box.cells
        if not self.box.open[2][1]:
            raise ValueError("the top must be open: burning gas needs room")
        self.u, self.v, self.w = self._faces() if self.start is None else [np.array(a, np.float32) for a in self.start]
        zeros = np.zeros((4, *shape), np.float32)
        zeros[0] = AMBIENT_DENSITY
        self.density, self.mixture, self.fuel, self.soot = zeros
        self.heat = np.zeros(shape, np.float32)
        self.time_s = 0.0
        self.budget = Budget()
        self._pressure = np.zeros(shape, np.float32)
        self._poisson = Poisson(self.box.open, shape)
        self._divergence = np.zeros(shape, np.float32)

    def _faces(self) -> list[np.ndarray]:
        x, y, z = self.box.cells
        return [np.zeros(size, np.float32) for size in ((x + 1, y, z), (x, y + 1, z), (x, y, z + 1))]

    @property
    def temperature(self) -> np.ndarray:
        """(X, Y, Z) K."""
        return AMBIENT_DENSITY * AMBIENT_K / self.density

    @property
    def velocity(self) -> np.ndarray:
        """(X, Y, Z, 3) m/s at the cells' centres."""
        faces = self.u, self.v, self.w
        return np.stack([(_low(a, axis) + _high(a, axis)) / 2 for axis, a in enumerate(faces)], -1)

    @property
    def safe_step_s(self) -> float:
        """Longest step that the scheme bears."""
        faces = [np.abs(a) for a in (self.u, self.v, self.w)]
        fastest = float(sum(np.maximum(_low(a, k), _high(a, k)) for k, a in enumerate(faces)).max())
        return min(COURANT * self.box.cell / max(fastest, 1e-9), FASTEST_START * (self.box.cell / GRAVITY) ** 0.5)

    def run_to(self, time_s: float) -> None:
        """Move on to a time, in as many equal steps as that takes."""
        while (left := time_s - self.time_s) > 1e-9:
            self.step(left / np.ceil(left / self.safe_step_s))

    def step(self, dt: float) -> None:
        """Move on by dt s."""
        carried = self._carried_velocities(dt)
        self._carry(dt)
        supply = np.zeros(self.box.cells)
        for burner in self.burners:
            supply += burner.share * burner.supply(self.time_s) * (burner.power / self.chemistry.fuel_heat)  # kg/s
        source = (supply / self.box.cell**3).astype(np.float32)  # kg/(m3 s)
        self._feed(source, dt)
        self._burn(dt)
        warm = (1 - self.chemistry.radiated) / (AMBIENT_DENSITY * AMBIENT_K * HEAT_CAPACITY)
        self._divergence = self.heat * np.float32(warm) + source / np.float32(AMBIENT_DENSITY)
        self._push(carried, dt)
        self.time_s += dt

    # ---- what is carried --------------------------------------------------------------------------------------------

    def _carry(self, dt: float) -> None:
        """Move density and, with the mass, what it holds."""
        held = np.stack([self.density, self.mixture, self.fuel, self.soot])
        masses = held.copy()
        masses[1:] *= self.density
        outside = np.array([AMBIENT_DENSITY, 0, 0, 0], np.float32).reshape(4, 1, 1, 1)
        ratio = np.float32(dt / self.box.cell)
        for axis, speed in enumerate((self.u, self.v, self.w)):
            flux = _face_values(held, speed[None], ratio, axis + 1, outside)
            flux[0] *= speed
            flux[1:] *= flux[:1]
            masses -= ratio * (_high(flux, axis + 1) - _low(flux, axis + 1))
            self.budget.leave(flux, axis, dt * self.box.cell**2)
        self.density = masses[0]
        self.mixture, self.fuel, self.soot = np.maximum(masses[1:] / masses[0], 0)

    def _carried_velocities(self, dt: float) -> list[np.ndarray]:
        """Return u, v, w after their own motion has carried them."""
        faces = self.u, self.v, self.w
        ratio = np.float32(dt / self.box.cell)
        results = []
        for own, a in enumerate(faces):
            change = np.zeros_like(a)
            for axis, speed in enumerate(faces):
                across = _pad(speed, own, 1)
                across = (_low(across, own) + _high(across, own)) / 2
                if axis == own:
                    across = _pad((_low(a, own) + _high(a, own)) / 2, own, 1)
                value = _face_values(a, across, ratio, axis)
                change -= _high(value * across, axis) - _low(value * across, axis)
                change += a * (_high(across, axis) - _low(across, axis))
            results.append(a + ratio * change)
        return results

    # ---- what burns -------------------------------------------------------------------------------------------------

    def _feed(self, source: np.ndarray, dt: float) -> None:
        """Add fuel, kg/(m3 s), as cold as the air."""
        added = source * np.float32(dt)
        density = self.density + added
        self.mixture = (self.mixture * self.density + added) / density
        self.fuel = (self.fuel * self.density + added) / density
        self.soot = self.soot * self.density / density
        self.density = density
        self.budget.fed += float(added.sum(dtype=np.float64)) * self.box.cell**3

    def _burn(self, dt: float) -> None:
        """Let fuel and air meet as fast as the cells mix them."""
        chemistry = self.chemistry
        air = np.maximum(1 - self.mixture - chemistry.air_per_fuel * (self.mixture - self.fuel), 0)
        hot = self.temperature
        mixing_s = chemistry.mixing * (self.box.cell / GRAVITY) ** 0.5
        share = np.float32(1 - np.exp(-dt / mixing_s)) * np.clip((HOTTEST_K - hot) / 200, 0, 1)
        burnt = share * np.minimum(self.fuel, air / np.float32(chemistry.air_per_fuel))
        self.fuel = self.fuel - burnt
        self.heat = self.density * burnt * np.float32(chemistry.fuel_heat / dt)
        growing = np.clip((hot - 900) / 500, 0, 1) * np.maximum(self.fuel - 0.02 * self.mixture, 0)
        going = np.clip((hot - 1000) / 500, 0, 1) * air * np.float32(dt / chemistry.burn_off_s)
        self.soot = (self.soot + np.float32(dt / chemistry.soot_s) * growing) / (1 + 5 * going)
        self.budget.burnt += float((self.density * burnt).sum(dtype=np.float64)) * self.box.cell**3

    # ---- what pushes ------------------------------------------------------------------------------------------------

    def _push(self, carried: list[np.ndarray], dt: float) -> None:
        """Add buoyancy, burners' and driven air, and the pressure that makes the divergence what burning asks for."""
        lightest = float(self.density.min())
        lift = GRAVITY * (AMBIENT_DENSITY / self.density - 1)
        forces = [0.0, 0.0, _to_faces(lift, 2)]
        slack = 1 / self.density - 1 / lightest  # <= 0: of the true density's share in the last pressure
        driven = self.drive.velocity(self.time_s) if self.drive else None
        new = []
        for axis, (a, force) in enumerate(zip(carried, forces, strict=True)):
            a = a + np.float32(dt) * (force - _to_faces(slack, axis) * self._slope(self._pressure, axis))
            for burner in self.burners:
                if burner.velocity is not None:
                    held = np.minimum(_to_faces(burner.share / burner.share.max(), axis), 1)
                    a += held * (np.float32(burner.velocity[axis]) - a)
            if self.drive:
                held = 1 - np.exp(-dt * _to_faces(self.drive.strength, axis))
                a += held * (_to_faces(np.broadcast_to(driven[axis], self.box.cells), axis) - a)
            new.append(self._stopped_at_walls(a.astype(np.float32, copy=False), axis))
        excess = sum(_high(a, k) - _low(a, k) for k, a in enumerate(new)) / np.float32(self.box.cell)
        excess -= self._divergence
        scale = self.box.cell**2 * lightest / dt
        self._pressure = self._poisson(excess * np.float32(scale))
        kick = np.float32(dt / lightest)
        self.u, self.v, self.w = (a - kick * self._slope(self._pressure, k) for k, a in enumerate(new))

    def _stopped_at_walls(self, a: np.ndarray, axis: int) -> np.ndarray:
        low, high = self.box.open[axis]
        ends = np.moveaxis(a, axis, 0)
        if not low:
            ends[0] = 0
        if not high:
            ends[-1] = 0
        return a

    def _slope(self, pressure: np.ndarray, axis: int) -> np.ndarray:
        """Return d/dm on the faces of an axis; the pressure is 0 at an open end, and even across a wall."""
        low, high = self.box.open[axis]
        first, last = _end(pressure, axis, 0), _end(pressure, axis, -1)
        padded = np.concatenate([-first if low else first, pressure, -last if high else last], axis)
        return np.diff(padded, axis=axis) / np.float32(self.box.cell)


@dataclass
class Budget:
    """What crossed the box's faces and what was fed and burnt since the start.

    Attributes:
        fed, burnt: fuel, kg.
        mass_out, mixture_out, fuel_out: kg through the open faces, less what came in.
    """

    fed: float = 0.0
    burnt: float = 0.0
    mass_out: float = 0.0
    mixture_out: float = 0.0
    fuel_out: float = 0.0

    def leave(self, flux: np.ndarray, axis: int, factor: float) -> None:
        """Count flux (4, ...) kg/(m2 s) through both ends of an axis; factor: m2 s."""
        ends = np.moveaxis(flux, axis + 1, 1)
        mass, mixture, fuel = factor * (ends[:3, -1].sum((1, 2), np.float64) - ends[:3, 0].sum((1, 2), np.float64))
        self.mass_out += mass
        self.mixture_out += mixture
        self.fuel_out += fuel


class Poisson:
    """Solve the seven-point Poisson equation on cells: pressure 0 on open ends, no slope across walls."""

    KINDS = {(True, True): (dst, idst, 2), (False, False): (dct, idct, 2)}
    KINDS |= {(False, True): (dct, idct, 4), (True, False): (dst, idst, 4)}

    def __init__(self, open_ends: tuple[Open, Open, Open], cells: tuple[int, int, int]):
        self._kinds = [self.KINDS[ends] for ends in open_ends]
        waves = [self._wave(ends, n) for ends, n in zip(open_ends, cells, strict=True)]
        self._eigenvalues = -sum(np.meshgrid(*waves, indexing="ij", sparse=True)).astype(np.float32)

    @staticmethod
    def _wave(ends: Open, n: int) -> np.ndarray:
        first = {(True, True): 1.0, (False, False): 0.0}.get(ends, 0.5)
        return 2 - 2 * np.cos(np.pi * (np.arange(n) + first) / n)

    def __call__(self, right: np.ndarray) -> np.ndarray:
        """Return p (X, Y, Z) whose sum of differences to its six neighbours is `right`."""
        for axis, (there, _, kind) in enumerate(self._kinds):
            right = there(right, kind, axis=axis)
        right = right / self._eigenvalues
        for axis, (_, back, kind) in enumerate(self._kinds):
            right = back(right, kind, axis=axis)
        return right


def _face_values(
    a: np.ndarray, speed: np.ndarray, ratio: np.float32, axis: int, outside: np.ndarray | None = None
) -> np.ndarray:
    """Return values on the n + 1 faces along an axis that the gas carries through them in a step (van Leer).

    Args:
        a: (..., n, ...) in the cells.    speed: (..., n + 1, ...) m/s.    ratio: s/m, of a step over a cell.
        outside: what lies beyond both ends; the end's own value where it is None.
    """
    padded = _pad(a, axis, 2) if outside is None else _surrounded(a, axis, outside)
    n = a.shape[axis]
    difference = np.diff(padded, axis=axis)
    here = _part(difference, axis, 1, n + 2)
    ahead = speed > 0
    behind = np.where(ahead, _part(difference, axis, 0, n + 1), _part(difference, axis, 2, n + 3))
    product = here * behind
    limited = np.where(product > 0, product / np.where(product > 0, here + behind, 1), 0)
    donor = np.where(ahead, _part(padded, axis, 1, n + 2), _part(padded, axis, 2, n + 3))
    return donor + (np.where(ahead, np.float32(1), np.float32(-1)) - ratio * speed) * limited


def _part(a: np.ndarray, axis: int, first: int, end: int) -> np.ndarray:
    return a[(slice(None),) * axis + (slice(first, end),)]


def _low(a: np.ndarray, axis: int) -> np.ndarray:
    return _part(a, axis, 0, a.shape[axis] - 1)


def _high(a: np.ndarray, axis: int) -> np.ndarray:
    return _part(a, axis, 1, a.shape[axis])


def _end(a: np.ndarray, axis: int, which: int) -> np.ndarray:
    return _part(a, axis, 0, 1) if which == 0 else _part(a, axis, a.shape[axis] - 1, a.shape[axis])


def _pad(a: np.ndarray, axis: int, width: int) -> np.ndarray:
    """Return a with its ends repeated."""
    first, last = _end(a, axis, 0), _end(a, axis, -1)
    return np.concatenate([first] * width + [a] + [last] * width, axis)


def _surrounded(a: np.ndarray, axis: int, outside: np.ndarray) -> np.ndarray:
    shape = list(a.shape)
    shape[axis] = 2
    beyond = np.broadcast_to(outside, shape).astype(a.dtype)
    return np.concatenate([beyond, a, beyond], axis)


def _to_faces(a: np.ndarray, axis: int) -> np.ndarray:
    """Return means of neighbours along an axis, the end's own value at both ends; float32."""
    padded = _pad(np.asarray(a, np.float32), axis, 1)
    return (_low(padded, axis) + _high(padded, axis)) / 2
