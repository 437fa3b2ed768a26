"""The trivial baselines of a flow field, on plumes whose motion is known in closed form."""

from dataclasses import replace

import numpy as np
import pytest

from gof.core.fields import VelocityField
from gof_benchmark.evidence.calibration import reliability
from gof_benchmark.training.field_score import (
    best_constant,
    buoyant_law,
    fluctuation_cos_sim,
    mean_per_height,
    score,
    within,
)
from tests.reconstruct.plumes import box_of_voxels, field_of


class Truth:
    """A dataset's velocity: the same field at all times."""

    def __init__(self, field: VelocityField):
        self.velocity, self._field = self, field

    def at(self, time_s: float) -> VelocityField:
        return self._field


@pytest.fixture(scope="module")
def column():
    """An even column of 0.1 m radius and 1.2 m height, two frames, seen to rise at 1 m/s; the gas rises at 1 + z."""
    voxels = box_of_voxels((16, 16, 40), 0.03)
    x, y, z = voxels.center.T
    emission = (np.hypot(x, y) < 0.1) * 1.0
    seen = np.tile([0.0, 0.0, 1.0], (len(z), 1))
    field = field_of(voxels, [seen] * 2, [emission] * 2)
    height = (np.arange(60) - 10 + 0.5) * 0.03
    velocity = np.zeros((24, 24, 60, 3))
    velocity[..., 2] = 1 + height
    return field, Truth(VelocityField.from_array(velocity, (-0.36, -0.36, -0.3), 0.03))


@pytest.fixture(scope="module")
def shear(column):
    """The same column, whose gas rises at 1 + z + 4 x."""
    field, truth = column
    x = (np.arange(24) + 0.5) * 0.03 - 0.36
    velocity = truth.at(0.0).velocity.copy()
    velocity[..., 2] += 4 * x[:, None, None]
    return field, Truth(VelocityField.from_array(velocity, (-0.36, -0.36, -0.3), 0.03))


@pytest.mark.parametrize(("slope", "expected"), [(1.0, 1.0), (0.1, 1.0), (-2.0, -1.0), (0.0, 0.0)])
def test_fluctuation_is_what_the_mean_of_every_height_leaves(shear, slope, expected):
    """Whatever the means are: here 7 m/s everywhere."""
    field, truth = shear
    velocity = np.zeros((len(field.voxels.center), 3))
    velocity[:, 2] = 7 + slope * field.voxels.center[:, 0]
    sheared = replace(field, frames=tuple(replace(frame, velocity=velocity) for frame in field.frames))
    assert fluctuation_cos_sim(sheared, truth) == pytest.approx(expected, abs=0.01)
    assert fluctuation_cos_sim(mean_per_height(field, truth), truth) == pytest.approx(0, abs=0.01)


def test_the_mean_of_every_height_is_right_where_height_is_all(column):
    field, truth = column
    found = score(mean_per_height(field, truth), truth)
    assert found.l2 < 1e-3
    assert found.cos_sim == pytest.approx(1)


def test_the_best_constant_misses_the_spread(column):
    """For speeds 1 + z, z even in 0 to 1.2, L2 is standard deviation over RMS."""
    field, truth = column
    z = np.linspace(0, 1.2, 10_001)
    assert score(best_constant(field, truth), truth).l2 == pytest.approx(
        (1 + z).std() / np.sqrt(((1 + z) ** 2).mean()), rel=0.02
    )


def test_the_buoyant_law_is_mccaffreys_on_the_axis(column):
    """6.83 sqrt(z) with z in m; the foot is where 2 % of the light are."""
    field, _ = column
    velocity = buoyant_law(field).velocity[0]
    x, y, z = field.voxels.center.T
    axis = (np.hypot(x, y) < 0.03) & (z > 0.2)
    np.testing.assert_allclose(velocity[axis, 2], 6.83 * np.sqrt(z[axis] - 0.02 * 1.2), rtol=0.04)
    far = np.hypot(x, y) > 0.2
    assert velocity[far, 2].max() < 0.7 * velocity[axis, 2].max(), "it fades outward"


@pytest.mark.parametrize(("deviations", "expected"), [(1, 0.683), (2, 0.954)])
def test_normal_errors_are_within_their_deviation_as_often_as_they_should(column, deviations, expected):
    field, truth = column
    rng = np.random.default_rng(0)
    frames = []
    for frame in field.frames:
        true = truth.at(frame.time_s).sample(field.voxels.center)
        sd = rng.uniform(0.1, 3, len(true))
        frames.append(replace(frame, velocity=true + sd[:, None] * rng.normal(size=true.shape), velocity_sd=sd))
    noisy = replace(field, frames=tuple(frames))
    assert within(noisy, truth, deviations) == pytest.approx(expected, abs=0.02)
    for said, wrong in reliability(noisy, truth):
        assert wrong == pytest.approx(said, rel=0.1)
