"""The flame's own axis, on light whose way and speed are known in closed form."""

import numpy as np
import pytest

from gof.reconstruct.flame_axis import FlameAxis
from tests.reconstruct.plumes import box_of_voxels, changed, field_of, plume

VOXEL, LAYERS = 0.02, 60


def column(axis_direction=(0.0, 0.0, 1.0), speed=2.0, radius=0.09) -> FlameAxis:
    """The axis of an evenly shining column along z within `radius`, of which `speed` is seen."""
    voxels = box_of_voxels((12, 12, LAYERS), VOXEL)
    emission = (np.hypot(*voxels.center[:, :2].T) < radius) * 1.0
    velocity = np.tile(speed * np.array(axis_direction), (len(emission), 1))
    return FlameAxis.of(field_of(voxels, [velocity] * 2, [emission] * 2))


def test_the_axis_of_a_column():
    axis = column(speed=1.5, radius=0.09)
    np.testing.assert_allclose(axis.layers.direction, [0, 0, 1], atol=1e-12)
    assert axis.seen_speed == pytest.approx(1.5)
    assert axis.length == pytest.approx((0.95 - 0.02) * LAYERS * VOXEL, rel=0.03)
    assert axis.radius == pytest.approx(0.09 / np.sqrt(2), rel=0.05)
    np.testing.assert_allclose(axis.sections.middle[5:-5, :2], 0, atol=1e-9)
    lit = np.pi * 0.09**2 / VOXEL**2 * LAYERS
    assert axis.mean_light.sum() == pytest.approx(lit, rel=0.1), "no light is lost between layers"


def test_the_axis_follows_what_is_seen_to_move():
    """A plume that leans: its axis is its mean velocity's, whichever way is up."""
    sideways = changed(plume(), velocity=lambda v: np.tile([3.0, 0.0, 4.0], (len(v), 1)))
    np.testing.assert_allclose(FlameAxis.of(sideways).layers.direction, [0.6, 0, 0.8], atol=1e-12)


def test_no_axis_where_nothing_goes_anywhere():
    assert FlameAxis.of(changed(plume(), velocity=lambda v: v * 0)) is None
    assert FlameAxis.of(changed(plume(), emission=lambda e: e * 0)) is None
    around = np.array([-1.0, 1.0, 0.0])
    swirl = changed(
        plume(), emission=lambda e: np.ones_like(e), velocity=lambda v: v[:, [1, 0, 2]] * around * [1, 1, 0]
    )
    swirl = changed(swirl, velocity=lambda v: v - v.mean(0))
    assert FlameAxis.of(swirl) is None
