"""Results without a closed form: Gaussians at sampled times, velocities by differences (`gof-trajectory/1`)."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from .datum import Datum
from .errors import DataFormatError, require_finite
from .files import atomic_path
from .gaussians import FILLED_IN, TransientGaussians
from .similarity import transformed_splats

SCHEMA = "gof-trajectory/1"
ROUNDING = 1e-5  # by which products of float32 opacities may leave 0..1
_ARRAYS = ("time_s", "position", "opacity", "scale", "rotation")


@dataclass
class Trajectory:
    """N Gaussians at T times; row n is the same Gaussian at all of them.

    Args:
        time_s: (T,) s on the dataset clock, strictly increasing, T >= 2. Half steps between frames make better
            velocities.
        position: (T, N, 3) m.
        opacity: (T, N) 0..1, everything included (temporal windows, deformation).
        scale: (N, 3) or (T, N, 3) m, > 0.   rotation: (N, 4) or (T, N, 4) wxyz.
        velocity: (T, N, 3) m/s, or None: differences of the positions.
        color: (N, 3) display values or (N, K, 3) spherical harmonics; None = grey.
        dynamic: (N,) bool; None = all move.
        emissive: as of `TransientGaussians`.

    Raises:
        DataFormatError: shapes or ranges are wrong.   NonFiniteError: NaN or Inf.
    """

    time_s: np.ndarray
    position: np.ndarray
    opacity: np.ndarray
    scale: np.ndarray
    rotation: np.ndarray
    velocity: np.ndarray | None = None
    color: np.ndarray = FILLED_IN
    dynamic: np.ndarray = FILLED_IN
    emissive: bool = False

    def __post_init__(self):
        for f in fields(self):
            if getattr(self, f.name) is not None and np.asarray(getattr(self, f.name)).dtype.kind not in "biuf":
                raise DataFormatError(f"trajectory '{f.name}' does not hold numbers")
        if np.shape(self.emissive) or np.asarray(self.emissive).dtype != bool:
            raise DataFormatError("trajectory 'emissive' is not one bool")
        self.emissive = bool(self.emissive)
        self.time_s = np.asarray(self.time_s, np.float64)
        steps, count = np.shape(self.position)[:2] if np.ndim(self.position) == 3 else (0, 0)
        self.color = np.full((count, 3), 0.5) if self.color is None else self.color
        self.dynamic = np.ones(count, bool) if self.dynamic is None else np.asarray(self.dynamic, bool)
        allowed = {
            "position": [(steps, count, 3)],
            "opacity": [(steps, count)],
            "scale": [(count, 3), (steps, count, 3)],
            "rotation": [(count, 4), (steps, count, 4)],
            "velocity": [(steps, count, 3)],
        }
        for name, shapes in allowed.items():
            value = getattr(self, name)
            if value is None and name == "velocity":
                continue
            value = np.asarray(value, np.float32)
            if value.shape not in shapes:
                raise DataFormatError(
                    f"trajectory '{name}' has shape {value.shape}, expected {' or '.join(map(str, shapes))}"
                )
            require_finite(name, value, "Trajectory")
            setattr(self, name, value)
        require_finite("time_s", self.time_s, "Trajectory")
        require_finite("color", self.color, "Trajectory")
        if self.time_s.shape != (steps,) or steps < 2 or not (np.diff(self.time_s) > 0).all():
            raise DataFormatError(
                f"trajectory time_s has shape {self.time_s.shape}; expected ({steps},) strictly increasing seconds, "
                "at least 2"
            )
        if self.dynamic.shape != (count,):
            raise DataFormatError(f"trajectory 'dynamic' has shape {self.dynamic.shape}, expected ({count},)")
        self._require("scale", (self.scale > 0).all(-1), "> 0 (linear standard deviation in metres, not its log)")
        self._require("opacity", (self.opacity > -ROUNDING) & (self.opacity < 1 + ROUNDING), "0..1 (not a logit)")

    def _require(self, name: str, ok: np.ndarray, rule: str) -> None:
        if not ok.all():
            where = np.argwhere(~ok)[0].tolist()
            raise DataFormatError(f"trajectory '{name}' must be {rule}; entry {where} is not")

    def __len__(self) -> int:
        return self.position.shape[1]

    @property
    def covered_s(self) -> tuple[float, float]:
        """First and last sampled second: nothing is known outside."""
        return float(self.time_s[0]), float(self.time_s[-1])

    def life(self) -> tuple[float, float]:
        """Return first and last sampled second; when in between a Gaussian lives, its opacities say."""
        return self.covered_s

    def state_at(self, time_s: float) -> TransientGaussians:
        """Return the Gaussians at one time, always on, with their velocity there.

        At a sampled time the velocity is the three-point difference over its neighbours (one-sided at the two ends),
        which is exact for motion quadratic in time; between two samples, the difference of the two, and everything
        linear.

        Raises:
            DataFormatError: the time is outside the sampled ones.
        """
        t, tolerance = self.time_s, 1e-6
        if not t[0] - tolerance <= time_s <= t[-1] + tolerance:
            raise DataFormatError(f"time {time_s:g} s is outside the trajectory's {t[0]:g}..{t[-1]:g} s")
        k = int(np.abs(t - time_s).argmin())
        if abs(t[k] - time_s) <= tolerance:
            weights = {k: 1.0}
            stencil = np.clip([k - 1, k, k + 1], 0, len(t) - 1) if len(t) > 2 else np.array([0, 1])
            if len(t) > 2 and k in (0, len(t) - 1):
                stencil = np.array([0, 1, 2]) if k == 0 else np.array([k - 2, k - 1, k])
        else:
            after = int(np.searchsorted(t, time_s))
            f = float((time_s - t[after - 1]) / (t[after] - t[after - 1]))
            weights, stencil = {after - 1: 1 - f, after: f}, np.array([after - 1, after])

        def mix(values: np.ndarray) -> np.ndarray:
            return sum(w * values[j] for j, w in weights.items())

        if self.velocity is not None:
            velocity = mix(self.velocity)
        else:
            c = _derivative_weights(t[stencil], time_s)
            # differences from one of them: the centres' distance from the world's origin costs no digits
            base = self.position[stencil[0]].astype(np.float64)
            velocity = sum(w * (self.position[j] - base) for j, w in zip(stencil[1:], c[1:], strict=True))
        rotation = self.rotation if self.rotation.ndim == 2 else self.rotation[max(weights, key=weights.__getitem__)]
        n = len(self)
        return TransientGaussians(
            position=mix(self.position),
            velocity=velocity,
            t_mu=np.full(n, time_s),
            t_sigma=np.full(n, np.inf),
            scale=np.maximum(self.scale if self.scale.ndim == 2 else mix(self.scale), 1e-12),
            rotation=rotation,
            opacity=np.clip(mix(self.opacity), 0, 1),
            color=self.color,
            dynamic=self.dynamic,
            emissive=self.emissive,
        )

    def difference_change(self) -> float:
        """Return the change of velocities (relative L2) when differences span twice the step.

        That is three times their own error where motion is smooth. Where it has kinks, as that of networks with ReLU or
        of planes interpolated in time, the error falls with the root of the step only, and is as large as the change.
        """
        if self.velocity is not None or len(self.time_s) < 5:
            return float("nan")
        fine, coarse = self._inner_velocities(1), self._inner_velocities(2)
        power = float((fine**2).sum())
        return float(np.sqrt(((fine - coarse) ** 2).sum() / power)) if power > 0 else 0.0

    def _inner_velocities(self, step: int) -> np.ndarray:
        """Return (T - 4, dynamic, 3) m/s by differences over `step` samples to each side."""
        found = []
        for k in range(2, len(self.time_s) - 2):
            rows, base = [k - step, k, k + step], self.position[k].astype(np.float64)
            c = _derivative_weights(self.time_s[rows], self.time_s[k])
            found.append(sum(w * (self.position[j] - base) for j, w in zip(rows, c, strict=True)))
        return np.array(found)[:, self.dynamic]

    def transformed(self, matrix: np.ndarray) -> Trajectory:
        """In another world, by a similarity (4, 4)."""
        states = {f.name: getattr(self, f.name) for f in fields(self)}
        shape = self.position.shape
        moved = transformed_splats(
            matrix, self.position.reshape(-1, 3), self.scale.reshape(-1, 3), self.rotation.reshape(-1, 4), self.color
        )
        states |= {
            "position": moved[0].reshape(shape),
            "scale": moved[1].reshape(self.scale.shape),
            "rotation": moved[2].reshape(self.rotation.shape),
            "color": moved[3],
        }
        if self.velocity is not None:
            states["velocity"] = (self.velocity.reshape(-1, 3) @ np.asarray(matrix)[:3, :3].T).reshape(shape)
        return Trajectory(**states)

    def measured_from(self, datum: Datum) -> Trajectory:
        """Themselves: their file says nothing of a datum."""
        return self

    def save(self, path: str | Path, source: str = "") -> Path:
        """Write an npz (schema gof-trajectory/1), atomically."""
        path = Path(path)
        if path.suffix != ".npz":
            raise DataFormatError(f"{path}: a trajectory is saved as .npz")
        given = {f.name: getattr(self, f.name) for f in fields(self)}
        arrays = {name: value for name, value in given.items() if value is not None and value is not False}
        with atomic_path(path) as temporary:
            np.savez(temporary, schema=np.array(SCHEMA), source=np.array(source), **arrays)
        return path

    @classmethod
    def from_arrays(cls, data: dict[str, np.ndarray], path: Path) -> Trajectory:
        missing = [name for name in _ARRAYS if name not in data]
        if missing:
            raise DataFormatError(f"{path}: fields {missing} are missing; a gof-trajectory needs {list(_ARRAYS)}")
        known = [f.name for f in fields(cls)]
        unknown = sorted(set(data) - set(known) - {"schema", "source"})
        if unknown:
            raise DataFormatError(
                f"{path}: {unknown} are no fields of a gof-trajectory, which would leave them aside; there are {known}"
            )
        values: dict[str, Any] = {name: data[name] for name in known if name in data}
        try:
            return cls(**values)
        except DataFormatError as e:
            raise DataFormatError(f"{path}: {e}") from e


def _derivative_weights(t: np.ndarray, at: float) -> np.ndarray:
    """Return weights whose sum with values at times t is the derivative at `at` of the polynomial through 2 or 3
    points."""
    if len(t) == 2:
        return np.array([-1.0, 1.0]) / (t[1] - t[0])
    a, b, c = t
    return np.array(
        [
            (2 * at - b - c) / ((a - b) * (a - c)),
            (2 * at - a - c) / ((b - a) * (b - c)),
            (2 * at - a - b) / ((c - a) * (c - b)),
        ]
    )
