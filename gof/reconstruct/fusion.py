"""Fusing the cameras' optical flows into one 3D velocity per voxel (paper, "Dynamic Scene", eq. 4 to 7)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.ndimage import gaussian_filter

from gof.core.errors import GofError
from gof.reconstruct.voxels import FlameVoxels


def back_projected_flow(jacobian: np.ndarray, flow: np.ndarray, forward: np.ndarray) -> np.ndarray:
    """u_i of the paper's eq. 4, as a velocity: the motion at constant depth that projects to the flow.

    pi^-1(f + pi(x), x) - x is linear in f at constant depth, so it is the same for a step of any length.

    Args:
        jacobian: (V, 2, 3) px/m.   flow: (V, 2) px/s.   forward: (3,) unit vector along the camera's optical axis.
    Returns:
        (V, 3) m/s.
    """
    # Regular for any point in front of a camera: J's kernel is the ray, which is never in the plane of constant depth.
    rows = np.concatenate([jacobian, np.broadcast_to(forward, (len(jacobian), 1, 3))], 1)
    unit = np.linalg.norm(jacobian, axis=(1, 2))[:, None]  # rows of one size, whatever the unit of length
    rows[:, 2] *= unit
    return np.linalg.solve(rows, np.concatenate([flow, np.zeros_like(unit)], 1)[..., None])[..., 0]


def fuse_paper(
    jacobian: np.ndarray, flow: np.ndarray, valid: np.ndarray, forward: np.ndarray, tau0: float = 0.1
) -> np.ndarray:
    """Fuse by the paper's constraint u_i . F = |u_i|^2 with Tikhonov regularisation (eq. 5 to 7), free of units.

    As printed, tau^2 has the unit of velocity^4 while the matrix it regularises has velocity^2, so the result would
    change with the unit of length. The authors' published code adds tau itself, 0.1 of the mean |u_i|^2, and so does
    this. (Both solve the normal equations; the paper names an SVD of the same problem.)

    Args:
        jacobian: (C, V, 2, 3) px/m.   flow: (C, V, 2) px/s.   valid: (C, V) bool.
        forward: (C, 3) unit vectors along the cameras' optical axes.   tau0: regularisation, relative.
    Returns:
        (V, 3) m/s; 0 where no camera has flow or all flows are 0.
    """
    u = np.zeros((*valid.shape, 3))
    for c, use in enumerate(valid):
        u[c, use] = back_projected_flow(jacobian[c, use], flow[c, use], forward[c])
    count = np.maximum(valid.sum(0), 1)
    mean_square = (u**2).sum((0, 2)) / count
    moving = mean_square > 1e-30
    scaled = u / np.sqrt(np.where(moving, mean_square, 1))[:, None]
    A = np.einsum("cvi,cvj->vij", scaled, scaled) + tau0 * np.eye(3)
    b = np.einsum("cvi,cv->vi", scaled, (scaled * u).sum(-1))
    return np.where(moving[:, None], np.linalg.solve(A, b[..., None])[..., 0], 0)


def fuse_full(
    jacobian: np.ndarray, flow: np.ndarray, valid: np.ndarray, forward: np.ndarray | None = None, ridge: float = 0.01
) -> np.ndarray:
    """Every camera constrains both image components: minimise sum_i |J_i F - f_i|^2 + ridge * scale * |F|^2.

    The paper keeps one equation per camera (along u_i) and so gives up half of what a camera knows. The ridge is
    relative to the mean eigenvalue of sum J^T J, hence independent of units; it holds the component no camera sees
    (along the rays) at zero.

    Args and returns: as `fuse_paper`; `forward` is not looked at.
    """
    n = jacobian.shape[1]
    A = np.zeros((n, 3, 3))
    b = np.zeros((n, 3))
    for c, use in enumerate(valid):
        J = jacobian[c, use]
        A[use] += J.transpose(0, 2, 1) @ J
        b[use] += (J.transpose(0, 2, 1) @ flow[c, use][..., None])[..., 0]
    trace = np.trace(A, axis1=1, axis2=2)
    seen = trace > 0
    A += (ridge * np.where(seen, trace, 1) / 3)[:, None, None] * np.eye(3)
    return np.where(seen[:, None], np.linalg.solve(A, b[..., None])[..., 0], 0)


FUSIONS: dict[str, Callable[..., np.ndarray]] = {"full": fuse_full, "paper": fuse_paper}


def fuse_frame(
    voxels: FlameVoxels,
    flow: np.ndarray,
    mask: np.ndarray,
    emission: np.ndarray,
    fusion: str = "full",
    smooth_voxels: float = 3.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the 3D velocity of every voxel in one frame.

    Args:
        flow: (C, H, W, 2) px/s, NaN where unknown.   mask: (C, H, W) bool.   emission: (V,) weights for the smoothing.
        fusion: "full" or "paper".   smooth_voxels: std-dev of the emission-weighted Gaussian smoothing; 0 = none.
    Returns:
        velocity (V, 3) m/s, and known (V,) bool: two cameras, or the only one, gave flow here, or smoothing reached it.
    Raises:
        GofError: the result is not finite.
    """
    sampled = voxels.sample(flow, outside=np.nan)
    valid = np.isfinite(sampled).all(-1) & (voxels.sample(mask.astype(np.int8), outside=0) == 1)
    velocity = FUSIONS[fusion](voxels.jacobian, np.where(valid[..., None], sampled, 0), valid, voxels.forward)
    known = valid.sum(0) >= min(2, len(valid))
    velocity[~known] = 0
    if smooth_voxels > 0 and known.any():
        weight = np.where(known, emission + 1e-3 * emission.max(initial=0) + 1e-12, 0)
        velocity, known = _smoothed(voxels, velocity, weight, smooth_voxels)
    if not np.isfinite(velocity).all():
        raise GofError("flow fusion produced NaN or Inf; the camera matrices or flows are degenerate")
    return velocity, known


def _smoothed(
    voxels: FlameVoxels, velocity: np.ndarray, weight: np.ndarray, std_voxels: float
) -> tuple[np.ndarray, np.ndarray]:
    """Weighted Gaussian mean of velocity (V, 3) by weight (V,) >= 0, and where it reached: (V, 3) and (V,) bool."""
    cells = tuple(voxels.index.T)
    grid = np.zeros((*voxels.resolution, 4))
    grid[(*cells, slice(0, 3))] = velocity * weight[:, None]
    grid[(*cells, 3)] = weight
    blurred = [gaussian_filter(grid[..., i], std_voxels, mode="constant", truncate=3) for i in range(4)]
    smooth = np.stack(blurred, -1)[cells]
    reached = smooth[:, 3] > 1e-6 * weight.max()
    mean = smooth[:, :3] / np.where(reached, smooth[:, 3], 1)[:, None]
    return np.where(reached[:, None], mean, 0), reached
