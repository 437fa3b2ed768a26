"""The Gauss-Hermite product rule for expectations under 3D Gaussians; what it needs of a field, and what it returns."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from numpy.polynomial.hermite_e import hermegauss

from gof.core.errors import GofError

ORDERS = (1, 3, 5, 7)


class VelocityLike(Protocol):
    """A field as the evaluator needs it: `gof.core.fields.VelocityField`, or an analytic field."""

    @property
    def voxel_size(self) -> float:
        """Side of a voxel, m."""

    def sample(self, points: np.ndarray) -> np.ndarray:
        """Return the velocity (M, 3) m/s at world points (M, 3) m; zero outside the domain."""

    def contains(self, points: np.ndarray) -> np.ndarray:
        """Return whether world points (M, 3) m lie in the domain, (M,) bool."""


class Expectation(NamedTuple):
    mean: np.ndarray  # (M, 3) m/s, expected velocity; the field counts as zero outside its domain
    centre: np.ndarray  # (M, 3) m/s, velocity at the centre
    inside: np.ndarray  # (M,) share of the quadrature weight that lies in the domain, 0..1

    @classmethod
    def empty(cls, count: int) -> Expectation:
        """Return the expectation of a field at rest that has no end; to be filled."""
        return cls(np.zeros((count, 3)), np.zeros((count, 3)), np.ones(count))


def product_rule(order: int) -> tuple[np.ndarray, np.ndarray]:
    """Return nodes (order^3, 3) in standard deviations and weights (order^3,) that sum to one.

    The weight function is the *probabilists'* exp(-x^2/2) (`hermegauss`), so a node is `centre + R (s * node)` without
    the factor sqrt(2) of `hermgauss`. `order` counts nodes per axis: exact for polynomials of degree 2 order - 1 per
    axis. The middle node is the centre itself.

    Raises:
        GofError: order is not 1, 3, 5 or 7.
    """
    if order not in ORDERS:
        raise GofError(f"quadrature order must be one of {ORDERS} nodes per axis, got {order}")
    node, weight = hermegauss(order)
    node[order // 2] = 0.0  # numpy returns it to rounding error
    weight = weight / weight.sum()
    nodes = np.stack(np.meshgrid(node, node, node, indexing="ij"), -1).reshape(-1, 3)
    weights = (weight[:, None, None] * weight[None, :, None] * weight[None, None, :]).ravel()
    return nodes, weights
