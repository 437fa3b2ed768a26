"""The learned correction of the fused flow: its symmetries, its bad points, its file.

What it gains on simulated flames: benchmark/training/flow_prior.py.
"""

from dataclasses import replace

import numpy as np
import pytest

from gof.errors import DataFormatError
from gof.reconstruct.flow_field import FlowField, FrameField
from gof.reconstruct.flow_prior import FEATURES, FlowPrior, describe
from gof.reconstruct.voxels import FlameVoxels


def field_of(voxels, velocity, emission) -> FlowField:
    """Frames of velocity (F, V, 3) and emission (F, V), without pictures."""
    known = np.ones(len(voxels.center), bool)
    frames = [FrameField(0.01 * f, emission[f], velocity[f], known, np.empty(0)) for f in range(len(velocity))]
    return FlowField(voxels, tuple(frames))


def plume(size: float = 1.0) -> FlowField:
    """A leaning, swirling, accelerating plume on 12 x 12 x 30 voxels, three frames; lengths times `size`."""
    resolution = np.array([12, 12, 30])
    index = np.stack(np.meshgrid(*map(np.arange, resolution), indexing="ij"), -1).reshape(-1, 3)
    voxel = 0.05 * size
    center = (index + 0.5 - [6, 6, 0]) * voxel
    voxels = FlameVoxels(center, voxel, index, resolution, np.empty(0), np.empty(0))
    x, y, z = center.T / size
    emission = [np.exp(-((x - 0.1 * z - 0.02 * f) ** 2 + y**2) / 0.02 - (z - 0.5) ** 2 / 0.2) for f in range(3)]
    velocity = np.stack([-y - 0.1 * x, x - 0.1 * y, 0.5 + z], -1) * size
    return field_of(voxels, [velocity * (1 + 0.1 * f) for f in range(3)], emission)


def changed(field: FlowField, **by) -> FlowField:
    """The field with functions applied to values of its frames and, by "voxels", to its voxels."""
    voxels = by.pop("voxels", lambda same: same)(field.voxels)
    frames = [replace(frame, **{name: f(getattr(frame, name)) for name, f in by.items()}) for frame in field.frames]
    return FlowField(voxels, tuple(frames))


def quarter_turn(v: np.ndarray) -> np.ndarray:
    return np.stack([-v[..., 1], v[..., 0], v[..., 2]], -1)


@pytest.fixture(scope="module")
def prior() -> FlowPrior:
    return FlowPrior.load()


@pytest.mark.parametrize("size", [1e-3, 1e3])
def test_unit_of_length_does_not_matter(prior, size):
    expected = prior.correct(plume()).velocity
    np.testing.assert_allclose(prior.correct(plume(size)).velocity / size, expected, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("pace", [1e-3, 1e3])
def test_unit_of_time_does_not_matter(prior, pace):
    expected = prior.correct(plume()).velocity
    paced = changed(plume(), velocity=lambda v: v * pace)
    np.testing.assert_allclose(prior.correct(paced).velocity / pace, expected, rtol=1e-3, atol=1e-4)


def test_brightness_does_not_matter(prior):
    expected = prior.correct(plume()).velocity
    bright = changed(plume(), emission=lambda e: e * 1e4)
    np.testing.assert_allclose(prior.correct(bright).velocity, expected, rtol=1e-3, atol=1e-4)


def test_turned_flame_gives_turned_velocity(prior):
    def turned(voxels):
        side, (x, y, z) = voxels.resolution[0], voxels.index.T
        return replace(voxels, center=quarter_turn(voxels.center), index=np.stack([side - 1 - y, x, z], -1))

    expected = quarter_turn(prior.correct(plume()).velocity)
    result = prior.correct(changed(plume(), voxels=turned, velocity=quarter_turn))
    np.testing.assert_allclose(result.velocity, expected, rtol=1e-3, atol=1e-4)


def test_swirl_keeps_its_sense(prior):
    """A mirrored flame gives the mirrored velocity: nothing in the correction prefers left or right."""
    flip = np.array([-1, 1, 1])

    def mirrored(voxels):
        side, (x, y, z) = voxels.resolution[0], voxels.index.T
        return replace(voxels, center=voxels.center * flip, index=np.stack([side - 1 - x, y, z], -1))

    expected = prior.correct(plume()).velocity * flip
    result = prior.correct(changed(plume(), voxels=mirrored, velocity=lambda v: v * flip))
    np.testing.assert_allclose(result.velocity, expected, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("vector", range(5))
def test_the_network_weighs_five_vectors(vector):
    """A network that always gives one coefficient of 2, and 0 for the others, gives twice that vector."""
    bias = np.zeros((1, 1, 5), np.float32)
    bias[..., vector] = 2
    count = len(FEATURES)
    prior = FlowPrior(np.zeros(count), np.ones(count), [(np.zeros((1, count, 5), np.float32), bias)])
    voxels = plume().voxels
    x, y, z = voxels.center.T
    drift = np.array([0, 0.02, 0.04])  # of the axis, m, frame by frame
    emission = [np.exp(-((x - 0.1 * z - d) ** 2 + y**2) / 0.005) for d in drift]  # leans 0.1 m to +x per metre
    field = field_of(voxels, [np.stack([0.3 + 0 * z, 0 * z, 0.5 + z], -1)] * 3, emission)
    corrected = prior.correct(field).velocity

    energy = sum((e[:, None] * v**2).sum() for e, v in zip(field.emission, field.velocity, strict=True))
    speed = np.sqrt(energy / field.emission.sum())
    middle = (z > 0.4) & (z < 1.1)  # where smoothing over layers does not meet the ends of the box
    if vector == 0:  # up
        np.testing.assert_allclose(corrected, np.broadcast_to([0, 0, 2 * speed], corrected.shape), rtol=1e-5)
    elif vector == 2:  # what is seen sideways
        np.testing.assert_allclose(corrected, np.broadcast_to([0.6, 0, 0], corrected.shape), atol=1e-6)
    elif vector == 3:  # along the lean of the axis, at the mean speed upwards of the layer
        np.testing.assert_allclose(corrected[1][middle, 0], 2 * 0.1 * (0.5 + z[middle]), rtol=0.1)
        assert np.abs(corrected[1][middle, 1:]).max() < 1e-3
    else:  # outward from the axis of the clip (vector 1), of the frame (4)
        for f in range(3):
            axis = 0.1 * z + (drift.mean() if vector == 1 else drift[f])
            offset = np.stack([x - axis, y], -1)
            far = middle & (np.linalg.norm(offset, axis=1) > 0.1)
            outward = offset[far] / np.linalg.norm(offset[far], axis=1, keepdims=True)
            np.testing.assert_allclose(corrected[f][far, :2], 2 * speed * outward, atol=0.1 * speed)
        assert not corrected[..., 2].any()


def test_the_shipped_network_takes_back_the_lag_of_texture(prior):
    """Fused flow of flames rises at 0.4 to 0.6 of the gas' speed (docs/reconstruction.md)."""
    seen = plume()
    gas = prior.correct(seen)
    rise = [(field.emission * field.velocity[..., 2]).sum() / field.emission.sum() for field in (seen, gas)]
    assert 1 / 0.6 < rise[1] / rise[0] < 1 / 0.4


def test_nothing_moves_or_shines(prior):
    still = changed(plume(), velocity=lambda v: v * 0)
    assert not prior.correct(still).velocity.any()
    assert not prior.correct(changed(plume(), emission=lambda e: e * 0)).velocity.any()
    assert describe(still) is None


def test_the_field_that_was_seen_stays_as_it_is(prior):
    seen = plume()
    before = seen.velocity
    corrected = prior.correct(seen)
    np.testing.assert_array_equal(seen.velocity, before)
    np.testing.assert_array_equal(corrected.emission, seen.emission)


def test_dark_frame_and_single_voxel_are_finite(prior):
    field = plume()
    emission = field.emission
    emission[1] = 0
    assert np.isfinite(prior.correct(field_of(field.voxels, field.velocity, emission)).velocity).all()
    one = FlameVoxels(np.zeros((1, 3)), 0.1, np.zeros((1, 3), int), np.ones(3, int), np.empty(0), np.empty(0))
    assert np.isfinite(prior.correct(field_of(one, np.ones((2, 1, 3)), np.ones((2, 1)))).velocity).all()


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
