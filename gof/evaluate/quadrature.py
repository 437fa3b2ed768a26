"""Expected value of a velocity field under anisotropic 3D Gaussians, by a Gauss-Hermite product rule."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
from numpy.polynomial.hermite_e import hermegauss

from gof.core.errors import GofError
from gof.core.rotations import rotation_matrices

ORDERS = (1, 3, 5, 7)
CHUNK_POINTS = 1 << 15  # quadrature points held at once; small enough for a cache, which is worth a factor of two


class VelocityLike(Protocol):
    """What the evaluator needs of a field: `gof.core.fields.VelocityField`, or an analytic field."""

    voxel_size: float

    def sample(self, points: np.ndarray) -> np.ndarray:
        """World points (M, 3) m to velocity (M, 3) m/s; zero outside the domain."""

    def contains(self, points: np.ndarray) -> np.ndarray:
        """World points (M, 3) m to (M,) bool."""


class Expectation(NamedTuple):
    mean: np.ndarray  # (M, 3) m/s, expected velocity; the field counts as zero outside its domain
    centre: np.ndarray  # (M, 3) m/s, velocity at the centre
    inside: np.ndarray  # (M,) share of the quadrature weight that lies in the domain, 0..1

    @classmethod
    def empty(cls, count: int) -> Expectation:
        """Of a field at rest that has no end; to be filled."""
        return cls(np.zeros((count, 3)), np.zeros((count, 3)), np.ones(count))


def product_rule(order: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes (order^3, 3) in standard deviations and weights (order^3,) that sum to one.

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


def expected_velocity_plain(
    field: VelocityLike, position: np.ndarray, scale: np.ndarray, rotation: np.ndarray, order: int = 3
) -> Expectation:
    """E[V(x)] as `gof.evaluate.expectation` says, in numpy float64, for any field.

    Holds about CHUNK_POINTS points at a time, whatever M is.
    """
    nodes, weights = product_rule(order)
    count = len(position)
    result = Expectation.empty(count)
    corners = np.flatnonzero((np.abs(nodes) == np.abs(nodes).max()).all(1))
    step = max(1, CHUNK_POINTS // len(nodes))
    for start in range(0, count, step):
        rows = slice(start, min(start + step, count))
        axes = rotation_matrices(rotation[rows]) * scale[rows, None, :]  # columns: own axes times std-dev
        offsets = (axes.reshape(-1, 3) @ nodes.T).reshape(-1, 3, len(nodes))
        points = np.ascontiguousarray(np.moveaxis(position[rows, :, None] + offsets, 2, 1))
        velocity = field.sample(points.reshape(-1, 3)).reshape(-1, len(nodes), 3)
        result.mean[rows] = np.matmul(weights, velocity)
        result.centre[rows] = velocity[:, len(nodes) // 2]
        # the domain is convex: when the corner nodes are inside, all are
        partial = ~field.contains(points[:, corners].reshape(-1, 3)).reshape(-1, len(corners)).all(1)
        if partial.any():
            inside = field.contains(points[partial].reshape(-1, 3)).reshape(-1, len(nodes))
            result.inside[start + np.flatnonzero(partial)] = inside @ weights
    return result
