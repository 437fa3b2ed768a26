"""The quadrature of `gof.evaluate.quadrature` on a gridded field, compiled: one kernel from Gaussians to expectations.

Its plain twin is `expectation.expected_velocity_plain`; both agree to float32 rounding (tested).
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import numpy as np

from gof.core.fields import CHUNK, VelocityField
from gof.evaluate.quadrature import Expectation, product_rule
from gof.evaluate.sparse_grid import EDGE, FAR, Bricks, Pool, StoredField
from gof.render.backend import Array4f, Float, Int, UInt, floats

LAUNCH = 1 << 20  # Gaussians per launch: bounds memory at about 150 MB, whatever their number


def expected_velocity_on_grid(
    field: VelocityField | StoredField, position: np.ndarray, scale: np.ndarray, rotation: np.ndarray, order: int
) -> Expectation:
    """Arguments and result as in `expectation.expected_velocity`.

    Positions enter as a whole cell number and a float32 rest, so precision does not fall with the size of the grid.
    Only chunks that a node can reach are read; what needs more than POOL_BYTES of them is halved in space and done in
    parts.
    """
    nodes, weights = product_rule(order)
    table = [floats(column) for column in (*nodes.T, weights)]
    to_index = np.linalg.inv(field.index_to_world)[:3, :3]
    result = Expectation.empty(len(position))
    if len(position) == 0:
        return result
    index = np.clip(field.to_index(position) - 0.5, -FAR, FAR)  # whole numbers are cell centres
    cell = np.floor(index).astype(np.int32)
    resolution = field.resolution

    def evaluate(part: np.ndarray, pool: Pool) -> None:
        cells = _to_device(pool.cells)
        part = part[np.argsort(_brick_order(cell[part], resolution), kind="stable")]  # neighbours share the cache
        for start in range(0, len(part), LAUNCH):
            rows = part[start : start + LAUNCH]
            mean, centre, outside = _kernel(
                cells,
                pool,
                resolution,
                [Int(np.ascontiguousarray(c)) for c in cell[rows].T],
                [floats(c) for c in (index[rows] - cell[rows]).T],
                _axes(to_index, scale[rows], rotation[rows]),
                table,
            )
            dr.eval(mean, centre, outside)
            result.mean[rows], result.centre[rows] = mean.numpy()[:3].T, centre.numpy()[:3].T
            result.inside[rows] = np.maximum(1 - outside.numpy().astype(np.float64), 0)

    bricks = field.bricks if isinstance(field, StoredField) else Bricks(field)
    for part, pool in bricks.pools(position, scale, np.abs(nodes).max()):
        evaluate(part, pool)  # a function, so that what it put on the device is gone before the next pool is made
        del pool
    return result


def _brick_order(cell: np.ndarray, resolution) -> np.ndarray:
    """Return a number per Gaussian that sorts by blocks of 16^3 cells."""
    block = np.clip(cell, 0, np.array(resolution) - 1) >> 4
    return np.ravel_multi_index(tuple(block.T), tuple((n >> 4) + 1 for n in resolution))


def _to_device(cells: np.ndarray):
    kind: Any = Float if cells.dtype == np.float32 else dr.float16_array_t(Float)
    return kind(
        cells.reshape(-1)
    )  # on the CPU the same memory, which `sparse_grid` aligns so that kernels stay the same


def _axes(to_index: np.ndarray, scale: np.ndarray, rotation: np.ndarray) -> list[list[Float]]:
    """to_index R diag(scale): 3 x 3 Float, columns are the Gaussian's own axes in cells."""
    q = rotation.astype(np.float64)
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    columns: list[Any] = [floats(c) for c in q.T]
    w, x, y, z = columns
    s = [floats(c) for c in scale.T]
    R = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    m: list[list[Any]] = [[dr.opaque(Float, float(v)) for v in row] for row in to_index]
    return [[(m[i][0] * R[0][k] + m[i][1] * R[1][k] + m[i][2] * R[2][k]) * s[k] for k in range(3)] for i in range(3)]


def _kernel(
    cells, pool: Pool, resolution, cell: list[Int], rest: list[Float], axes: list[list[Float]], table: list[Float]
) -> tuple[Array4f, Array4f, Float]:
    sizes = [dr.opaque(Int, n) for n in resolution]  # opaque: another grid is other data, not another kernel
    slots = UInt(pool.table.ravel())
    bricks_y, bricks_z = (dr.opaque(UInt, n) for n in pool.table.shape[1:])
    record: Any = Array4f if pool.cells.dtype == np.float32 else dr.float16_array_t(Array4f)

    def velocity(offset: list[Float]) -> tuple[Array4f, Float]:
        """Tri-linear sample `offset` cells away from `cell`'s centre, and 0 inside the domain, 1 outside."""
        inside, low, step, blend = True, [], [], []
        for c, x, n in zip(cell, offset, sizes, strict=True):
            whole = dr.floor(x)
            fraction = x - whole
            number = c + Int(whole)
            # the domain reaches half a cell beyond the first and the last centre; there the nearest centre's value
            # holds
            inside &= (number > -1) | ((number == -1) & (fraction >= 0.5))
            inside &= (number < n - 1) | ((number == n - 1) & (fraction <= 0.5))
            between = (number >= 0) & (number < n - 1)
            blend.append(dr.select(between, fraction, 0.0))
            step.append(dr.select(between, UInt(1), UInt(0)))
            low.append(UInt(dr.clip(number, 0, n - 1)))
        bx, by, bz = (k >> 6 for k in low)
        lx, ly, lz = (k & (CHUNK - 1) for k in low)
        slot = dr.gather(UInt, slots, (bx * bricks_y + by) * bricks_z + bz, active=inside)
        first = ((slot * EDGE + lx) * EDGE + ly) * EDGE + lz
        total = Array4f(0)
        for i, wx in ((0, 1 - blend[0]), (step[0] * (EDGE * EDGE), blend[0])):
            for j, wy in ((0, 1 - blend[1]), (step[1] * EDGE, blend[1])):
                for k, wz in ((0, 1 - blend[2]), (step[2], blend[2])):
                    total += (wx * wy * wz) * Array4f(dr.gather(record, cells, first + i + j + k, active=inside))
        return dr.select(inside, total, 0), dr.select(inside, Float(0), Float(1))

    count = dr.opaque(UInt, len(table[0]))

    def body(node, mean, share):
        xi = [dr.gather(Float, column, node) for column in table]
        offset = [r + a[0] * xi[0] + a[1] * xi[1] + a[2] * xi[2] for r, a in zip(rest, axes, strict=True)]
        v, outside = velocity(offset)
        return node + 1, mean + xi[3] * v, share + xi[3] * outside  # not inside: exactly 0 where nothing is outside

    state = (dr.zeros(UInt, len(rest[0])), dr.zeros(Array4f, len(rest[0])), dr.zeros(Float, len(rest[0])))
    _, mean, share = dr.while_loop(
        state, lambda node, mean, share: node < count, body, labels=("node", "mean", "share")
    )
    return mean, velocity(rest)[0], share
