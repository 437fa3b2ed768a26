"""Needles along the rays are not fire: how far a Gaussian may reach along the rig's view of it.

Cameras on one side hardly see how long a Gaussian is along their rays, so that pictures' noise makes it long. Cut to
LONGEST, it covers the same of their pictures and less of those from the side.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gof.core.cameras import Camera
from gof.core.gaussians import TransientGaussians
from gof.core.rotations import quaternions_wxyz, rotation_matrices

LONGEST = 1.5  # std-dev along the view over that across it
TOLD = np.deg2rad(25)  # by which a camera must look past the middle of the rays: it sees a needle's length, then


def is_one_sided(cameras: list[Camera], flame: np.ndarray) -> bool:
    """Return whether no camera sees how long a Gaussian is along their middle ray. flame: (3,) its place, world m."""
    rays = flame - np.stack([camera.position for camera in cameras])
    rays /= np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), np.finfo(np.float32).tiny)
    return bool((rays @ rays.mean(0) > np.cos(TOLD) * np.linalg.norm(rays.mean(0))).all())


def blunt(gaussians: TransientGaussians, eye: np.ndarray) -> TransientGaussians:
    """Return the Gaussians, the longer ones shortened along the rays from a place to LONGEST; the others as they are.

    Args:
        eye: (3,) middle of the cameras, world m. A Gaussian just there keeps its shape.
    """
    away = gaussians.position - eye
    ray = away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), np.finfo(np.float32).tiny)
    axes = rotation_matrices(gaussians.rotation)
    covariance = np.einsum("nij,nj,nkj->nik", axes, gaussians.scale.astype(np.float64) ** 2, axes)
    along = np.einsum("ni,nij,nj->n", ray, covariance, ray)
    across = np.maximum(0.5 * (np.trace(covariance, axis1=1, axis2=2) - along), 0)  # rounding may take it below
    rows = np.flatnonzero(along > LONGEST**2 * across)
    shorter = np.sqrt(LONGEST**2 * across[rows] / along[rows])
    cut = np.eye(3) + (shorter - 1)[:, None, None] * ray[rows, :, None] * ray[rows, None]
    variance, turn = np.linalg.eigh(cut @ covariance[rows] @ cut)
    turn[:, :, 0] *= np.sign(np.linalg.det(turn))[:, None]  # a mirror image is no rotation
    scale, rotation = gaussians.scale.copy(), gaussians.rotation.copy()
    scale[rows] = np.sqrt(np.maximum(variance, np.finfo(np.float32).tiny))
    rotation[rows] = quaternions_wxyz(turn)
    return replace(gaussians, scale=scale, rotation=rotation)
