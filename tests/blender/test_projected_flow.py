"""Exact optical flow against the projection of moving points."""

import numpy as np
import pytest

from gof.core.cameras import Camera
from gof_blender.pure.io import projected_flow

INDEX_TO_WORLD = np.array([[0.05, 0, 0, -0.5], [0, 0.05, 0, -0.4], [0, 0, 0.05, 0.1], [0, 0, 0, 1.0]])
POSE = np.array([[1, 0, 0, 0], [0, 0, -1, 0.6], [0, 1, 0, 2.5], [0, 0, 0, 1.0]])
CAMERA = Camera("c", 80, 100, [[140.0, 0, 40], [0, 150.0, 50], [0, 0, 1]], POSE)
SHAPE = (20, 16, 22)
EVERYWHERE = np.ones((100, 80), bool)


def project(emission, velocity, mask=EVERYWHERE):
    return projected_flow.flow(CAMERA.K, POSE, (100, 80), emission, velocity, INDEX_TO_WORLD, mask, step_cells=0.25)


def test_a_glowing_spot_moves_like_its_projection():
    emission = np.zeros(SHAPE)
    emission[12, 7, 9] = 1.0
    v = np.array([0.4, -0.3, 0.7])
    flow, weight = project(emission, np.broadcast_to(v, (*SHAPE, 3)))
    point = INDEX_TO_WORLD[:3, :3] @ [12.5, 7.5, 9.5] + INDEX_TO_WORLD[:3, 3]
    pixel = CAMERA.project(point[None])[0][0]
    row, column = np.unravel_index(weight.argmax(), weight.shape)
    assert np.abs([column + 0.5 - pixel[0], row + 0.5 - pixel[1]]).max() < 0.7
    h = 1e-5
    expected = (CAMERA.project((point + h * v)[None])[0][0] - CAMERA.project((point - h * v)[None])[0][0]) / (2 * h)
    np.testing.assert_allclose(flow[row, column], expected, rtol=0.02)


def test_light_weighs_the_layers_of_a_ray():
    emission, velocity = np.zeros(SHAPE), np.zeros((*SHAPE, 3))
    emission[:, 3], emission[:, 12] = 1.0, 3.0
    velocity[:, 2:5, :, 2], velocity[:, 11:14, :, 2] = 1.0, 2.0
    flow, weight = project(emission, velocity)
    depths = 2.5 + INDEX_TO_WORLD[1, 3] + 0.05 * np.array([3.5, 12.5])
    expected = -(1.0 * 150 / depths[0] + 3 * 2.0 * 150 / depths[1]) / 4
    assert flow[50, 40, 1] == pytest.approx(expected, rel=0.02)
    assert weight[50, 40] == pytest.approx(4 * 0.05, rel=0.1)


@pytest.mark.long
def test_bad_points_stay_finite():
    for emission in (np.zeros(SHAPE), np.ones(SHAPE)):
        flow, weight = project(emission, np.full((*SHAPE, 3), 1e3))
        assert np.isfinite(flow).all() and np.isfinite(weight).all()
        assert not flow[weight == 0].any()
    flow, weight = project(np.ones(SHAPE), np.ones((*SHAPE, 3)), ~EVERYWHERE)
    assert not flow.any() and not weight.any()
    behind = np.diag([1.0, -1, -1, 1]) @ POSE
    flow, _ = projected_flow.flow(
        CAMERA.K, behind, (100, 80), np.ones(SHAPE), np.ones((*SHAPE, 3)), INDEX_TO_WORLD, EVERYWHERE
    )
    assert np.isfinite(flow).all()
