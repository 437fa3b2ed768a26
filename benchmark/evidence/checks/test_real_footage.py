"""Trivial baselines of real clips: the trivial baselines know the answer where a picture moves as a whole."""

import cv2
import numpy as np
import pytest

from gof.dataset import Dataset
from gof_benchmark.evidence.real_clips import believing, carried_along_flow, figures, mean_of_neighbours
from tests.conftest import arc, write_dataset
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
