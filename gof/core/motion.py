"""Results that a function knows at any time: a network, a polynomial, a simulation; nothing has to be sampled."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from .datum import Datum
from .errors import DataFormatError, GofError, NonFiniteError
from .gaussians import TransientGaussians
from .trajectory import Trajectory


@dataclass(frozen=True)
class State:
    """N Gaussians at one time; row n is the same Gaussian at all times.

    Attributes:
        position: (N, 3) m.   opacity: (N,) 0..1, everything included.
        scale: (N, 3) standard deviations, m, > 0.   rotation: (N, 4) quaternions wxyz.
        velocity: (N, 3) m/s, or None: a difference of the function's own positions.
        color: (N, 3) display values or (N, K, 3) spherical harmonics; None = grey.
        dynamic: (N,) bool, False = background; None = all move.
    """

    position: np.ndarray
    opacity: np.ndarray
    scale: np.ndarray
    rotation: np.ndarray
    velocity: np.ndarray | None = None
    color: np.ndarray | None = None
    dynamic: np.ndarray | None = None


@dataclass(frozen=True)
class Motion:
    """Gaussians by a function of time; goes wherever a result goes (`gof.core.gaussians.MovingGaussians`).

    Args:
        function: time on the dataset clock, s -> `State`. Also called half a `step_s` beside the scored times.
        covered_s: first and last second that it covers.
        times_s: when it is sampled to be saved: the frames' times and half steps, say.
        step_s: over which velocities are differences where a state has none. A network in float32 knows no less than
            about 1e-7 of its distance from the origin; let it compute in float64, or take a longer step.
        matrix: (4, 4) similarity from the function's world to this one.
        source: what errors call it.
    """

    function: Callable[[float], State]
    covered_s: tuple[float, float] = (-np.inf, np.inf)
    times_s: np.ndarray | None = None
    step_s: float = 1e-4
    matrix: np.ndarray | None = None
    source: str = "the function"

    def __len__(self) -> int:
        return len(self.dynamic)

    @cached_property
    def dynamic(self) -> np.ndarray:
        """(N,) bool, of a time that it covers."""
        known = [t for t in (*(() if self.times_s is None else self.times_s[:1]), *self.covered_s) if np.isfinite(t)]
        return self.state_at(float(known[0]) if known else 0.0).dynamic

    def life(self) -> tuple[float, float]:
        """Return first and last known second."""
        return self.covered_s

    def state_at(self, time_s: float) -> TransientGaussians:
        """Return the Gaussians at one time, always on, with their velocity there.

        Raises:
            DataFormatError, NonFiniteError: what the function gives is no such state (says when).
        """
        first, last = self.covered_s
        if not first - 1e-6 <= time_s <= last + 1e-6:
            raise DataFormatError(
                f"{self.source}: time {time_s:g} s is outside the {first:g}..{last:g} s that it covers"
            )
        state = self.function(time_s)
        n = len(state.position)
        velocity = self._difference(time_s) if state.velocity is None else state.velocity
        try:
            found = TransientGaussians(
                position=state.position,
                velocity=velocity,
                t_mu=np.full(n, time_s),
                t_sigma=np.full(n, np.inf),
                scale=state.scale,
                rotation=state.rotation,
                opacity=state.opacity,
                color=np.full((n, 3), 0.5) if state.color is None else state.color,
                dynamic=np.ones(n, bool) if state.dynamic is None else state.dynamic,
            )
        except (DataFormatError, NonFiniteError) as e:
            raise type(e)(f"{self.source}: state at {time_s:g} s: {e}") from e
        return found if self.matrix is None else found.transformed(self.matrix)

    def transformed(self, matrix: np.ndarray) -> Motion:
        """In another world, by a similarity (4, 4)."""
        return replace(self, matrix=np.asarray(matrix) @ (np.eye(4) if self.matrix is None else self.matrix))

    def measured_from(self, datum: Datum) -> Motion:
        """Return itself: times and places of the function are those of its caller."""
        return self

    def save(self, path: str | Path, source: str = "") -> Path:
        """Sample it at `times_s` and write an npz (gof-trajectory/1), with its velocities."""
        if self.times_s is None:
            raise GofError(f"{path}: a function is saved as samples; give Motion its times_s")
        states = [self.state_at(float(t)) for t in self.times_s]
        stacked = {
            name: np.stack([getattr(s, name) for s in states])
            for name in ("position", "opacity", "scale", "rotation", "velocity")
        }
        middle = states[len(states) // 2]
        return Trajectory(self.times_s, **stacked, color=middle.color, dynamic=middle.dynamic).save(path, source)

    def _difference(self, time_s: float) -> np.ndarray:
        """Return (N, 3) m/s, central, one-sided at the ends of what the function knows."""
        before, after = np.clip([time_s - self.step_s / 2, time_s + self.step_s / 2], *self.covered_s)
        if not after > before:
            raise GofError(f"step_s {self.step_s:g} s is too short to tell two times apart at {time_s:g} s")
        later, earlier = (np.asarray(self.function(float(t)).position, np.float64) for t in (after, before))
        if later.shape != earlier.shape:
            raise DataFormatError(f"the function gives {len(earlier)} and {len(later)} Gaussians around {time_s:g} s")
        return (later - earlier) / (after - before)
