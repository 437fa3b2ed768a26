"""TransientGaussians: the data model of a reconstruction, and the methods of every model of moving Gaussians.

Each Gaussian is a short-lived volumetric carrier of emission (paper, "Dynamic Scene"):
x(t) = x0 + (t - t_mu) v and opacity(t) = opacity * exp(-0.5 ((t - t_mu) / t_sigma)^2).

Light is no dye: flames go out and on again while the gas flows through them, so what shines moves at another velocity
than the gas it shines in (0.55 to 0.8 of it on the benchmark's fires). A Gaussian may know both: `velocity` moves it,
and `gas_velocity` is what it says of the gas. The paper has one for both, and so has every other method.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Protocol, TypeVar

import numpy as np

from . import results
from .datum import Datum
from .errors import DataFormatError, naming, require_finite
from .similarity import transformed_splats

LIFE_SIGMAS = 3.0  # a Gaussian lives for this many t_sigma before and after t_mu; then 99 % of its opacity is gone
VISIBLE = 1 / 255  # opacity below which a Gaussian changes no 8-bit picture
FILLED_IN: Any = None  # default of an array that is there once its owner is constructed


M = TypeVar("M", bound="MovingGaussians")


class MovingGaussians(Protocol):
    """Gaussians that can be scored, drawn and saved: `TransientGaussians`; without a closed form `Trajectory`."""

    def __len__(self) -> int: ...

    @property
    def dynamic(self) -> np.ndarray:
        """(N,) bool; False = static background."""

    @property
    def covered_s(self) -> tuple[float, float]:
        """First and last second for which there is a state; infinite for a closed form."""

    def life(self) -> tuple[float, float]:
        """Return first and last second in which anything dynamic lives; infinite when something is always on."""

    def state_at(self, time_s: float) -> TransientGaussians:
        """Return Gaussians whose `at(time_s)` and velocities are those of that time, row by row the same ones at all
        times."""

    def transformed(self: M, matrix: np.ndarray) -> M:
        """In another world, by a similarity (4, 4); velocities turn and stretch with it, times stay."""

    def measured_from(self: M, datum: Datum) -> M:
        """Return the same ones with places and times from another datum; unchanged where theirs is unknown."""

    def save(self, path: str | Path, source: str = "") -> Path:
        """Write a file that `gof.io.importers.read_result` reads."""


@dataclass
class TransientGaussians:
    """N Gaussians in activated values, float32, world frame (Z up, metres, seconds), measured from `datum`.

    Args:
        position: (N, 3) centre at time t_mu, m.
        velocity: (N, 3) m/s, of the light: how the Gaussian moves.
        t_mu: (N,) s on the dataset clock.
        t_sigma: (N,) s, > 0; inf = always on.
        scale: (N, 3) standard deviation along the Gaussian's own axes, m, > 0.
        rotation: (N, 4) quaternion wxyz; normalised on construction.
        opacity: (N,) in [0, 1], at time t_mu.
        color: (N, 3) display values, or (N, K, 3) spherical-harmonics coefficients with K = (degree + 1)^2.
        dynamic: (N,) bool; False = static background: ignores velocity, t_mu and t_sigma.
        gas_velocity: (N, 3) m/s, of the gas that shines there; what DVE scores and velocity pictures show. None: gas
            and light move as one, at `velocity`.
        velocity_sd: (N,) m/s, >= 0, standard deviation of each component of the gas' velocity; inf = unknown.
            None is inf for all.
        datum: the place in the world and the time on the clock, both float64, that positions and t_mu count from. None:
            unknown; they are taken to be measured as those are that they are used with.
        emissive: a flame's: over what lies behind them they are laid by `gof.core.colour.add_light`, as light that is
            added. Otherwise display values are blended, as in every other method.

    Raises:
        DataFormatError: shapes disagree, or a value is outside its range (names the parameter and rows).
        NonFiniteError: NaN or Inf anywhere but t_sigma = inf and velocity_sd = inf.
    """

    position: np.ndarray
    velocity: np.ndarray
    t_mu: np.ndarray
    t_sigma: np.ndarray
    scale: np.ndarray
    rotation: np.ndarray
    opacity: np.ndarray
    color: np.ndarray
    dynamic: np.ndarray
    gas_velocity: np.ndarray | None = None
    velocity_sd: np.ndarray = FILLED_IN
    datum: Datum | None = None
    emissive: bool = False

    def __post_init__(self):
        if self.velocity_sd is None:
            self.velocity_sd = np.full(np.shape(self.position)[:1], np.inf)
        for name, values in self.arrays().items():
            kind = bool if name == "dynamic" else np.float32
            try:
                with np.errstate(over="ignore"):  # the checks for finite values name what is too large
                    setattr(self, name, np.ascontiguousarray(values, kind))
            except (TypeError, ValueError) as e:
                raise DataFormatError(f"'{name}' does not hold numbers ({e})") from e
        n = len(self.position)
        shapes = {
            "position": (n, 3),
            "velocity": (n, 3),
            "t_mu": (n,),
            "t_sigma": (n,),
            "scale": (n, 3),
            "rotation": (n, 4),
            "opacity": (n,),
            "dynamic": (n,),
            "velocity_sd": (n,),
        }
        if self.gas_velocity is not None:
            shapes["gas_velocity"] = (n, 3)
        for name, shape in shapes.items():
            if getattr(self, name).shape != shape:
                raise DataFormatError(
                    f"'{name}' has shape {getattr(self, name).shape}, expected {shape} for {n} Gaussians"
                )
        sh = self.color.ndim == 3 and self.color.shape[1] in (1, 4, 9, 16)
        if self.color.shape[:1] != (n,) or self.color.shape[-1:] != (3,) or not (self.color.ndim == 2 or sh):
            raise DataFormatError(
                f"'color' has shape {self.color.shape}, expected ({n}, 3) or ({n}, K, 3) with K = 1, 4, 9 or 16"
            )
        for name in shapes | {"color": ()}:
            values = getattr(self, name)
            may_be_infinite = name in ("t_sigma", "velocity_sd")
            require_finite(
                name, np.where(np.isposinf(values), 0, values) if may_be_infinite else values, "TransientGaussians"
            )
        self._require("t_sigma", self.t_sigma > 0, "> 0 (inf = always on)")
        self._require("scale", (self.scale > 0).all(-1), "> 0 (linear standard deviation in metres, not its log)")
        self._require("velocity_sd", self.velocity_sd >= 0, ">= 0 (inf = unknown)")
        self._require("opacity", (self.opacity >= 0) & (self.opacity <= 1), "in [0, 1] (activated, not a logit)")
        norm = np.linalg.norm(self.rotation.astype(np.float64), axis=-1, keepdims=True)
        self._require("rotation", norm[:, 0] > 1e-12, "a non-zero quaternion")
        self.rotation = (self.rotation / np.maximum(norm, 1e-12)).astype(np.float32)

    def _require(self, name: str, ok: np.ndarray, rule: str) -> None:
        if not ok.all():
            raise DataFormatError(f"'{name}' must be {rule}; rows {np.flatnonzero(~ok)[:5].tolist()} are not")

    def __len__(self) -> int:
        return len(self.position)

    def __getitem__(self, index) -> TransientGaussians:
        """Return a subset by boolean mask, slice or index array (N',)."""
        return replace(self, **{name: values[index] for name, values in self.arrays().items()})

    def at(self, time_s: float) -> tuple[np.ndarray, np.ndarray]:
        """State at one time: position (N, 3) m and opacity (N,) in [0, 1]; static Gaussians do not change."""
        dt = np.where(self.dynamic, np.float64(time_s) - self.t_mu, 0.0)
        position = self.position + dt[:, None] * self.velocity
        # 40 lifetimes away exp is 0 in any precision; the clip keeps the square finite.
        window = np.exp(-0.5 * np.clip(dt / self.t_sigma, -40, 40) ** 2)
        return position.astype(np.float32), (self.opacity * window).astype(np.float32)

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays by name; without `gas_velocity` where there is none."""
        values = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in results.Whole._fields}
        return {name: value for name, value in values.items() if value is not None}

    @property
    def moving_gas(self) -> np.ndarray:
        """(N, 3) m/s of the gas, as far as a Gaussian says anything of it; static ones rest."""
        velocity = self.velocity if self.gas_velocity is None else self.gas_velocity
        return np.where(self.dynamic[:, None], velocity, 0)

    @property
    def covered_s(self) -> tuple[float, float]:
        """The closed form holds at all times."""
        return -np.inf, np.inf

    def life(self) -> tuple[float, float]:
        """Return first and last second in which anything dynamic lives, LIFE_SIGMAS around t_mu; something must be
        dynamic."""
        g = self[self.dynamic]
        reach = LIFE_SIGMAS * g.t_sigma.astype(np.float64)
        return float((g.t_mu - reach).min()), float((g.t_mu + reach).max())

    def state_at(self, time_s: float) -> TransientGaussians:
        """Themselves: `at` knows every time."""
        return self

    def transformed(self, matrix: np.ndarray) -> TransientGaussians:
        """In another world, by a similarity (4, 4); velocities turn and stretch with it, times stay.

        It maps places measured from this datum; the datum of the other world is not known.

        Raises:
            GofError: not a similarity (sheared, mirrored or singular).
        """
        position, scale, rotation, color = transformed_splats(
            matrix, self.position, self.scale, self.rotation, self.color
        )
        linear = np.asarray(matrix, np.float64)[:3, :3]
        return replace(
            self,
            position=position,
            velocity=self.velocity @ linear.T,
            gas_velocity=None if self.gas_velocity is None else self.gas_velocity @ linear.T,
            velocity_sd=self.velocity_sd * np.cbrt(np.linalg.det(linear)),
            scale=scale,
            rotation=rotation,
            color=color,
            datum=None,
        )

    def measured_from(self, datum: Datum) -> TransientGaussians:
        """Return the same ones with places and times from another datum; unchanged where theirs is unknown."""
        if self.datum is None or self.datum == datum:
            return replace(self, datum=datum)
        x, y, z, t = self.datum.numbers() - datum.numbers()
        return replace(self, position=self.position + np.array([x, y, z]), t_mu=self.t_mu + np.float64(t), datum=datum)

    @classmethod
    def concatenate(cls, parts: list[TransientGaussians]) -> TransientGaussians:
        """Return all Gaussians of several sets, measured from the first datum there is; colour layouts must agree.

        They are emissive where all sets are.
        """
        datum = next((part.datum for part in parts if part.datum is not None), None)
        if datum is not None:
            parts = [part.measured_from(datum) for part in parts]
        if any(part.gas_velocity is not None for part in parts):
            parts = [replace(part, gas_velocity=part.moving_gas) for part in parts]
        names = parts[0].arrays()
        arrays = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
        return cls(**arrays, datum=datum, emissive=all(part.emissive for part in parts))

    def save(self, path: str | Path, source: str = "") -> Path:
        """Write `.ply` (3DGS attributes plus time and velocity) or `.npz` (schema gof-linear), by suffix.

        Raises:
            DataFormatError: unknown suffix.
        """
        return results.save(self.arrays(), Path(path), source, results.Whole(self.datum, self.emissive))

    @classmethod
    def load(cls, path: str | Path, step: int = 1) -> TransientGaussians:
        """Read every step-th Gaussian of what `save` wrote.

        Raises:
            DataFormatError: unknown suffix, missing field, wrong version, truncated file, or values out of range.
            NonFiniteError: NaN or Inf in a field.
        """
        path = Path(path)
        with naming(path):
            arrays, whole = results.load(path, step)
            return cls(**arrays, datum=whole.datum, emissive=whole.emissive)
