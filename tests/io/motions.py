"""Motions and worlds that the tests of importers know in closed form."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from gof.core.trajectory import Trajectory


def moved_camera(similarity, camera_to_world):
    """A camera in a world that a similarity has changed; its axes keep their length."""
    out = similarity @ camera_to_world
    out[:3, :3] /= np.cbrt(np.linalg.det(out[:3, :3]))
    return out


def swirl(t, start, rate=9.0):
    """Places (N, 3) that turn about the z axis and climb, at t s."""
    c, s = np.cos(rate * t), np.sin(rate * t)
    return np.stack([c * start[:, 0] - s * start[:, 1], s * start[:, 0] + c * start[:, 1], start[:, 2] + 0.5 * t], -1)


def make_trajectory(times, n=40, rate=9.0):
    """A swirl sampled at times, and where it began."""
    start = np.random.default_rng(2).normal(size=(n, 3))
    position = np.stack([swirl(t, start, rate) for t in times])
    return Trajectory(
        times, position, np.full((len(times), n), 0.5), np.full((n, 3), 0.02), np.tile([1.0, 0, 0, 0], (n, 1))
    ), start


def similarity(scale=2.5, seed=0):
    """A 4x4 that stretches, turns and moves."""
    matrix = np.eye(4)
    matrix[:3, :3] = scale * Rotation.random(random_state=seed).as_matrix()
    matrix[:3, 3] = [1, -2, 3]
    return matrix


def trained(g, T):
    """Gaussians in metres, as a trainer holds them after the similarity T (4, 4)."""
    s = np.cbrt(np.linalg.det(T[:3, :3]))
    turn = Rotation.from_matrix(T[:3, :3] / s)
    rotation = (turn * Rotation.from_quat(g.rotation[:, [1, 2, 3, 0]])).as_quat()[:, [3, 0, 1, 2]]
    return replace(
        g,
        position=g.position @ T[:3, :3].T + T[:3, 3],
        velocity=g.velocity @ T[:3, :3].T,
        scale=s * g.scale,
        rotation=rotation,
    )
