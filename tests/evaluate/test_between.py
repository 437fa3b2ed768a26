"""The two frames around a held-out one, carried along their flow: right where a picture moves as a whole."""

import cv2
import numpy as np
import pytest

from gof.dataset import Dataset
from gof.evaluate import psnr
from gof.evaluate.between import between_neighbours
from gof.reconstruct.optical_flow import dis
from tests.conftest import arc, write_dataset


@pytest.fixture(scope="module")
def sliding(tmp_path_factory):
    """A pattern that slides by 3 px a frame."""
    noise = np.random.default_rng(0).normal(size=(96, 120, 1))
    pattern = np.clip(0.6 + 0.8 * cv2.GaussianBlur(noise, (0, 0), 2.0), 0, 1)[..., None] * [1.0, 0.6, 0.2]
    frames = np.stack([np.stack([pattern[:, 3 * t : 3 * t + 48]] * 2) for t in range(9)])
    folder = tmp_path_factory.mktemp("sliding") / "data"
    cameras = arc(2, width=48, height=96)
    return write_dataset(folder, cameras, frames, np.full((2, 96, 48, 3), 0.02), 0.01 * np.arange(9), test_frames=(4,))


def test_what_slides_is_drawn_where_it_is(sliding):
    dataset = Dataset.open(sliding)
    drawn, truth = between_neighbours(dataset, 0, 4, dis), dataset.image(0, 4)
    mean = (dataset.image(0, 3) + dataset.image(0, 5)) / 2
    inside = np.s_[:, 8:-8]  # what comes in at a side was not seen before
    assert psnr(drawn[inside], truth[inside]) > psnr(mean[inside], truth[inside]) + 6
    assert between_neighbours(dataset, 0, 0, dis) is None and between_neighbours(dataset, 0, 8, dis) is None


def test_at_the_edge_the_picture_goes_on():
    """One colour that moves is that colour."""

    class Even:
        times_s = np.arange(3.0)

        def image(self, camera, frame):
            return np.full((20, 30, 3), 0.8, np.float32)

    moving = iter([4.0, -4.0])
    drawn = between_neighbours(
        Even(), 0, 1, lambda *_: np.float32([next(moving), 0]) * np.ones((20, 30, 1), np.float32)
    )
    np.testing.assert_allclose(drawn, 0.8, atol=1e-6)
