"""The learned correction of the fused flow: its symmetries, its bad points, its file.

What it gains on simulated flames: benchmark/training/flow_prior.py.
"""

from dataclasses import replace

import numpy as np
import pytest

from gof.core.errors import DataFormatError
from gof.reconstruct.flame_axis import FlameAxis
from gof.reconstruct.flow_prior import FEATURES, VECTORS, FlameDescriber, FlowPrior, evaluate_network
from gof.reconstruct.mean_speed import MeanSpeed
from tests.reconstruct.plumes import box_of_voxels, changed, field_of, plume


def quarter_turn(v: np.ndarray) -> np.ndarray:
    return np.stack([-v[..., 1], v[..., 0], v[..., 2]], -1)


@pytest.fixture(scope="module")
def prior() -> FlowPrior:
    return FlowPrior.load()


@pytest.mark.parametrize("size", [1e-3, 1e3])
def test_unit_of_length_does_not_matter(prior, size):
    expected = prior.correct(plume(), metres=False).velocity
    np.testing.assert_allclose(prior.correct(plume(size), metres=False).velocity / size, expected, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("pace", [1e-3, 1e3])
def test_unit_of_time_does_not_matter(prior, pace):
    expected = prior.correct(plume(), metres=False).velocity
    paced = changed(plume(), velocity=lambda v: v * pace, time_s=lambda t: t / pace)
    found = prior.correct(paced, metres=False).velocity / pace
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-4)


def test_a_wrong_unit_costs_a_bounded_factor(prior):
    """Millimetres taken for metres: buoyancy says nonsense, and is not believed without bounds."""
    for size in (1e-3, 1e3):
        right, wrong = (mean_speed(prior.correct(plume(size), metres=metres)) for metres in (False, True))
        assert 0.2 < wrong / right < 5


def mean_speed(field):
    return (field.emission * np.linalg.norm(field.velocity, axis=-1)).sum() / field.emission.sum()


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


def test_a_flame_on_its_side_moves_on_its_side(prior):
    """x, y, z become z, x, y, whether the world's up is known or not."""

    def lying(voxels):
        turn = [1, 2, 0]
        return replace(
            voxels, center=voxels.center[:, turn], index=voxels.index[:, turn], resolution=voxels.resolution[turn]
        )

    for metres in (False, True):
        expected = prior.correct(plume(), metres).velocity[..., [1, 2, 0]]
        result = prior.correct(changed(plume(), voxels=lying, velocity=lambda v: v[:, [1, 2, 0]]), metres)
        # Upright its axis leans by 4 degrees, for which buoyancy is 0.1 % faster; lying it counts as upright.
        np.testing.assert_allclose(result.velocity, expected, rtol=2e-3, atol=1e-4)


LINE = np.array([np.log(3.0), 0, 0, 0])  # the gas is three times as fast as what is seen


def giving(vector: int, coefficient: float, uncertainty: float = 0.0) -> FlowPrior:
    """A prior whose networks always give one coefficient, 0 for the others, and one log of the uncertainty."""
    bias = np.zeros((1, 1, VECTORS), np.float32)
    bias[..., vector] = coefficient
    count = len(FEATURES)
    velocity = [(np.zeros((1, count, VECTORS), np.float32), bias)]
    unsure = [(np.zeros((1, count, 1), np.float32), np.full((1, 1, 1), uncertainty, np.float32))]
    return FlowPrior(np.zeros(count), np.ones(count), velocity, unsure, MeanSpeed(LINE, LINE))


@pytest.mark.parametrize("vector", range(VECTORS))
def test_the_network_weighs_five_vectors(vector):
    """A coefficient of 2 gives twice that vector."""
    voxels = box_of_voxels((12, 12, 30), 0.05)
    x, y, z = voxels.center.T
    drift = np.array([0, 0.02, 0.04]) if vector in (1, 4) else np.zeros(3)  # of the axis, m, frame by frame
    emission = [np.exp(-((x - 0.1 * z - d) ** 2 + y**2) / 0.005) for d in drift]  # leans 0.1 m to +x per metre
    swirl = np.stack([-y, x - 0.1 * z - drift.mean(), 2 + 0 * z], -1)  # goes up in the mean
    field = field_of(voxels, [swirl] * 3, emission)
    corrected = giving(vector, 2.0).correct(field).velocity
    energy = sum((e[:, None] * v**2).sum() for e, v in zip(field.emission, field.velocity, strict=True))
    seen_speed = np.sqrt(energy / field.emission.sum())
    pace = 3 * seen_speed
    up = FlameDescriber.of(field).axis.layers.direction
    np.testing.assert_allclose(up, [0, 0, 1], atol=0.02)
    middle = (z > 0.4) & (z < 1.1)  # where smoothing over layers does not meet the ends of the box
    if vector == 0:  # along the axis
        np.testing.assert_allclose(corrected, np.broadcast_to(2 * pace * up, corrected.shape), rtol=1e-3, atol=1e-3)
    elif vector == 2:  # what is seen across the axis
        across = 2 * 3 * (swirl - (swirl @ up)[:, None] * up)
        np.testing.assert_allclose(corrected, np.broadcast_to(across, corrected.shape), atol=2e-5)
    elif vector == 3:  # along the lean of the axis
        lean = np.array([0.1, 0, 1]) / np.sqrt(1.01)
        expected = 2 * pace * (lean - (lean @ up) * up)
        np.testing.assert_allclose(corrected[1][middle], np.broadcast_to(expected, (middle.sum(), 3)), atol=0.1)
    else:  # outward from the axis of the frame (vector 1), of the clip (4)
        for f in range(3):
            axis = 0.1 * z + (drift.mean() if vector == 4 else drift[f])
            offset = np.stack([x - axis, y], -1)
            far = middle & (np.linalg.norm(offset, axis=1) > 0.1)
            outward = offset[far] / np.linalg.norm(offset[far], axis=1, keepdims=True)
            np.testing.assert_allclose(corrected[f][far, :2], 2 * pace * outward, atol=0.15 * pace)


def test_uncertainty_is_over_the_pace():
    field = plume()
    found = giving(0, 1.0, uncertainty=np.log(0.25)).correct(field)
    for frame in found.frames:
        np.testing.assert_allclose(frame.velocity_sd, 0.25 * 3 * FlameAxis.of(field).seen_speed, rtol=1e-5)
    assert all(np.isinf(frame.velocity_sd).all() for frame in field.frames), "the seen field says nothing of it"


def test_the_shipped_network_takes_back_the_lag_of_texture(prior):
    """Fused flow of flames rises at 0.2 to 0.6 of the gas' speed (docs/how_good.md)."""
    seen = changed(plume(), emission=lambda e: np.ones_like(e) * plume().frames[0].emission)  # light without changes
    gas = prior.correct(seen)
    rise = [(field.emission * field.velocity[..., 2]).sum() / field.emission.sum() for field in (seen, gas)]
    assert 1 / 0.7 < rise[1] / rise[0] < 1 / 0.2


def test_nothing_moves_or_shines(prior):
    still = changed(plume(), velocity=lambda v: v * 0)
    assert not prior.correct(still).velocity.any()
    assert np.isinf(prior.correct(still).frames[0].velocity_sd).all()
    assert not prior.correct(changed(plume(), emission=lambda e: e * 0)).velocity.any()
    assert FlameDescriber.of(still) is None


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
    one = box_of_voxels((1, 1, 1), 0.1)
    assert np.isfinite(prior.correct(field_of(one, np.ones((2, 1, 3)), np.ones((2, 1)))).velocity).all()
    still = field_of(field.voxels, field.velocity[:1], emission[:1])
    assert np.isfinite(prior.correct(still).velocity).all(), "a single frame"


def test_weights_survive_the_file(prior, tmp_path):
    prior.save(tmp_path / "w.npz")
    x = np.random.default_rng(0).normal(size=(5, len(FEATURES)))
    again = FlowPrior.load(tmp_path / "w.npz")
    for name in ("metric", "unitless"):
        np.testing.assert_array_equal(getattr(again.pace, name), getattr(prior.pace, name))
    for name in ("velocity", "uncertainty"):
        network, same = getattr(prior, name), getattr(again, name)
        np.testing.assert_array_equal(evaluate_network(same, x), evaluate_network(network, x))


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
    empty = dict.fromkeys(("velocity_layers", "uncertainty_layers"), 0)
    numbers = dict.fromkeys(("mean", "deviation", "pace_metric", "pace_unitless"), np.zeros(1))
    for features in (["a"], FEATURES):  # those of the voxels, or of the pace
        np.savez(path, features=features, **empty, **numbers)
        with pytest.raises(DataFormatError, match="other features"):
            FlowPrior.load(path)
