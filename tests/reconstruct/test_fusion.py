"""Flow fusion against exact flow of known velocities, its invariances, and its bad points."""

import numpy as np
import pytest

from gof.reconstruct.fusion import FUSIONS, back_projected_flow, fuse_frame
from gof.reconstruct.voxels import carve
from tests.conftest import arc


def setup(n_points=60, cameras=3, scale=1.0, seed=0):
    """Random points, exact per-camera Jacobians, random true velocities and their exact flows."""
    rng = np.random.default_rng(seed)
    points = rng.normal(0, 0.2, (n_points, 3)) + [0, 0, 1]
    jacobian = np.stack([c.projection_jacobian(points) for c in arc(cameras)]) / scale
    velocity = rng.normal(0, 1, (n_points, 3)) * scale
    flow = np.einsum("cvij,vj->cvi", jacobian, velocity)
    return jacobian, flow, np.ones(flow.shape[:2], bool), velocity


def fuse(name, jacobian, flow, valid, **options):
    """The cameras of `setup`."""
    forward = np.stack([camera.world_to_camera[2, :3] for camera in arc(len(jacobian))])
    return FUSIONS[name](jacobian, flow, valid, forward, **options)


@pytest.mark.parametrize("step", [1e-6, 1.0])
def test_back_projection_is_the_papers(step):
    """eq. 4: pi^-1(f h + pi(x), x) - x at the depth of x, divided by the step h, through the camera matrix itself."""
    camera = arc(1)[0]
    points = np.random.default_rng(3).normal(0, 0.2, (10, 3)) + [0, 0, 1]
    flow = np.random.default_rng(4).normal(0, 10, (10, 2))
    pixel, depth = camera.project(points)
    moved = np.concatenate([pixel + step * flow, np.ones((10, 1))], 1)
    rays = moved @ np.linalg.inv(camera.K).T
    printed = ((rays * depth[:, None]) - camera.to_camera(points)) @ camera.world_to_camera[:3, :3] / step
    ours = back_projected_flow(camera.projection_jacobian(points), flow, camera.world_to_camera[2, :3])
    np.testing.assert_allclose(ours, printed, rtol=1e-6, atol=1e-6 * np.abs(printed).max())


def test_the_papers_ridge_is_the_authors():
    """Their code: (sum u u^T + 0.1 mean |u|^2) F = sum |u|^2 u, written out for one voxel."""
    jacobian, flow, valid, _ = setup(n_points=1)
    axes = [camera.world_to_camera[2, :3] for camera in arc(3)]
    u = np.stack([back_projected_flow(J, f, a)[0] for J, f, a in zip(jacobian, flow, axes, strict=True)])
    ridge = 0.1 * (u**2).sum(1).mean()
    expected = np.linalg.solve(u.T @ u + ridge * np.eye(3), u.T @ (u**2).sum(1))
    np.testing.assert_allclose(fuse("paper", jacobian, flow, valid)[0], expected, rtol=1e-9)


def test_full_information_recovers_the_velocity_from_exact_flow():
    jacobian, flow, valid, velocity = setup()
    np.testing.assert_allclose(fuse("full", jacobian, flow, valid, ridge=1e-9), velocity, atol=1e-5)


def test_two_cameras_are_enough_for_full_information_but_not_for_the_paper():
    jacobian, flow, valid, velocity = setup(cameras=2)
    full = fuse("full", jacobian, flow, valid, ridge=1e-9)
    np.testing.assert_allclose(full, velocity, atol=1e-4)
    paper = fuse("paper", jacobian, flow, valid, tau0=1e-12)
    assert np.abs(paper - velocity).mean() > 0.1, "two equations for three unknowns"


def test_the_papers_constraint_holds_in_the_limit_of_no_regularisation():
    jacobian, flow, valid, _ = setup()
    F = fuse("paper", jacobian, flow, valid, tau0=1e-10)
    for J, f, camera in zip(jacobian, flow, arc(3), strict=True):
        u = back_projected_flow(J, f, camera.world_to_camera[2, :3])
        residual = ((F - u) * u).sum(1) / (u**2).sum(1)
        assert np.median(np.abs(residual)) < 1e-6


@pytest.mark.parametrize("fusion", ["full", "paper"])
@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_result_scales_with_the_scene(fusion, scale):
    """The same scene in other units of length gives the same velocities in those units."""
    base = fuse(fusion, *setup()[:3])
    np.testing.assert_allclose(fuse(fusion, *setup(scale=scale)[:3]) / scale, base, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("fusion", ["full", "paper"])
def test_result_scales_with_the_clock(fusion):
    jacobian, flow, valid, _ = setup()
    np.testing.assert_allclose(
        fuse(fusion, jacobian, flow * 1e-3, valid), fuse(fusion, jacobian, flow, valid) * 1e-3, rtol=1e-9
    )


@pytest.mark.parametrize("fusion", ["full", "paper"])
def test_bad_points_are_finite_and_zero(fusion):
    jacobian, flow, valid, _ = setup()
    assert (fuse(fusion, jacobian, flow * 0, valid) == 0).all(), "zero flow"
    assert (fuse(fusion, jacobian, flow, valid & False) == 0).all(), "no camera"
    one = valid.copy()
    one[1:] = False
    for case in (
        fuse(fusion, jacobian, flow, one),
        fuse(fusion, jacobian[:1].repeat(3, 0), flow[:1].repeat(3, 0), valid),  # parallel rays
        fuse(fusion, jacobian, flow * 1e6, valid),
        fuse(fusion, jacobian, flow * 1e-12, valid),
    ):
        assert np.isfinite(case).all()
    assert fuse(fusion, jacobian[:, :0], flow[:, :0], valid[:, :0]).shape == (0, 3)


def test_one_camera_gives_no_motion_along_its_ray():
    jacobian, flow, valid, _ = setup()
    valid[1:] = False
    F = fuse("full", jacobian, flow, valid)
    null = np.cross(jacobian[0, :, 0], jacobian[0, :, 1])
    along = (F * null).sum(1) / np.linalg.norm(null, axis=1)
    assert np.abs(along).max() < 1e-9


def test_smoothing_keeps_a_constant_field_and_fills_gaps():
    cameras = arc(3)
    masks = np.zeros((1, 3, 64, 36), bool)
    masks[:, :, 16:48, 10:26] = True
    voxels = carve(cameras, masks, 20)
    true = np.array([0.1, -0.2, 1.5])
    flow = np.full((3, 64, 36, 2), np.nan, np.float32)
    for c, camera in enumerate(cameras):  # exact flow of a constant velocity on the plane of the flame's centre
        flow[c] = camera.projection_jacobian(np.array([[0, 0, 1.0]]))[0] @ true
    flow[:, 30:33] = np.nan
    velocity, known = fuse_frame(voxels, flow, masks[0], np.ones(len(voxels.center)), smooth_voxels=2)
    assert known.all()
    near = np.linalg.norm(voxels.center - [0, 0, 1], axis=1) < 0.3
    np.testing.assert_allclose(velocity[near].mean(0), true, atol=0.06)


def test_empty_mask_gives_nothing_known():
    cameras = arc(2)
    masks = np.ones((1, 2, 64, 36), bool)
    voxels = carve(cameras, masks, 8)
    velocity, known = fuse_frame(voxels, np.zeros((2, 64, 36, 2)), masks[0] & False, np.zeros(len(voxels.center)))
    assert not known.any() and (velocity == 0).all()
