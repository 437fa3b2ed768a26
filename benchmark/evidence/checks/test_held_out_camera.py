"""The trivial baseline of a camera that is left out, where the answer is known: light in the flame's middle."""

import numpy as np
import pytest

from gof.dataset import Dataset
from gof_benchmark.evidence.held_out_camera import angle_deg, draw_upright_picture, hold_out
from tests.conftest import arc, write_dataset

MIDDLE = np.array([0.1, -0.05, 1.1])


@pytest.fixture(scope="module")
def spot(tmp_path_factory):
    """Two cameras see a round spot of light, which stands at MIDDLE; plates are grey."""
    cameras = arc(9, width=64, height=96)[3:5]
    rows, columns = np.mgrid[:96, :64] + 0.5
    pictures = []
    for camera in cameras:
        (x, y), *_ = camera.project(MIDDLE[None])[0]
        pictures.append(0.2 + 0.5 * np.exp(-((columns - x) ** 2 + (rows - y) ** 2) / 18)[..., None] * np.ones(3))
    frames = np.stack([np.stack(pictures)] * 3)
    folder = tmp_path_factory.mktemp("spot") / "data"
    plates = np.full((2, 96, 64, 3), 0.2)
    return Dataset.open(write_dataset(folder, cameras, frames, plates, 0.01 * np.arange(3), test_frames=(1,)))


def test_what_stands_in_the_middle_is_drawn_where_it_is(spot):
    given = hold_out(spot, 1)
    seen = given.evaluation_view()
    assert [camera.name for camera in given.cameras] == [spot.cameras[0].name]
    assert [camera.name for camera in seen.cameras] == [spot.cameras[1].name]
    drawn, truth = draw_upright_picture(given, 0, seen, MIDDLE)(0, 1), seen.image(0, 1)
    assert abs(truth - seen.static(0)).max() > 0.4, "otherwise nothing is tested"
    assert abs(drawn - truth).max() < 0.06, "round from both sides, but for the slant of the plane"
    away = draw_upright_picture(given, 0, seen, MIDDLE + [0.0, 1.0, 0.0])(0, 1)
    assert abs(away - truth).max() > 0.2


def test_the_angle_is_that_of_the_rig(spot):
    """Nine cameras on an arc of 70 degrees."""
    assert angle_deg(*spot.cameras, np.array([0.0, 0.0, 1.0])) == pytest.approx(70 / 8)
