"""Trivial baselines of real clips: the trivial baselines know the answer where a picture moves as a whole."""

import cv2
import numpy as np
import pytest

from gof.core.gaussians import TransientGaussians
from gof.dataset import Dataset
from gof_benchmark.evidence.real_clips import believing, carried_along_flow, figures, mean_of_neighbours
from gof_benchmark.evidence.real_depth import HeldOutView, ScoredParts, scores, what_is_drawn
from tests.conftest import arc, look_at, write_dataset
from tests.reconstruct.rising_flame import DT, write_flame


@pytest.fixture(scope="module")
def sliding(tmp_path_factory):
    """A textured picture that slides by 3 px a frame before a dark plate; all of it burns."""
    rng = np.random.default_rng(0)
    texture = np.clip(0.6 + 0.8 * cv2.GaussianBlur(rng.normal(size=(96, 120, 1)), (0, 0), 2.0), 0, 1)
    texture = np.repeat(texture[..., None], 3, -1) * [1.0, 0.6, 0.2]
    cameras = arc(2, width=48, height=96)
    frames = [np.stack([texture[:, 3 * t : 3 * t + 48]] * 2) for t in range(9)]
    plates = np.full((2, 96, 48, 3), 0.02)
    folder = tmp_path_factory.mktemp("sliding") / "data"
    masks = np.ones((9, 2, 96, 48))
    masks[..., :8] = masks[..., -8:] = 0  # content that comes in at the side is new
    return write_dataset(folder, cameras, np.stack(frames), plates, 0.01 * np.arange(9), masks=masks, test_frames=(4,))


def test_along_the_flow_the_frames_around_say_what_is_between(sliding):
    dataset = Dataset.open(sliding)
    mean, carried = (figures(dataset, way(dataset)) for way in (mean_of_neighbours, carried_along_flow))
    truth = figures(dataset, dataset.image)
    assert truth[0] == 100, "no error at all: no picture counts more"
    assert carried[0] > mean[0] + 6 and carried[0] > 30


def test_what_is_believed_of_the_clocks(tmp_path):
    folder = write_flame(tmp_path / "late", row_time_s=1e-4, late={1: 0.004, 2: -0.006})
    dataset = Dataset.open(folder)
    own = [dataset.camera_times_s(c) for c in range(3)]
    assert abs(own[1] - own[0]).max() > 0.003, "otherwise nothing is tested"
    frames, snapshots = believing(dataset, "frames"), believing(dataset, "snapshots")
    neither = believing(dataset, "neither")
    for c, camera in enumerate(dataset.cameras):
        middle = 0.5 * 1e-4 * (camera.width if camera.readout in ("left", "right") else camera.height)
        np.testing.assert_allclose(frames.camera_times_s(c), DT * np.arange(10), atol=1e-12)
        np.testing.assert_allclose(snapshots.camera_times_s(c), own[c] + middle, atol=1e-12)
        np.testing.assert_allclose(neither.camera_times_s(c), DT * np.arange(10) + middle, atol=1e-12)
    assert [k.row_time_s for k in frames.cameras] == [1e-4] * 3
    assert [k.row_time_s for k in snapshots.cameras] == [k.row_time_s for k in neither.cameras] == [0.0] * 3


# ----------------------------------------------------------------
# The score of real flames' depth, where the answer is known: a sheet of light before a wall, square to the camera.

CAMERA = look_at("a", (0, -4, 0), (0, 0, 0), width=61, height=61, focal_px=50.0)


def sheet(distance, half_width, opacity):
    """Flat Gaussians side by side, that far from the camera."""
    x, z = (axis.ravel() for axis in np.meshgrid(*[np.arange(-half_width, half_width + 0.01, 0.1)] * 2))
    n = len(x)
    return TransientGaussians(
        position=np.stack([x, np.full(n, distance - 4.0), z], 1),
        velocity=np.zeros((n, 3)),
        t_mu=np.zeros(n),
        t_sigma=np.full(n, np.inf),
        scale=np.tile([0.1, 1e-3, 0.1], (n, 1)),
        rotation=np.tile([1.0, 0, 0, 0], (n, 1)),
        opacity=np.full(n, opacity),
        color=np.ones((n, 3)),
        dynamic=np.ones(n, bool),
    )


@pytest.mark.parametrize("nearer", [0.0, 0.1, -0.2])
def test_how_far_off_a_flame_stands(nearer):
    wall, flame = sheet(6.0, 5.0, 0.99), sheet(4 * (1 - nearer), 1.0 * (1 - nearer), 0.99)  # as large in the picture
    where = np.zeros((61, 61), bool)
    where[19:42, 19:42] = True  # within the flame, which is 25 pixels wide, and two more on each side at half its light
    depth = np.full((61, 61), 6.0)
    depth[16:45, 16:45] = 4.0
    moment = HeldOutView(CAMERA, 0.0, where, depth, 1 / depth)
    error, off = scores(ScoredParts(TransientGaussians.concatenate([wall, flame]), flame), moment)
    assert off == pytest.approx(abs(nearer), abs=2e-3)
    assert error < 0.02, "a scale and an offset always fit two distances: why `off` is printed too"


def test_a_wall_alone_is_no_flame():
    wall, nothing = sheet(6.0, 5.0, 0.99), sheet(4.0, 1.0, 0.01)
    where = np.zeros((61, 61), bool)
    where[19:42, 19:42] = True
    moment = HeldOutView(CAMERA, 0.0, where, np.full((61, 61), 4.0), np.full((61, 61), 1 / 4))
    assert scores(ScoredParts(wall, wall), moment)[1] == pytest.approx(0.5, abs=2e-3)
    assert np.isnan(scores(ScoredParts(wall, nothing), moment)[1]), "what is hardly there stands nowhere"
    assert np.isnan(
        scores(ScoredParts(wall, wall), HeldOutView(CAMERA, 0.0, where & False, moment.depth, moment.disparity))
    ).all()


def test_what_is_missing_is_named(tmp_path):
    with pytest.raises(Exception, match="gof_0.*is missing; make it with"):
        what_is_drawn(tmp_path)
