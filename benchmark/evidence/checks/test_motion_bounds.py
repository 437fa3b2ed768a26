"""What the cameras could know at best, on motion whose projection is known."""

import numpy as np
import pytest

from gof.reconstruct.fusion import fuse_frame
from gof.reconstruct.voxels import FlameVoxels
from gof_benchmark.evidence.motion_bounds import ClipFields, true_flow, with_speed_of
from tests.conftest import arc
from tests.reconstruct.plumes import box_of_voxels


@pytest.fixture(scope="module")
def voxels() -> FlameVoxels:
    """A box of 0.6 x 0.6 x 1.2 m in sight of three cameras."""
    box = box_of_voxels((12, 12, 24), 0.05)
    cameras = arc(3, target=(0, 0, 0.6))
    pixel = np.stack([camera.project(box.center)[0] for camera in cameras])
    jacobian = np.stack([camera.projection_jacobian(box.center) for camera in cameras])
    return FlameVoxels(box.center, box.voxel_size, box.index, box.resolution, pixel, jacobian, box.forward)


def test_true_flow_of_gas_that_moves_as_one_is_fused_to_its_velocity(voxels):
    velocity = np.array([0.3, -0.2, 1.5])
    emission = np.exp(-(voxels.center[:, :2] ** 2).sum(1) / 0.02)
    flow, mask = true_flow(voxels, np.tile(velocity, (len(emission), 1)), emission)
    found, known = fuse_frame(voxels, flow, mask, emission, "full", 0)
    bright = known & (emission > 0.1)
    assert bright.sum() > 100
    np.testing.assert_allclose(found[bright], np.tile(velocity, (bright.sum(), 1)), atol=0.1)


def test_parts_are_told_apart_and_add_up():
    """Two layers of two voxels in two frames; each part alone, then all together."""
    layer, emission = np.array([0, 0, 1, 1]), np.ones((2, 4))
    of_layer = np.zeros((2, 4, 3)) + np.array([1.0, 1, 3, 3])[:, None]
    standing = np.zeros((2, 4, 3)) + np.array([1.0, -1, 2, -2])[:, None]
    passing = np.array([1.0, -1])[:, None, None] + np.zeros((2, 4, 3))
    clip = ClipFields(layer, emission, of_layer)
    squares = [(v**2).sum() for v in (of_layer, standing, passing)]
    for k, velocity in enumerate((of_layer, standing, passing)):
        np.testing.assert_allclose(clip.parts(velocity), np.eye(3)[k] * squares[k], atol=1e-12)
    np.testing.assert_allclose(clip.parts(of_layer + standing + passing), squares)


def test_the_speed_of_one_along_the_other():
    np.testing.assert_allclose(with_speed_of(np.array([[3.0, 4, 0]]), np.array([[0, 0, 2.0]])), [[0, 0, 5]])
    np.testing.assert_allclose(with_speed_of(np.array([[3.0, 4, 0]]), np.zeros((1, 3))), np.zeros((1, 3)))
