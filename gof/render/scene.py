"""The scene that is drawn: activated Gaussians as Dr.Jit arrays, and their state at a time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import drjit as dr

from gof.core.errors import DataFormatError, NonFiniteError
from gof.render.backend import Array3f, Array4f, Bool, Float, UInt, floats, opaque

MAX_CHANNELS = 8
MIN_T_SIGMA = 1e-6  # s


@dataclass
class Splats:
    """N Gaussians in activated values (no logits, no logs), AD-enabled where the caller wants gradients.

    Args:
        position: (N,) world metres.
        rotation: (N,) quaternion wxyz, normalised when drawn; a zero quaternion is the identity.
        scale: (N,) standard deviations along the Gaussian's axes, m.
        opacity: (N,) in [0, 1].
        color: 1 to 8 channels, each (N,); any real value (display or linear HDR).
        covariance: xx, xy, xz, yy, yz, zz in the world, m^2, each (N,), positive semidefinite, instead of rotation and
            scale (None then). Thin Gaussians lose digits in it: rotation and scale say the same more exactly.

    Raises:
        DataFormatError: no or more than 8 channels, or lengths that disagree.
    """

    position: Array3f
    rotation: Array4f | None
    scale: Array3f | None
    opacity: Float
    color: list[Float]
    covariance: list[Float] | None = None

    def __post_init__(self):
        self.color = list(self.color)
        if not 1 <= len(self.color) <= MAX_CHANNELS:
            raise DataFormatError(
                f"'color' has {len(self.color)} channels; 1 to {MAX_CHANNELS} can be drawn in one pass"
            )
        if (self.rotation is None, self.scale is None) != (self.covariance is not None,) * 2:
            raise DataFormatError("a Gaussian's shape is its 'rotation' and 'scale', or else its 'covariance'")
        n = len(self)
        for name, columns in self._parameters():
            for column in columns:
                if len(column) != n:
                    raise DataFormatError(f"'{name}' has {len(column)} rows, 'opacity' has {n}; all must agree")

    def __len__(self) -> int:
        return len(self.opacity)

    def _parameters(self):
        shape = ("rotation", self.rotation), ("scale", self.scale), ("covariance", self.covariance)
        return (
            ("position", list(self.position)),
            *((name, list(values)) for name, values in shape if values is not None),
            ("opacity", [self.opacity]),
            ("color", self.color),
        )


class Stack(NamedTuple):
    """Several pictures by one camera, drawn at once: they stand one below the other in every plane.

    Args:
        count: K >= 1, of the pictures.
        picture: (N,) the one in which each Gaussian is; no other shows it. One from K on is in none.
    """

    count: int
    picture: UInt


def columns(array, kind=list):
    """(N, K) numpy to `kind` of K columns."""
    parts = [floats(c) for c in array.T]
    return parts if kind is list else kind(*parts)


def require_finite_splats(splats: Splats) -> None:
    """One reduction per parameter.

    Raises:
        NonFiniteError: NaN or Inf; names the parameter and the first rows.
    """
    for name, parts in splats._parameters():
        bad = Bool(False)
        for part in parts:
            bad |= ~dr.isfinite(dr.detach(part))
        if dr.any(bad):
            rows = dr.compress(bad).numpy()
            raise NonFiniteError(
                f"'{name}' holds NaN or Inf in {len(rows)} of {len(splats)} rows (first: {rows[:5].tolist()})"
            )


def transient_state(
    position: Array3f,
    velocity: Array3f,
    t_mu: Float,
    t_sigma: Float,
    opacity: Float,
    time_s: float,
    dynamic: Bool | None = None,
) -> tuple[Array3f, Float]:
    """Position and opacity at a time, differentiable: x0 + (t - t_mu) v and opacity exp(-0.5 ((t - t_mu) / t_sigma)^2).

    Args:
        position: (N,) m at t_mu.  velocity: (N,) m/s.  t_mu, t_sigma: (N,) s; t_sigma = inf is always on, below 1e-6 s
            it acts as 1e-6 s with gradient 0.  opacity: (N,) in [0, 1] at t_mu.
        time_s: seconds on the same clock; a float, or a Float (N,) when every Gaussian is seen at its own time.
        dynamic: (N,); False rows keep position and opacity and give no gradient to velocity, t_mu, t_sigma.
    """
    dt = (time_s if isinstance(time_s, Float) else opaque(time_s)) - t_mu
    if dynamic is not None:
        dt = dr.select(dynamic, dt, 0.0)
    z = dt / dr.maximum(t_sigma, MIN_T_SIGMA)
    return position + dt * velocity, opacity * dr.exp(-0.5 * z * z)
