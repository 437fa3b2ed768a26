"""Bundle adjustment: exact truth is found again, from far down the valley in which turning and moving look alike."""

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from gof.ingest.bundle import BundleParameters, Sightings, adjust
from tests.ingest.scene import cameras, pose_errors


def seen_points(rig, count=120, noise=0.0, seed=0):
    """Sightings of a square board (body 0) and of free points, the points, and the noise-free state."""
    rng = np.random.default_rng(seed)
    points = rng.uniform([-0.9, -0.6, -0.1], [0.9, 1.5, 1.3], (count, 3))
    board = np.array([[0, 0, 0], [0.1, 0, 0], [0.1, 0, 0.1], [0, 0, 0.1]])
    rows = []
    for c, camera in enumerate(rig):
        for k, pixel in enumerate(camera.project(points)[0]):
            rows.append((c, pixel + rng.normal(0, noise, 2), 1.0, k, 0, np.zeros(3)))
        for xyz, pixel in zip(board, camera.project(board)[0], strict=True):
            rows.append((c, pixel, 1.0, -1, 0, xyz))
    order = rng.permutation(len(rows))
    return Sightings(*(np.array(column) for column in zip(*(rows[k] for k in order), strict=True))), points


def start_away(rig, points, degrees, seed=1):
    """Cameras swung around the scene, and points moved along the rays: as a rough marker starts a solution."""
    poses = np.array([c.world_to_camera for c in rig])
    for k, angle in enumerate((-degrees, 0, degrees)):
        swing = np.eye(4)
        swing[:3, :3] = Rotation.from_euler("z", angle, degrees=True).as_matrix()
        poses[k] = poses[k] @ swing
    rng = np.random.default_rng(seed)
    return BundleParameters(poses, np.eye(4)[None], points + rng.normal(0, 0.03, points.shape))


@pytest.mark.parametrize("degrees", [1.0, 5.0])
def test_truth_is_found_again(degrees):
    rig = cameras()
    seen, points = seen_points(rig)
    found = adjust(start_away(rig, points, degrees), seen, np.stack([c.K for c in rig]))
    board = found.bodies[0]
    np.testing.assert_allclose(found.cameras @ board, [c.world_to_camera for c in rig], atol=1e-5)
    np.testing.assert_allclose((found.points - board[:3, 3]) @ board[:3, :3], points, atol=1e-4)


@pytest.mark.parametrize("offset", [0.0, 6e6])
def test_mismatches_hardly_pull(offset):
    """A tenth of the pixels is anywhere; far from the world's origin the answer is the same."""
    rig = cameras()
    seen, points = seen_points(rig, noise=0.2)
    rng = np.random.default_rng(2)
    wrong = (rng.random(len(seen.camera)) < 0.1) & (seen.point >= 0)
    seen.pixel[wrong] += rng.normal(0, 30, (wrong.sum(), 2))
    start = start_away(rig, points, 2.0)
    away = np.eye(4)
    away[0, 3] = offset  # the board stays at 0 of its own axes; the world is elsewhere
    moved = BundleParameters(start.cameras @ np.linalg.inv(away), away @ start.bodies, start.points + away[:3, 3])
    found = adjust(moved, seen, np.stack([c.K for c in rig]))
    angle, shift = pose_errors(found.cameras, [c.world_to_camera for c in rig])
    assert angle < 1 and shift < 0.03  # least squares: 10 degrees and more


def test_the_minimum_is_the_one_another_solver_finds():
    """SciPy's dense Levenberg-Marquardt, without a loss, on a problem small enough for it."""
    rig = cameras()
    seen, points = seen_points(rig, count=12, noise=0.01)
    K = np.stack([c.K for c in rig])
    start = start_away(rig, points, 0.5)

    def residuals(x):
        total = []
        poses, cloud = x[:18].reshape(3, 6), x[18:].reshape(-1, 3)
        for c, pixel, _, k, _, xyz in zip(*(getattr(seen, n) for n in seen.__dataclass_fields__), strict=True):
            X = xyz if k < 0 else cloud[k]
            local = Rotation.from_rotvec(poses[c, :3]).as_matrix() @ X + poses[c, 3:]
            total.append((K[c] @ local)[:2] / local[2] - pixel)
        return np.concatenate(total)

    turns = Rotation.from_matrix(start.cameras[:, :3, :3]).as_rotvec()
    x0 = np.concatenate([np.column_stack([turns, start.cameras[:, :3, 3]]).ravel(), start.points.ravel()])
    theirs = least_squares(residuals, x0, method="lm").x[:18].reshape(3, 6)
    found = adjust(start, seen, K)
    ours = found.cameras @ found.bodies[0]
    np.testing.assert_allclose(Rotation.from_matrix(ours[:, :3, :3]).as_rotvec(), theirs[:, :3], atol=2e-5)
    np.testing.assert_allclose(ours[:, :3, 3], theirs[:, 3:], atol=1e-4)


def test_two_boards_keep_their_shape_and_find_their_place():
    rig = cameras()
    seen, points = seen_points(rig)
    place = np.eye(4)
    place[:3, :3] = Rotation.from_euler("zy", [30, 10], degrees=True).as_matrix()
    place[:3, 3] = [0.4, 0.1, 0.3]
    square = np.array([[0, 0, 0], [0.1, 0, 0], [0.1, 0, 0.1], [0, 0, 0.1]])
    rows = [
        (c, pixel, 1.0, -1, 1, xyz)
        for c, camera in enumerate(rig)
        for xyz, pixel in zip(square, camera.project(square @ place[:3, :3].T + place[:3, 3])[0], strict=True)
    ]
    more = [np.array(column) for column in zip(*rows, strict=True)]
    both = Sightings(
        *(np.concatenate([getattr(seen, n), m]) for n, m in zip(seen.__dataclass_fields__, more, strict=True))
    )
    start = start_away(rig, points, 2.0)
    rough = place.copy()
    rough[:3, 3] += [0.02, -0.02, 0.01]
    found = adjust(
        BundleParameters(start.cameras, np.stack([np.eye(4), rough]), start.points), both, np.stack([c.K for c in rig])
    )
    np.testing.assert_allclose(np.linalg.inv(found.bodies[0]) @ found.bodies[1], place, atol=1e-5)


def test_a_point_behind_a_camera_stays_finite():
    rig = cameras()
    seen, points = seen_points(rig)
    points = points.copy()
    points[0] = 2 * rig[0].position
    found = adjust(
        BundleParameters(np.array([c.world_to_camera for c in rig]), np.eye(4)[None], points),
        seen,
        np.stack([c.K for c in rig]),
    )
    assert np.isfinite(found.points).all() and np.isfinite(found.cameras).all()
    angle, _ = pose_errors(found.cameras, [c.world_to_camera for c in rig])
    assert angle < 0.05
