"""The expected true velocity under each Gaussian, by the quadrature that suits the field and their number."""

from __future__ import annotations

import numpy as np

from gof.core.fields import VelocityField
from gof.core.rotations import rotation_matrices
from gof.evaluate.quadrature import Expectation, VelocityLike, product_rule
from gof.evaluate.sparse_grid import StoredField

CHUNK_POINTS = 1 << 15  # quadrature points held at once; small enough for a cache, which is worth a factor of two
COMPILED_FROM = 100_000  # quadrature points; below, loading the compiler takes longer than numpy


def expected_velocity(
    field: VelocityLike, position: np.ndarray, scale: np.ndarray, rotation: np.ndarray, order: int = 3
) -> Expectation:
    """E[V(x)] for x ~ N(position, R diag(scale^2) R^T), one Gaussian per row.

    Args:
        field: velocity in m/s at world points; on a `VelocityField` or `StoredField` many Gaussians take a compiled
            kernel (float32 inside).
        position: (M, 3) m.   scale: (M, 3) standard deviations, m.   rotation: (M, 4) unit quaternions wxyz.
        order: nodes per axis, 1, 3, 5 or 7; cost grows with order^3.
    Returns:
        Expectation in float64. NaN in the field is passed on (the caller reports it with its frame).
    Raises:
        GofError: unknown order.
    """
    if isinstance(field, (VelocityField, StoredField)) and len(position) * order**3 >= COMPILED_FROM:
        from gof.evaluate.grid_quadrature import expected_velocity_on_grid  # here: it loads the compiler

        return expected_velocity_on_grid(field, position, scale, rotation, order)
    if isinstance(field, StoredField):
        return _part_by_part(field, position, scale, rotation, order)
    return expected_velocity_plain(field, position, scale, rotation, order)


def _part_by_part(
    field: StoredField, position: np.ndarray, scale: np.ndarray, rotation: np.ndarray, order: int
) -> Expectation:
    """Return the plain quadrature on a store, so many Gaussians at a time as share a pool of chunks."""
    result = Expectation.empty(len(position))
    for rows, pool in field.bricks.pools(position, scale, np.abs(product_rule(order)[0]).max()):
        del pool  # the field keeps it: it is read once, not for every batch of points
        part = expected_velocity_plain(field, position[rows], scale[rows], rotation[rows], order)
        for whole, values in zip(result, part, strict=True):
            whole[rows] = values
    return result


def expected_velocity_plain(
    field: VelocityLike, position: np.ndarray, scale: np.ndarray, rotation: np.ndarray, order: int = 3
) -> Expectation:
    """Compute E[V(x)] as `expected_velocity` says, in numpy float64, for any field.

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
