"""Which points lie inside which ellipsoids: points are sorted into cells, and each ellipsoid asks those it meets."""

from __future__ import annotations

from math import floor, log, sqrt

import numpy as np

from gof.render.native.compiled import kernel, part

CELLS = 24  # along the longest side of the box around the points; 12 to 100 take the same time


def points_inside(
    points: np.ndarray,
    position: np.ndarray,
    alpha: np.ndarray,
    scale: np.ndarray,
    rotation: np.ndarray,
    level: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return point (P,), Gaussian (P,) and alpha exp(-d^2 / 2) (P,) of all pairs where that is `level` or more.

    Args:
        points: (M, 3) world m, M > 0.   position: (N, 3) world m.   alpha: (N,).   scale: (N, 3) std-devs, m.
        rotation: (N, 4) unit quaternions wxyz.   level: > 0.
    """
    begin, longest = points.min(0), float(np.ptp(points, axis=0).max())
    side = longest / CELLS if longest > 0 else 1.0
    at = np.floor((points - begin) / side).astype(np.int64)
    shape = at.max(0) + 1
    flat = np.ravel_multi_index(tuple(at.T), tuple(shape))
    order = np.argsort(flat, kind="stable")
    start = np.concatenate([[0], np.cumsum(np.bincount(flat, minlength=int(shape.prod())))])
    sorted_points, room = np.ascontiguousarray(points[order], np.float64), 64 * len(points)
    ellipsoids = [np.ascontiguousarray(values, np.float32) for values in (position, alpha, scale, rotation)]
    while True:
        point, gaussian, seen = np.empty(room, np.int64), np.empty(room, np.int64), np.empty(room)
        where = (sorted_points, start, shape, begin, side)
        found = _find(*where, *ellipsoids, np.float32(level), level, point, gaussian, seen)
        if found <= room:
            return order[point[:found]], gaussian[:found], seen[:found]
        room = found


@part
def _cells(middle, reach, begin, side, count):
    """Return first and last cell along an axis; the last below the first: none."""
    low, high = floor((middle - reach - begin) / side), floor((middle + reach - begin) / side)
    return int(max(low, 0.0)), int(min(high, count - 1.0))


@kernel
def _find(points, start, shape, begin, side, position, alpha, scale, rotation, drawn, level, point, gaussian, seen):
    """Write the pairs as far as there is room; return how many there are."""
    found = 0
    for n in range(len(position)):
        strength = np.float64(alpha[n])
        if alpha[n] < drawn:
            continue
        limit = 2 * log(max(strength / level, 1.0))  # of the Mahalanobis distance, squared
        w, x, y, z = (
            np.float64(rotation[n, 0]),
            np.float64(rotation[n, 1]),
            np.float64(rotation[n, 2]),
            np.float64(rotation[n, 3]),
        )
        norm = 1 / sqrt(w * w + x * x + y * y + z * z)
        w, x, y, z = w * norm, x * norm, y * norm, z * norm
        s0, s1, s2 = np.float64(scale[n, 0]), np.float64(scale[n, 1]), np.float64(scale[n, 2])
        r00, r01, r02 = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
        r10, r11, r12 = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
        r20, r21, r22 = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
        px, py, pz = np.float64(position[n, 0]), np.float64(position[n, 1]), np.float64(position[n, 2])
        reach = sqrt(limit) * (1 + 1e-9)  # the box around the ellipsoid; rounding loses no point
        rx = reach * sqrt((r00 * s0) ** 2 + (r01 * s1) ** 2 + (r02 * s2) ** 2)
        ry = reach * sqrt((r10 * s0) ** 2 + (r11 * s1) ** 2 + (r12 * s2) ** 2)
        rz = reach * sqrt((r20 * s0) ** 2 + (r21 * s1) ** 2 + (r22 * s2) ** 2)
        x0, x1 = _cells(px, rx, begin[0], side, shape[0])
        y0, y1 = _cells(py, ry, begin[1], side, shape[1])
        z0, z1 = _cells(pz, rz, begin[2], side, shape[2])
        if z0 > z1:
            continue
        for i in range(x0, x1 + 1):
            for j in range(y0, y1 + 1):
                column = (i * shape[1] + j) * shape[2]
                for k in range(start[column + z0], start[column + z1 + 1]):
                    dx, dy, dz = points[k, 0] - px, points[k, 1] - py, points[k, 2] - pz
                    a = (r00 * dx + r10 * dy + r20 * dz) / s0
                    b = (r01 * dx + r11 * dy + r21 * dz) / s1
                    c = (r02 * dx + r12 * dy + r22 * dz) / s2
                    distance2 = a * a + b * b + c * c
                    if distance2 <= limit:
                        if found < len(point):
                            point[found], gaussian[found] = k, n
                            seen[found] = strength * np.exp(-0.5 * distance2)
                        found += 1
    return found
