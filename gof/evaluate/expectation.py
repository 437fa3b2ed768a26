"""The expected true velocity under each Gaussian, by the quadrature that suits the field and their number."""

from __future__ import annotations

import numpy as np

from gof.core.fields import VelocityField
from gof.evaluate.quadrature import Expectation, VelocityLike, expected_velocity_plain, product_rule
from gof.evaluate.sparse_grid import StoredField, cell_ranges, parts, pool_of

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
    """The plain quadrature on a store, so many Gaussians at a time as share a pool of chunks."""
    result = Expectation.empty(len(position))
    ranges = cell_ranges(field, position, scale, np.abs(product_rule(order)[0]).max())
    for rows, needed in parts(field, *ranges, np.arange(len(position))):
        pool_of(field, needed)  # read once, not for every batch of points
        part = expected_velocity_plain(field, position[rows], scale[rows], rotation[rows], order)
        for whole, values in zip(result, part, strict=True):
            whole[rows] = values
    return result
