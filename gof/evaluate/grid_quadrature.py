"""The quadrature of `gof.evaluate.quadrature` on a gridded field, compiled: one kernel from Gaussians to expected velocities.

Its plain twin is `quadrature.expected_velocity_plain`; both agree to float32 rounding (tested).
"""

from __future__ import annotations

import drjit as dr
import numpy as np

from gof.evaluate.quadrature import Expectation, product_rule
from gof.fields import VelocityField
from gof.render.backend import Array3f, Float, Int, UInt, floats

CHUNK = 1 << 20  # Gaussians per launch: bounds memory at about 150 MB, whatever their number
FAR = 1e6  # cells, exact in float32; a centre farther out is put here, where no node of a sane Gaussian reaches the grid


def expected_velocity_on_grid(field: VelocityField, position: np.ndarray, scale: np.ndarray, rotation: np.ndarray,
                              order: int) -> Expectation:
    """Arguments and result as in `quadrature.expected_velocity`.

    Positions enter as a whole cell number and a float32 rest, so precision does not fall with the size of the grid.
    """
    nodes, weights = product_rule(order)
    table = [floats(column) for column in (*nodes.T, weights)]
    to_index = np.linalg.inv(field.index_to_world)[:3, :3]
    grid = floats(field.velocity)
    result = Expectation(np.zeros((len(position), 3)), np.zeros((len(position), 3)), np.ones(len(position)))
    for start in range(0, len(position), CHUNK):
        rows = slice(start, start + CHUNK)
        index = np.clip(field.to_index(position[rows]) - 0.5, -FAR, FAR)  # whole numbers are cell centres
        cell = np.floor(index)
        mean, centre, outside = _kernel(
            grid, field.resolution, [Int(floats(c)) for c in cell.T], [floats(c) for c in (index - cell).T],
            _axes(to_index, scale[rows], rotation[rows]), table)
        dr.eval(mean, centre, outside)
        result.mean[rows], result.centre[rows] = mean.numpy().T, centre.numpy().T
        result.inside[rows] = np.maximum(1 - outside.numpy().astype(np.float64), 0)
    return result


def _axes(to_index: np.ndarray, scale: np.ndarray, rotation: np.ndarray) -> list[list[Float]]:
    """to_index R diag(scale): 3 x 3 Float, columns are the Gaussian's own axes in cells."""
    q = rotation.astype(np.float64)
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    w, x, y, z = (floats(c) for c in q.T)
    s = [floats(c) for c in scale.T]
    R = [[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
         [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
         [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]]
    m = [[dr.opaque(Float, float(v)) for v in row] for row in to_index]
    return [[(m[i][0] * R[0][k] + m[i][1] * R[1][k] + m[i][2] * R[2][k]) * s[k] for k in range(3)] for i in range(3)]


def _kernel(grid: Float, resolution, cell: list[Int], rest: list[Float], axes: list[list[Float]],
            table: list[Float]) -> tuple[Array3f, Array3f, Float]:
    sizes = [dr.opaque(Int, n) for n in resolution]  # opaque: another grid is other data, not another kernel

    def velocity(offset: list[Float]) -> tuple[Array3f, Float]:
        """Tri-linear sample `offset` cells away from `cell`'s centre, and 0 inside the domain, 1 outside."""
        inside, low, high, blend = True, [], [], []
        for c, x, n in zip(cell, offset, sizes, strict=True):
            whole = dr.floor(x)
            fraction = x - whole
            number = c + Int(whole)
            # the domain reaches half a cell beyond the first and the last centre; there the nearest centre's value holds
            inside &= (number > -1) | ((number == -1) & (fraction >= 0.5))
            inside &= (number < n - 1) | ((number == n - 1) & (fraction <= 0.5))
            blend.append(dr.select((number < 0) | (number >= n - 1), 0.0, fraction))
            low.append(dr.clip(number, 0, n - 1))
            high.append(dr.minimum(low[-1] + 1, n - 1))
        total = Array3f(0)
        for i, wx in ((low[0], 1 - blend[0]), (high[0], blend[0])):
            for j, wy in ((low[1], 1 - blend[1]), (high[1], blend[1])):
                for k, wz in ((low[2], 1 - blend[2]), (high[2], blend[2])):
                    at = UInt((i * sizes[1] + j) * sizes[2] + k)
                    total += (wx * wy * wz) * dr.gather(Array3f, grid, at, active=inside)
        return dr.select(inside, total, 0), dr.select(inside, Float(0), Float(1))

    count = dr.opaque(UInt, len(table[0]))

    def body(node, mean, share):
        xi = [dr.gather(Float, column, node) for column in table]
        offset = [r + a[0] * xi[0] + a[1] * xi[1] + a[2] * xi[2] for r, a in zip(rest, axes, strict=True)]
        v, outside = velocity(offset)
        return node + 1, mean + xi[3] * v, share + xi[3] * outside  # not inside: exactly 0 where nothing is outside

    state = (dr.zeros(UInt, len(rest[0])), dr.zeros(Array3f, len(rest[0])), dr.zeros(Float, len(rest[0])))
    _, mean, share = dr.while_loop(state, lambda node, mean, share: node < count, body, labels=("node", "mean", "share"))
    return mean, velocity(rest)[0], share
