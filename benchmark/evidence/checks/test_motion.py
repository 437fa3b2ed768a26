"""Bounds of what cameras can know, on motion whose projection is known."""

import numpy as np
import pytest

from gof.reconstruct.fusion import fuse_frame
from gof.reconstruct.voxels import FlameVoxels
from gof_benchmark.evidence.motion_bounds import ClipFields, true_flow, with_speed_of
from gof_benchmark.evidence.noise_truth import Step, edge_distance, own_speed, resampled
from gof_benchmark.evidence.rise_speed import climb
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


# ----------------------------------------------------------------
# The measure of fine noise: a flame's edge that was moved by a known distance, and one that moves at a known speed.


def test_an_edge_that_was_moved_by_three_voxels():
    x = np.arange(40)[:, None, None] * np.ones((40, 12, 12))
    wall = (x < 20).astype(float)
    assert edge_distance(np.roll(wall, 3, 0)[5:], wall[5:]).max() == 3
    assert edge_distance(wall, wall).max() == 0


@pytest.mark.parametrize("own_m_s", [0.0, 0.4, -0.8])
def test_the_speed_against_the_gas(own_m_s):
    """The gas and its flame move at 1.5 m/s along x, the drawn flame by `own_m_s` faster, for 5 ms."""
    cell_m, step_s, gas_m_s = 0.02, 0.005, 1.5
    coarse, fine = (24, 8, 8), (48, 16, 16)

    def step(time_s: float) -> tuple[Step, Step]:
        velocity = np.zeros((*coarse, 3))
        velocity[..., 0] = gas_m_s

        def flame(shape, speed):
            x = (np.arange(shape[0]) + 0.5) * 24 * cell_m / shape[0]
            front = 1 / (1 + np.exp((x - 0.24 - speed * time_s) / 0.03))
            return np.broadcast_to(front[:, None, None], shape)

        return Step(flame(coarse, gas_m_s), velocity, cell_m), Step(flame(fine, gas_m_s + own_m_s), velocity, cell_m)

    (plain, noise), (plain_next, noise_next) = step(0.0), step(step_s)
    own, gas = own_speed(plain, noise, plain_next, noise_next, step_s)
    assert own == pytest.approx(abs(own_m_s), abs=0.06) and gas == pytest.approx(gas_m_s, rel=1e-6)


def test_resampling_keeps_a_linear_field_in_place():
    x = np.arange(8) + 0.5
    found = resampled(np.broadcast_to(x[:, None, None], (8, 4, 4)), (16, 8, 8))[:, 0, 0]
    np.testing.assert_allclose(found[1:-1], ((np.arange(16) + 0.5) / 2)[1:-1], atol=1e-6)


# ----------------------------------------------------------------
# The slope of traces in height against time, on traces whose slope is known.

HEIGHT, FRAME_S = 160, 0.01


def rising(speed, frames=36, life=8.0, standing=0.0, seed=0):
    """(T, H) blobs that climb at `speed` px per frame, come and go, in the light of a flame that stands."""
    rng = np.random.default_rng(seed)
    rows, times = np.arange(HEIGHT), np.arange(frames)[:, None]
    light = np.exp(-0.5 * ((rows - 110) / 30.0) ** 2) * np.ones((frames, 1)) * 2
    for _ in range(150):
        start, when, amount = rng.uniform(-50, HEIGHT + 50), rng.uniform(-10, frames + 10), rng.uniform(0.1, 0.4)
        place = start - (speed if rng.random() >= standing else 0) * (times - when)
        light += amount * np.exp(-0.5 * ((times - when) / life) ** 2 - 0.5 * ((rows - place) / 3.0) ** 2)
    return light


@pytest.mark.parametrize("speed", [1.0, 2.0, 5.0])
def test_climbing_blobs(speed):
    found = np.mean([climb(rising(speed, seed=seed), FRAME_S) for seed in range(3)])
    assert found == pytest.approx(speed / FRAME_S, rel=0.08)


def test_drawn_oftener_it_is_the_same_speed():
    often = rising(0.5, frames=144, life=32.0)
    assert climb(often, FRAME_S / 4, (8, 12, 16, 20, 24)) == pytest.approx(200, rel=0.08), "0.5 px in 2.5 ms"


def test_blobs_that_only_come_and_go_do_not_climb():
    assert climb(rising(3.0, standing=1.0), FRAME_S) < 0.3 / FRAME_S


def test_nothing_to_measure():
    assert np.isnan(climb(np.ones((36, HEIGHT)), FRAME_S)), "a steady flame"
    assert np.isnan(climb(rising(2.0, frames=3), FRAME_S)), "too short"
