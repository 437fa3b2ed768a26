"""Exact optical flow of a flame: the velocity of the gas seen by each pixel, projected into the picture.

Along the ray of a pixel, every point of glowing gas moves with the known velocity v; its image moves with J v, J being
the derivative of the projection. The flow of the pixel is the mean of J v weighted by the light each point sends to the
camera (its emission; the flame hardly absorbs).
"""

from __future__ import annotations

import numpy as np

from ...core.fields import trilinear


def flow(
    K: np.ndarray,
    world_to_camera: np.ndarray,
    size: tuple[int, int],
    emission: np.ndarray,
    velocity: np.ndarray,
    index_to_world: np.ndarray,
    mask: np.ndarray,
    step_cells: float = 0.5,
) -> tuple[np.ndarray, np.ndarray]:
    """Project the motion of a flame.

    Args:
        K: (3, 3) pixels; world_to_camera: (4, 4) OpenCV axes; size: (height, width).
        emission: (X, Y, Z) light per metre at cell centres, >= 0, any unit.
        velocity: (X, Y, Z, 3) m/s, world axes, at cell centres.
        index_to_world: (4, 4) continuous cell index to world metres.
        mask: (H, W) bool, pixels that are wanted.
        step_cells: march in these steps.
    Returns:
        flow (H, W, 2): pixels per second, right and down; 0 where there is no emission along the ray or no mask.
        weight (H, W): emission summed along the ray, unit of emission times metres.
    """
    height, width = size
    result, total = np.zeros((height, width, 2), np.float32), np.zeros((height, width), np.float32)
    rows, columns = np.nonzero(mask)
    if not len(rows):
        return result, total
    to_index = np.linalg.inv(index_to_world)
    rotation, shift = world_to_camera[:3, :3], world_to_camera[:3, 3]
    centre = -rotation.T @ shift
    rays = np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))], -1) @ np.linalg.inv(K).T @ rotation  # depth 1
    start = to_index[:3, :3] @ centre + to_index[:3, 3]
    along = rays @ to_index[:3, :3].T
    near, far = _inside(start, along, np.array(emission.shape))
    cells = np.linalg.norm(along, axis=1)
    steps = np.ceil(np.maximum(far - near, 0) * cells / step_cells).astype(int)
    glowing = np.concatenate([velocity * emission[..., None], emission[..., None]], axis=-1).astype(np.float32)
    sums = np.zeros((len(rows), 3))
    for k in range(int(steps.max(initial=0))):
        active = np.nonzero(k < steps)[0]
        depth = near[active] + (k + 0.5) * (far[active] - near[active]) / steps[active]
        sample = trilinear(glowing, start + depth[:, None] * along[active] - 0.5)
        length = (far[active] - near[active]) / steps[active] * np.linalg.norm(rays[active], axis=1)
        sample *= length[:, None]
        motion = sample[:, :3] @ rotation.T  # camera axes
        point = (rays[active] @ rotation.T) * depth[:, None]
        for axis in range(2):
            # d/dt of f * p_axis / p_z
            sums[active, axis] += (
                K[axis, axis] * (motion[:, axis] - point[:, axis] / point[:, 2] * motion[:, 2]) / point[:, 2]
            )
        sums[active, 2] += sample[:, 3]
    lit = sums[:, 2] > 1e-12
    result[rows[lit], columns[lit]] = sums[lit, :2] / sums[lit, 2:]
    total[rows, columns] = sums[:, 2]
    return result, total


def _inside(start: np.ndarray, along: np.ndarray, size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Depths between which rays start + depth * along (N, 3) are inside the box [0, size]; far < near if never."""
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (0 - start) / along, (size - start) / along
    # A ray along a face of the box gives 0/0 there: that pair of planes does not bound it.
    near, far = np.fmin(a, b), np.fmax(a, b)
    near, far = np.where(np.isnan(near), -np.inf, near), np.where(np.isnan(far), np.inf, far)
    return np.maximum(near.max(axis=1), 1e-6), far.min(axis=1)
