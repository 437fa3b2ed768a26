"""The learned correction of the fused flow: its symmetries, its bad points, its file. What it gains: benchmark/training/flow_prior.py."""

from dataclasses import replace

import numpy as np
import pytest

from gof.errors import DataFormatError
from gof.reconstruct.flow_prior import FEATURES, FlowPrior, describe
from gof.reconstruct.voxels import FlameVoxels


def plume(size: float = 1.0) -> tuple[FlameVoxels, np.ndarray, np.ndarray]:
    """A leaning, swirling, accelerating plume on 12 x 12 x 30 voxels, three frames; lengths times `size`."""
    resolution = np.array([12, 12, 30])
    index = np.stack(np.meshgrid(*map(np.arange, resolution), indexing="ij"), -1).reshape(-1, 3)
    voxel = 0.05 * size
    center = (index + 0.5 - [6, 6, 0]) * voxel
    voxels = FlameVoxels(center, voxel, index, resolution, np.empty(0), np.empty(0))
    x, y, z = center.T / size
    emission = [np.exp(-((x - 0.1 * z - 0.02 * f) ** 2 + y**2) / 0.02 - (z - 0.5) ** 2 / 0.2) for f in range(3)]
    velocity = np.stack([-y - 0.1 * x, x - 0.1 * y, 0.5 + z], -1) * size
    return voxels, np.stack([velocity * (1 + 0.1 * f) for f in range(3)]), np.stack(emission)


def quarter_turn(v: np.ndarray) -> np.ndarray:
    return np.stack([-v[..., 1], v[..., 0], v[..., 2]], -1)


@pytest.fixture(scope="module")
def prior() -> FlowPrior:
    return FlowPrior.load()


@pytest.mark.parametrize("size", [1e-3, 1e3])
def test_unit_of_length_does_not_matter(prior, size):
    expected = prior.correct(*plume())
    np.testing.assert_allclose(prior.correct(*plume(size)) / size, expected, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("pace", [1e-3, 1e3])
def test_unit_of_time_does_not_matter(prior, pace):
    voxels, velocity, emission = plume()
    expected = prior.correct(voxels, velocity, emission)
    np.testing.assert_allclose(prior.correct(voxels, velocity * pace, emission) / pace, expected, rtol=1e-3, atol=1e-4)


def test_brightness_does_not_matter(prior):
    voxels, velocity, emission = plume()
    expected = prior.correct(voxels, velocity, emission)
    np.testing.assert_allclose(prior.correct(voxels, velocity, emission * 1e4), expected, rtol=1e-3, atol=1e-4)


def test_turned_flame_gives_turned_velocity(prior):
    voxels, velocity, emission = plume()
    n = voxels.resolution[0]
    turned = replace(
        voxels,
        center=quarter_turn(voxels.center),
        index=np.stack([n - 1 - voxels.index[:, 1], voxels.index[:, 0], voxels.index[:, 2]], -1),
    )
    expected = quarter_turn(prior.correct(voxels, velocity, emission))
    np.testing.assert_allclose(prior.correct(turned, quarter_turn(velocity), emission), expected, rtol=1e-3, atol=1e-4)


def test_swirl_keeps_its_sense(prior):
    """A mirrored flame gives the mirrored velocity: nothing in the correction prefers left or right."""
    voxels, velocity, emission = plume()
    n, flip = voxels.resolution[0], np.array([-1, 1, 1])
    mirrored = replace(
        voxels,
        center=voxels.center * flip,
        index=np.stack([n - 1 - voxels.index[:, 0], voxels.index[:, 1], voxels.index[:, 2]], -1),
    )
    expected = prior.correct(voxels, velocity, emission) * flip
    np.testing.assert_allclose(prior.correct(mirrored, velocity * flip, emission), expected, rtol=1e-3, atol=1e-4)


def test_seen_flow_comes_out_faster(prior):
    """The reason it exists: texture lags behind the gas in every flame it was trained on."""
    voxels, velocity, emission = plume()
    corrected = prior.correct(voxels, velocity, emission)
    up = [(emission * v[..., 2]).sum() / emission.sum() for v in (velocity, corrected)]
    assert 1.0 < up[1] / up[0] < 4.0


def test_nothing_moves_or_shines(prior):
    voxels, velocity, emission = plume()
    assert not prior.correct(voxels, velocity * 0, emission).any()
    assert not prior.correct(voxels, velocity, emission * 0).any()
    assert describe(voxels, velocity * 0, emission) is None


def test_dark_frame_and_single_voxel_are_finite(prior):
    voxels, velocity, emission = plume()
    emission[1] = 0
    assert np.isfinite(prior.correct(voxels, velocity, emission)).all()
    one = FlameVoxels(np.zeros((1, 3)), 0.1, np.zeros((1, 3), int), np.ones(3, int), np.empty(0), np.empty(0))
    assert np.isfinite(prior.correct(one, np.ones((2, 1, 3)), np.ones((2, 1)))).all()


def test_weights_survive_the_file(prior, tmp_path):
    prior.save(tmp_path / "w.npz")
    x = np.random.default_rng(0).normal(size=(5, len(FEATURES)))
    np.testing.assert_array_equal(FlowPrior.load(tmp_path / "w.npz").coefficients(x), prior.coefficients(x))


def test_bad_weights_are_named(tmp_path):
    path = tmp_path / "w.npz"
    with pytest.raises(DataFormatError, match=r"w\.npz"):
        FlowPrior.load(path)
    path.write_bytes(b"not a zip")
    with pytest.raises(DataFormatError, match=r"w\.npz"):
        FlowPrior.load(path)
    np.savez(path, mean=np.zeros(3))
    with pytest.raises(DataFormatError, match="is missing"):
        FlowPrior.load(path)
    np.savez(path, features=["a"], layers=0, mean=np.zeros(1), deviation=np.ones(1))
    with pytest.raises(DataFormatError, match="other features"):
        FlowPrior.load(path)
