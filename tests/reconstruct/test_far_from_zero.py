"""UTM coordinates and Unix time: the same flame, result and scores as around zero."""

import numpy as np
import pytest

from gof.core.datum import Datum
from gof.core.gaussians import TransientGaussians
from gof.dataset import Dataset
from gof.evaluate import evaluate
from tests.moved_dataset import moved_copy
from tests.reconstruct.rising_flame import RISE, mean_velocity, reconstruct, write_flame

FAR = Datum((498_000.0, 5_213_000.0, 431.0), 1_732_300_000.0)
SMALL = {"gaussians": 600, "iterations": 60, "voxels": 24}


@pytest.fixture(scope="module")
def near(tmp_path_factory):
    folder = write_flame(tmp_path_factory.mktemp("near") / "flame", frames=8)
    return folder, reconstruct(folder, folder.parent / "out", **SMALL)


def test_a_flame_far_from_zero_is_the_flame_around_zero(near, tmp_path):
    folder, around_zero = near
    far = moved_copy(folder, tmp_path / "flame", FAR)
    made = reconstruct(far, tmp_path / "out", **SMALL)
    there, here = TransientGaussians.load(made), TransientGaussians.load(around_zero)
    np.testing.assert_allclose(mean_velocity(there), RISE, atol=0.4)
    np.testing.assert_allclose(mean_velocity(there), mean_velocity(here), atol=0.02)
    shift = np.subtract(there.datum.position, FAR.position)
    assert there.datum.time_s == FAR.time_s
    weight = there.opacity[:, None]
    middle = (weight * there.position).sum(0) / weight.sum()
    expected = (here.opacity[:, None] * here.position).sum(0) / here.opacity.sum()
    # Half a voxel: on the very edge of a mask one may fall to either side, and then seeds are other ones.
    np.testing.assert_allclose(middle + shift, expected, atol=0.02)
    for result in (made, made.with_suffix(".ply"), there):
        scores = evaluate(result, Dataset.open(far))
        true = evaluate(around_zero, Dataset.open(folder))
        assert scores.dve.l2 == pytest.approx(true.dve.l2, abs=0.01)
        assert scores.dve.cos_sim == pytest.approx(true.dve.cos_sim, abs=0.01)
        assert scores.psnr_flame == pytest.approx(true.psnr_flame, abs=0.2)
        assert scores.dve.frames[1].time_s == pytest.approx(FAR.time_s + 0.02, abs=1e-6)  # on the file's own clock


def test_without_a_datum_nothing_would_be_left(near, tmp_path):
    """What the datum is for: the same numbers as float32 as they stand."""
    gaussians = TransientGaussians.load(near[1])
    as_they_stand = np.float32(gaussians.position + np.array(FAR.position))
    assert np.abs(as_they_stand - FAR.position - gaussians.position).max() > 0.1
    assert np.unique(np.float32(gaussians.t_mu + np.float64(FAR.time_s))).size < 3
