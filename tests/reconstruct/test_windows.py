"""A camera's window: what is drawn in it is that part of the whole picture, at the times at which it was read."""

from dataclasses import replace

import numpy as np
import pytest

from gof.core.cameras import READOUT_DIRECTIONS
from gof.core.gaussians import TransientGaussians
from gof.reconstruct.parameters import splats, to_raw
from gof.reconstruct.voxels import ROOM, FlameVoxels
from gof.reconstruct.windows import Windows
from gof.render import render_splats
from gof.render.bins import BLOCK
from tests.conftest import arc

WIDTH, HEIGHT = 48, 96
CAMERAS = arc(3, width=WIDTH, height=HEIGHT, focal_px=110.0)
VOXEL = 0.02
TOP = np.array([0.05, -0.02, 1.3])  # of the flame, m: off the middle


def voxels(radius=0.08, height=0.3):
    rng = np.random.default_rng(0)
    center = TOP + rng.uniform([-radius, -radius, -height], [radius, radius, 0], (500, 3))
    nothing = np.empty(0)
    return FlameVoxels(center, VOXEL, np.zeros((500, 3), int), np.ones(3, int), nothing, nothing, nothing)


def flame(n=40):
    rng = np.random.default_rng(2)
    return TransientGaussians(
        position=TOP + rng.uniform([-0.06, -0.06, -0.28], [0.06, 0.06, 0], (n, 3)),
        velocity=rng.normal(0, 3, (n, 3)),
        t_mu=rng.uniform(0, 0.01, n),
        t_sigma=np.full(n, 0.005),
        scale=rng.uniform(0.01, 0.03, (n, 3)),
        rotation=rng.normal(size=(n, 4)),
        opacity=rng.uniform(0.2, 0.8, n),
        color=rng.uniform(0.2, 1, (n, 3)),
        dynamic=np.ones(n, bool),
    )


def drawn(raw, camera, time_s):
    frame = render_splats(splats(raw, VOXEL, time_s, camera), camera, near=VOXEL)
    return np.stack([plane.numpy().reshape(camera.height, camera.width) for plane in frame.color], -1)


@pytest.mark.parametrize("readout", READOUT_DIRECTIONS)
def test_what_is_drawn_in_a_window_is_that_part_of_the_picture(readout):
    cameras = [replace(camera, row_time_s=5e-5, readout=readout) for camera in CAMERAS]
    windows = Windows.around(voxels(), cameras)
    parts, later_s = windows.cameras(cameras), windows.read_later_s(cameras)
    raw = to_raw(flame(), VOXEL, 0.0)
    for c, (x, y) in enumerate(windows.corner):
        expected = drawn(raw, cameras[c], 0.004)
        seen = drawn(raw, parts[c], 0.004 + later_s[c])
        np.testing.assert_allclose(seen, windows.cut(c, expected), atol=2e-5)
        assert windows.cut(c, expected).shape == (windows.height, windows.width, 3)
        expected[y : y + windows.height, x : x + windows.width] = 0
        assert not expected.any(), "all of the flame is in the window"
        assert later_s[c] > 0 and seen.max() > 0.3, "otherwise nothing is tested"


def test_a_window_holds_the_flame_and_its_room_and_little_else():
    windows = Windows.around(voxels(), CAMERAS)
    for camera, corner in zip(CAMERAS, windows.corner, strict=True):
        pixels, depth = camera.project(voxels().center)
        room = ROOM * VOXEL * camera.K[0, 0] / depth[:, None]
        assert (pixels - room >= corner).all() and (pixels + room <= corner + (windows.width, windows.height)).all()
    assert windows.width * windows.height < 0.5 * WIDTH * HEIGHT
    assert windows.width % BLOCK == windows.height % BLOCK == 0, "nothing is drawn to be cut off"


def test_a_flame_that_leaves_the_picture_and_one_that_a_camera_stands_in():
    large = Windows.around(voxels(radius=2.0, height=1.0), CAMERAS)
    assert (large.width, large.height) == (WIDTH, HEIGHT) and not large.corner.any()
    at_the_border = replace(voxels(), center=voxels().center + [0, 0, 0.25])
    windows = Windows.around(at_the_border, CAMERAS)
    assert (windows.corner >= 0).all() and (windows.corner + (windows.width, windows.height) <= (WIDTH, HEIGHT)).all()


@pytest.mark.parametrize("channels", [3, 4])
def test_plates_change_in_their_windows_alone(channels):
    rng = np.random.default_rng(1)
    made, blocked = rng.random((3, HEIGHT, WIDTH, 3), np.float32), rng.random((3, HEIGHT, WIDTH)) < 0.1
    windows = Windows.around(voxels(), CAMERAS)
    parts = [np.full((windows.height, windows.width, channels), c / 10) for c in range(len(CAMERAS))]
    plates = windows.plates(parts, made, blocked)
    for c, (x, y) in enumerate(windows.corner):
        inside = np.zeros((HEIGHT, WIDTH), bool)
        inside[y : y + windows.height, x : x + windows.width] = True
        np.testing.assert_allclose(plates[c][inside], c / 10, atol=1e-7)
        np.testing.assert_array_equal(plates[c][~inside][:, :3], made[c][~inside])
        assert channels == 3 or (plates[c][~inside][:, 3] == blocked[c][~inside]).all()
    assert windows.plates([], made, blocked) == []
