"""Plates beside a result: round trip, other sizes, damage."""

import cv2
import numpy as np
import pytest

from gof.core.errors import DataFormatError
from gof.dataset import Dataset
from gof.dataset.plates import background, save_plates


@pytest.fixture
def dataset(tiny_dataset) -> Dataset:
    return Dataset.open(tiny_dataset)


def test_plates_come_back_finer_than_8_bits(dataset, tmp_path):
    plates = [np.random.default_rng(0).random(dataset.static(c).shape) for c in range(2)]
    save_plates(tmp_path, [camera.name for camera in dataset.cameras], plates)
    for c in range(2):
        for result in (tmp_path, tmp_path / "result.npz"):
            assert np.abs(background(dataset, c, result) - plates[c]).max() < 1 / 65000


def test_without_plates_the_datasets_own(dataset, tmp_path):
    assert (background(dataset, 1, tmp_path / "result.npz") == dataset.static(1)).all()
    assert (background(dataset, 1, None) == dataset.static(1)).all()


def test_small_plates_add_their_light_and_leave_the_picture_sharp(dataset, tmp_path):
    """Static pictures are noise: enlarging a small one would be far off, adding its smooth light is exact."""
    names = [camera.name for camera in dataset.cameras]
    static = dataset.static(0)
    half = cv2.resize(static, (static.shape[1] // 2, static.shape[0] // 2), interpolation=cv2.INTER_AREA)
    save_plates(tmp_path, names, [half * 0.75 + 0.1] * 2)
    truth = np.clip(static - 0.25 * cv2.resize(half, static.shape[1::-1], interpolation=cv2.INTER_LINEAR) + 0.1, 0, 1)
    assert np.abs(background(dataset, 0, tmp_path) - truth).max() < 1e-4


@pytest.mark.parametrize("shrunk", [1, 2])
def test_what_stands_before_the_flame_comes_back(dataset, tmp_path, shrunk):
    names = [camera.name for camera in dataset.cameras]
    plate = cv2.resize(dataset.static(0), None, fx=1 / shrunk, fy=1 / shrunk, interpolation=cv2.INTER_AREA)
    before = np.zeros((*plate.shape[:2], 1))
    before[: len(before) // 2] = 1
    save_plates(tmp_path, names, [np.concatenate([plate, before], -1), plate])
    found = background(dataset, 0, tmp_path)
    assert found.shape == (*dataset.static(0).shape[:2], 4) and background(dataset, 1, tmp_path).shape[-1] == 3
    half = len(found) // 2
    assert (found[: half - 1, :, 3] == 1).all() and (found[half + 1 :, :, 3] == 0).all()
    assert np.abs(found[..., :3] - dataset.static(0)).max() < 1e-3


def test_a_damaged_plate_is_named(dataset, tmp_path):
    save_plates(tmp_path, [camera.name for camera in dataset.cameras], [dataset.static(0), dataset.static(1)])
    path = tmp_path / "plates" / f"{dataset.cameras[0].name}.png"
    path.write_bytes(path.read_bytes()[:40])
    with pytest.raises(DataFormatError, match=path.name):
        background(dataset, 0, tmp_path)
    cv2.imwrite(str(path), np.zeros((8, 8, 3), np.uint8))
    with pytest.raises(DataFormatError, match="16-bit"):
        background(dataset, 0, tmp_path)
