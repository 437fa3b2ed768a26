"""A dataset that is spoiled on purpose shows the same flame, as far as it should."""

from dataclasses import replace

import numpy as np
import pytest

from gof.core.errors import DataFormatError, GofError
from gof.dataset import Dataset
from gof.footage.videos import read_info
from gof_benchmark.evidence.hard_cases import about_x, behind_a_beam, dim, plate_with_fire, spoiled
from gof_benchmark.evidence.ordinary_footage import tagged_clockwise
from gof_benchmark.evidence.wrong_clocks import believing, mistakes
from tests.conftest import tiny_dataset  # noqa: F401
from tests.evaluate.synthetic_flame import flame_dataset
from tests.videos import numbered, write_video


@pytest.fixture(scope="module")
def flame(tmp_path_factory) -> Dataset:
    folder = tmp_path_factory.mktemp("flame")
    flame_dataset(folder)
    return Dataset.open(folder)


def test_a_turned_world_looks_the_same_and_its_gas_is_turned(flame):
    R = about_x(90)
    np.testing.assert_allclose(R @ [0, 1, 0], [0, 0, 1], atol=1e-12)
    turned = spoiled(flame, turned=R)
    points = np.random.default_rng(0).uniform([-0.1, -0.1, 0.4], [0.1, 0.1, 0.8], (20, 3))
    for before, after in zip(flame.cameras, turned.cameras, strict=True):
        np.testing.assert_allclose(after.project(points @ R.T)[0], before.project(points)[0], atol=1e-6)
    time_s = float(flame.times_s[2])
    truth = flame.velocity.at(time_s).sample(points)
    assert np.abs(truth).max() > 0.1
    np.testing.assert_allclose(turned.velocity.at(time_s).sample(points @ R.T), truth @ R.T, atol=1e-4)


def test_every_second_frame_is_the_same_picture_at_its_own_time(flame):
    half = spoiled(flame, step=2)
    assert half.times_s == pytest.approx(flame.times_s[::2])
    assert not set(half.train_frames) & set(half.test_frames)
    np.testing.assert_array_equal(half.image(1, 2), flame.image(1, 4))


def test_pictures_are_spoiled_in_one_camera_only(flame):
    dark = spoiled(flame, dim(0.25))
    np.testing.assert_array_equal(dark.image(1, 3), flame.image(1, 3))
    assert dark.image(0, 3).max() < 0.7 * flame.image(0, 3).max()  # a quarter of the light is half of display sRGB
    hidden = spoiled(flame, behind_a_beam(flame))
    changed = (hidden.image(0, 3) != flame.image(0, 3)).any(-1)
    assert 0.05 < changed.mean() < 0.15
    lit = (flame.image(0, 3) - flame.static(0)).sum(-1)
    assert lit[changed].sum() > 0.1 * lit.sum()
    np.testing.assert_array_equal(hidden.static(0)[changed], hidden.image(0, 3)[changed])


def test_fire_is_left_in_the_plates_and_not_in_the_pictures(flame):
    bad = spoiled(flame, plate=plate_with_fire(flame))
    np.testing.assert_array_equal(bad.image(0, 1), flame.image(0, 1))
    assert bad.static(0).sum() > flame.static(0).sum()


# ----------------------------------------------------------------
# The rotation tag that is written into phones' videos is the one that players turn by.


def test_the_evidence_scripts_phones_have_the_tag(tmp_path):
    video = write_video(tmp_path / "phone.mp4", numbered(30), 30.0)
    video.write_bytes(tagged_clockwise(video.read_bytes()))
    assert read_info(video).rotation_deg == 90
    with pytest.raises(DataFormatError, match="lies as it is stored"):
        tagged_clockwise(video.read_bytes())


# ----------------------------------------------------------------
# The study of wrong frame times changes what is believed about them, and nothing else.


def test_rounded_and_exaggerated_times(tiny_dataset):  # noqa: F811
    common = Dataset.open(tiny_dataset)
    with pytest.raises(GofError, match="effect 'clock'"):
        mistakes(common)
    first, second = common.description.cameras
    late = replace(second, time_s=tuple(t + 0.013 for t in common.times_s))  # 1.3 frames of 10 ms
    dataset = replace(common, description=replace(common.description, cameras=(first, late)))
    np.testing.assert_allclose(mistakes(dataset), [[0] * 4, [-0.003] * 4], atol=1e-9)
    for error, expected in ((0, 0.013), (1, 0.010), (2, 0.007)):
        wrong = believing(dataset, error)
        np.testing.assert_allclose(wrong.camera_times_s(1), common.times_s + expected, atol=1e-9)
        np.testing.assert_array_equal(wrong.camera_times_s(0), common.times_s)
