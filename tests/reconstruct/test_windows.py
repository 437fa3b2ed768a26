"""A camera's window: what is drawn in it is that part of the whole picture, at the times at which it was read."""

from dataclasses import replace

import numpy as np
import pytest

from gof.cameras import READOUT_DIRECTIONS
from gof.gaussians import TransientGaussians
from gof.reconstruct.observation import Observation
from gof.reconstruct.parameters import splats, to_raw
from gof.reconstruct.voxels import ROOM, FlameVoxels
from gof.reconstruct.windows import Windows
from gof.render import render_splats
from tests.conftest import arc

WIDTH, HEIGHT, FRAMES = 48, 96, 2
CAMERAS = arc(3, width=WIDTH, height=HEIGHT, focal_px=110.0)
VOXEL = 0.02
TOP = np.array([0.05, -0.02, 1.3])  # of the flame, m: off the middle


def voxels(radius=0.08, height=0.3):
    rng = np.random.default_rng(0)
    center = TOP + rng.uniform([-radius, -radius, -height], [radius, radius, 0], (500, 3))
    nothing = np.empty(0)
    return FlameVoxels(center, VOXEL, np.zeros((500, 3), int), np.ones(3, int), nothing, nothing, nothing)


def observation(cameras):
    rng = np.random.default_rng(1)
    shape = FRAMES, len(cameras), HEIGHT, WIDTH
    return Observation(
        cameras=cameras,
        frames=np.arange(FRAMES),
        time_s=np.arange(FRAMES) * 0.01,
        camera_time_s=np.tile(np.arange(FRAMES) * 0.01, (len(cameras), 1)),
        image=rng.random((*shape, 3), np.float32),
        static=rng.random((*shape[1:], 3), np.float32),
        plate=rng.random((*shape[1:], 3), np.float32),
        intensity=rng.random(shape, np.float32),
        mask=rng.random(shape) < 0.5,
        allowed=rng.random(shape) < 0.5,
        flow=rng.random((*shape, 2), np.float32),
        delivered=np.ones(shape[:2], bool),
        blocked=rng.random(shape[1:]) < 0.1,
    )


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
    whole = observation(cameras)
    windows = Windows.around(voxels(), cameras)
    part = windows.observed(whole)
    raw = to_raw(flame(), VOXEL, 0.0)
    for c, (x, y) in enumerate(windows.corner):
        expected = drawn(raw, cameras[c], 0.004)
        later = part.camera_time_s[c, 0] - whole.camera_time_s[c, 0]
        seen = drawn(raw, part.cameras[c], 0.004 + later)
        inside = np.s_[y : y + windows.height, x : x + windows.width]
        np.testing.assert_allclose(seen, expected[inside], atol=2e-5)
        expected[inside] = 0
        assert not expected.any(), "all of the flame is in the window"
        assert later > 0 and seen.max() > 0.3, "otherwise nothing is tested"


def test_a_window_holds_the_flame_and_its_room_and_little_else():
    windows = Windows.around(voxels(), CAMERAS)
    for camera, corner in zip(CAMERAS, windows.corner, strict=True):
        pixels, depth = camera.project(voxels().center)
        room = ROOM * VOXEL * camera.K[0, 0] / depth[:, None]
        assert (pixels - room >= corner).all() and (pixels + room <= corner + (windows.width, windows.height)).all()
    assert windows.width * windows.height < 0.5 * WIDTH * HEIGHT


def test_a_flame_that_leaves_the_picture_and_one_that_a_camera_stands_in():
    large = Windows.around(voxels(radius=2.0, height=1.0), CAMERAS)
    assert (large.width, large.height) == (WIDTH, HEIGHT) and not large.corner.any()
    at_the_border = replace(voxels(), center=voxels().center + [0, 0, 0.25])
    windows = Windows.around(at_the_border, CAMERAS)
    assert (windows.corner >= 0).all() and (windows.corner + (windows.width, windows.height) <= (WIDTH, HEIGHT)).all()
    whole = observation(CAMERAS)
    assert large.observed(whole) is whole


def test_everything_a_camera_saw_is_of_its_window():
    whole = observation(CAMERAS)
    windows = Windows.around(voxels(), CAMERAS)
    part = windows.observed(whole)
    for c, (x, y) in enumerate(windows.corner):
        inside = np.s_[y : y + windows.height, x : x + windows.width]
        for name in ("image", "intensity", "mask", "allowed", "flow"):
            for f in range(FRAMES):
                np.testing.assert_array_equal(getattr(part, name)[f, c], getattr(whole, name)[f, c][inside])
        for name in ("static", "plate", "blocked"):
            np.testing.assert_array_equal(getattr(part, name)[c], getattr(whole, name)[c][inside])


@pytest.mark.parametrize("channels", [3, 4])
def test_plates_change_in_their_windows_alone(channels):
    whole = observation(CAMERAS)
    windows = Windows.around(voxels(), CAMERAS)
    parts = [np.full((windows.height, windows.width, channels), c / 10) for c in range(len(CAMERAS))]
    plates = windows.plates(parts, whole)
    for c, (x, y) in enumerate(windows.corner):
        inside = np.zeros((HEIGHT, WIDTH), bool)
        inside[y : y + windows.height, x : x + windows.width] = True
        np.testing.assert_allclose(plates[c][inside], c / 10, atol=1e-7)
        np.testing.assert_array_equal(plates[c][~inside][:, :3], whole.plate[c][~inside])
        assert channels == 3 or (plates[c][~inside][:, 3] == whole.blocked[c][~inside]).all()
    assert windows.plates([], whole) == []
