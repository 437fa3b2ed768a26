"""A flame's surroundings: drawn in layers they are what one pass over all Gaussians draws, and hide what is behind."""

from dataclasses import replace

import drjit as dr
import numpy as np
import pytest

from gof.core.gaussians import TransientGaussians
from gof.reconstruct.optimize import Schedule
from gof.reconstruct.surroundings import Plates, StillScene
from gof.reconstruct.voxels import FlameVoxels
from gof.render import render
from gof.render.adam import Adam
from gof.render.backend import Float
from gof.render.rasterizer import splats_at
from tests.conftest import arc

CAMERA = arc(1, width=48, height=96, focal_px=110.0)[0]
RAY = CAMERA.world_to_camera[2, :3]  # where it looks
MIDDLE = CAMERA.unproject(np.array([[24.0, 48.0]]), np.array([float(CAMERA.to_camera(np.array([[0, 0, 0.75]]))[0, 2])]))
SIZE = 0.2  # of the flame, m


def cloud(away, n=60, spread=SIZE, seed=0, dynamic=False, opacity=0.6):
    """Gaussians about the middle, moved by `away` metres along the camera's view."""
    rng = np.random.default_rng(seed)
    return TransientGaussians(
        position=MIDDLE + away * RAY + spread * rng.uniform(-1, 1, (n, 3)),
        velocity=np.zeros((n, 3)),
        t_mu=np.zeros(n),
        t_sigma=np.full(n, np.inf),
        scale=rng.uniform(0.02, 0.06, (n, 3)),
        rotation=rng.normal(size=(n, 4)),
        opacity=rng.uniform(0.1, opacity, n),
        color=rng.uniform(0.2, 1, (n, 3)),
        dynamic=np.full(n, dynamic),
    )


def voxels():
    """The flame's place: a cube of SIZE to both sides."""
    step = SIZE / 4
    index = np.stack(np.meshgrid(*[np.arange(9)] * 3, indexing="ij"), -1).reshape(-1, 3)
    center = MIDDLE + (index - 4) * step
    empty = np.empty((1, len(center), 2))
    return FlameVoxels(
        center, step / 10, index, np.full(3, 9), empty, np.empty((1, len(center), 2, 3)), np.empty((1, 3))
    )


def drawn(surroundings, flame):
    color, share, _ = surroundings.draw(splats_at(flame, CAMERA, 0.0), 0, 0.005, {})
    shape = CAMERA.height, CAMERA.width
    return np.stack([plane.numpy().reshape(shape) for plane in color], -1), share.numpy().reshape(shape)


@pytest.mark.parametrize("places", [(-1.0, 0.0, 1.0), (-1.0, 1.0), (0.0,), (1.0,)])
def test_layers_are_the_picture_of_one_pass(places):
    still = TransientGaussians.concatenate([cloud(away, seed=k) for k, away in enumerate(places)])
    flame = cloud(0.0, seed=9, dynamic=True, spread=0.8 * SIZE)
    scene = StillScene(still, [CAMERA], voxels())
    color, share = drawn(scene, flame)
    whole, plates = scene.result(flame, {})
    assert plates == [] and whole.dynamic.sum() == len(flame) and len(whole) == len(still) + len(flame)
    together = render(whole, CAMERA, 0.0, near=0.005)
    np.testing.assert_allclose(color, together["color"], atol=2e-3)
    np.testing.assert_allclose(share, together["dynamic_alpha"], atol=2e-3)
    assert share.max() > 0.3, "otherwise nothing is tested"


def test_a_still_thing_in_front_hides_the_flame():
    wall = replace(cloud(-1.0, n=400, seed=3, opacity=0.9), color=np.tile([0.0, 0.0, 1.0], (400, 1)))
    flame = replace(cloud(0.0, seed=9, dynamic=True), color=np.tile([1.0, 0.0, 0.0], (60, 1)))
    before, _ = drawn(StillScene(wall, [CAMERA], voxels()), flame)
    behind, _ = drawn(StillScene(replace(wall, position=wall.position + 2 * RAY), [CAMERA], voxels()), flame)
    assert before[..., 0].sum() < 0.2 * behind[..., 0].sum()


@pytest.mark.parametrize("emissive", [False, True])
def test_a_plate_stands_before_the_flame_where_the_view_is_blocked(emissive):
    plate = np.full((1, CAMERA.height, CAMERA.width, 3), 0.25)
    blocked = np.zeros((1, CAMERA.height, CAMERA.width), bool)
    blocked[0, 40:60] = True
    flame = cloud(0.0, seed=9, dynamic=True)
    surroundings = Plates([CAMERA], plate, blocked, move=False, emissive=emissive)
    color, share = drawn(surroundings, flame)
    assert np.allclose(color[40:60], 0.25) and not share[40:60].any()
    free = render(replace(flame, emissive=emissive), CAMERA, 0.0, background=plate[0], near=0.005)["color"]
    np.testing.assert_allclose(color[:40], free[:40], atol=1e-5)
    assert np.abs(free[40:60] - 0.25).max() > 0.1, "otherwise nothing is tested"
    result, plates = surroundings.result(flame, {})
    assert result.emissive == emissive
    again = render(result, CAMERA, 0.0, background=plates[0], near=0.005)
    np.testing.assert_allclose(again["color"], color, atol=1e-5)
    np.testing.assert_allclose(again["alpha"], share, atol=1e-5)


def test_a_plate_that_is_hardly_seen_hardly_moves():
    """Left half under flame of opacity 0.95, right half open; the truth is brighter than the plate by 0.3 in both."""
    height, width, start, truth, flame = 8, 8, 0.2, 0.5, 0.9
    opacity = np.where(np.arange(width) < width // 2, 0.95, 0.0) * np.ones((height, 1))
    plates = Plates(
        [CAMERA], np.full((1, height, width, 3), start), np.zeros((1, height, width), bool), move=True, emissive=True
    )
    through = Float((1 - opacity).ravel())
    covered = Float((opacity * flame).ravel())
    seen = dr.fma(through, truth, covered) + Float(np.tile([0.01, -0.01], height * width // 2))  # and its noise
    optimizer = Adam(lr=0.002, params=plates.unknowns(), beta_2=0.99, epsilon=1e-15)
    for _ in range(600):
        plate = optimizer["plate_0"]
        drawn = [dr.fma(through, channel, covered) for channel in (plate.x, plate.y, plate.z)]
        loss = 0.8 * dr.mean(sum(dr.abs(channel - seen) for channel in drawn)) / 3
        dr.backward(loss + Schedule.plate_loss * plates.moved(0, optimizer))
        optimizer.step()
    _, (result,) = plates.result(cloud(0.0), optimizer)
    hidden, open_ = result[:, : width // 2], result[:, width // 2 :]
    assert np.abs(hidden - start).max() < 0.4 * 0.05 + 0.005, "by what the docstring of Schedule says"
    assert np.abs(open_ - truth).max() < 0.02
