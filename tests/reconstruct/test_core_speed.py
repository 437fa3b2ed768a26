"""The flame's own axis, and the speed of its core, on light whose way and speed are known in closed form."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d

from gof.reconstruct.core_speed import core_speed, fast_changes, pairs, smoothest_path
from gof.reconstruct.flame_axis import FlameAxis
from tests.reconstruct.plumes import box_of_voxels, changed, field_of, plume

VOXEL, LAYERS = 0.02, 60


def column(axis_direction=(0.0, 0.0, 1.0), speed=2.0, radius=0.09) -> FlameAxis:
    """The axis of an evenly shining column along z within `radius`, of which `speed` is seen."""
    voxels = box_of_voxels((12, 12, LAYERS), VOXEL)
    emission = (np.hypot(*voxels.center[:, :2].T) < radius) * 1.0
    velocity = np.tile(speed * np.array(axis_direction), (len(emission), 1))
    return FlameAxis.of(field_of(voxels, [velocity] * 2, [emission] * 2))


def bulges(travel_s: np.ndarray, seed: int = 0) -> np.ndarray:
    """How bright a stream of bulges and gaps is that left the burner at those times (s), around 1."""
    rng = np.random.default_rng(seed)
    births = rng.uniform(-1.5, 1.0, 100)
    heights = rng.uniform(-0.3, 0.3, len(births))
    return 1 + (heights * np.exp(-0.5 * ((travel_s[..., None] - births) / 0.012) ** 2)).sum(-1)


def with_bulges(axis: FlameAxis, time_s: np.ndarray, speed_at) -> tuple[FlameAxis, np.ndarray]:
    """The axis with light of bulges that travel at `speed_at(m along it)`, over a standing profile that drifts."""
    along = (np.arange(axis.layers.count) + 0.5) * axis.layers.thickness
    speed = speed_at(along)
    needs_s = np.cumsum(axis.layers.thickness / speed)
    standing = np.exp(-(((along - 0.6) / 0.4) ** 2)) + 0.05
    drift = 1 + 0.5 * np.sin(2 * np.pi * 1.5 * time_s)[:, None]
    light = standing * drift * bulges(time_s[:, None] - needs_s)
    return replace(axis, light=light, mean_light=light.mean(0)), speed


@pytest.mark.parametrize("rate_hz", [50, 100, 400])
@pytest.mark.parametrize("speed", [1.5, 3.0, 6.0])
def test_the_speed_of_bulges(rate_hz, speed):
    time_s = np.arange(int(0.6 * rate_hz)) / rate_hz
    axis, truth = with_bulges(column(speed=speed / 2.5), time_s, lambda z: np.full_like(z, speed))
    found = core_speed(axis, time_s)
    inner = slice(8, -8)
    np.testing.assert_allclose(found.speed[inner], truth[inner], rtol=0.12)
    assert np.median(found.agreement[inner]) > 0.6


def test_flicker_of_everything_at_once_travels_nowhere():
    """A camera's exposure, or a flame that swells: by a third, over a hundredth of a second."""
    time_s = np.arange(60) / 100
    axis, truth = with_bulges(column(speed=1.2), time_s, lambda z: np.full_like(z, 3.0))
    noise = gaussian_filter1d(np.random.default_rng(5).normal(size=60), 1.2)
    flicker = np.exp(0.35 * noise / noise.std())[:, None]
    flickering = replace(axis, light=axis.light * flicker, mean_light=(axis.light * flicker).mean(0))
    found = core_speed(flickering, time_s)
    np.testing.assert_allclose(found.speed[8:-8], truth[8:-8], rtol=0.12)
    assert found.agreement[8:-8].min() > 0.9, "it was 0.3 when the flicker was left in"


def test_a_core_that_accelerates():
    time_s = np.arange(50) / 100
    axis, truth = with_bulges(column(speed=1.2), time_s, lambda z: 4 * np.sqrt(z + 0.1))
    found = core_speed(axis, time_s)
    np.testing.assert_allclose(found.speed[8:-8], truth[8:-8], rtol=0.2)


def test_missing_frames_are_stepped_over():
    time_s = np.delete(np.arange(50) / 100, [4, 12, 20, 28, 36, 44])
    axis, truth = with_bulges(column(speed=1.2), time_s, lambda z: np.full_like(z, 3.0))
    np.testing.assert_allclose(core_speed(axis, time_s).speed[8:-8], truth[8:-8], rtol=0.12)


def test_pairs_of_frames():
    found = pairs(np.array([0, 1, 2, 4]) / 100, longest_s=0.042)
    found = [list(zip(first.tolist(), second.tolist(), strict=True)) for first, second in found]
    assert found == [[(0, 1), (1, 2)], [(0, 2), (2, 3)], [(1, 3)], [(0, 3)]], "10, 20, 30 and 40 ms apart"
    assert pairs(np.array([0.0]), longest_s=1.0) == []


@pytest.mark.parametrize("factor", [1e-3, 1e3])
def test_units_do_not_matter(factor):
    time_s = np.arange(40) / 100
    axis, _ = with_bulges(column(speed=1.2), time_s, lambda z: np.full_like(z, 3.0))
    expected = core_speed(axis, time_s).speed
    layers = replace(axis.layers, thickness=axis.layers.thickness * factor)
    large = replace(axis, layers=layers, radius=axis.radius * factor, seen_speed=axis.seen_speed * factor)
    np.testing.assert_allclose(core_speed(large, time_s).speed / factor, expected, rtol=1e-6)
    slow = replace(axis, seen_speed=axis.seen_speed / factor)
    np.testing.assert_allclose(core_speed(slow, time_s * factor).speed * factor, expected, rtol=1e-6)
    bright = replace(axis, light=axis.light * factor, mean_light=axis.mean_light * factor)
    np.testing.assert_allclose(core_speed(bright, time_s).speed, expected, rtol=1e-6)


def test_light_that_says_nothing():
    axis = column(speed=1.5)
    for frames in (1, 2, 20):
        light = np.tile(axis.mean_light, (frames, 1))
        found = core_speed(replace(axis, light=light), np.arange(frames) / 100)
        np.testing.assert_allclose(found.speed, 3.0, rtol=0.05, err_msg="twice the seen speed")
        np.testing.assert_allclose(found.agreement, 0, atol=1e-9)
    dark = replace(axis, light=np.where(np.arange(axis.layers.count) < 20, 0, axis.light))
    found = core_speed(dark, np.arange(len(dark.light)) / 100)
    assert np.isfinite(found.speed).all() and np.isfinite(found.agreement).all()


def test_what_changes_slowly_is_taken_out():
    time_s = np.arange(100) / 100
    slow = np.exp(0.5 * np.sin(2 * np.pi * 0.5 * time_s))[:, None] * np.ones(10)
    fast = np.exp(0.5 * np.sin(2 * np.pi * 12 * time_s))[:, None] * np.ones(10)
    inner = slice(20, 80)  # where the running mean has its whole window
    assert np.abs(fast_changes(slow, time_s, 0.06)[inner]).max() < 0.03
    assert fast_changes(fast, time_s, 0.06)[inner].std() == pytest.approx(0.5 / np.sqrt(2), rel=0.1)


def test_the_smoothest_path_is_the_best_of_all():
    """Against every path there is, on a problem small enough to try them."""
    rng = np.random.default_rng(3)
    gain, log_speed = rng.normal(size=(5, 4)), np.log([1.0, 2.0, 3.0, 5.0])

    def worth(path):
        jumps = np.diff(log_speed[list(path)]) ** 2
        return sum(gain[i, k] - 1e-3 * (log_speed[k] - np.log(2)) ** 2 for i, k in enumerate(path)) - jumps.sum()

    every = np.stack(np.meshgrid(*[range(4)] * 5, indexing="ij"), -1).reshape(-1, 5)
    best = max(every, key=worth)
    np.testing.assert_array_equal(smoothest_path(gain, log_speed), best)


# ---- the axis --------------------------------------------------------------------------------------------------------


def test_the_axis_of_a_column():
    axis = column(speed=1.5, radius=0.09)
    np.testing.assert_allclose(axis.layers.direction, [0, 0, 1], atol=1e-12)
    assert axis.seen_speed == pytest.approx(1.5)
    assert axis.length == pytest.approx((0.95 - 0.02) * LAYERS * VOXEL, rel=0.03)
    assert axis.radius == pytest.approx(0.09 / np.sqrt(2), rel=0.05)
    np.testing.assert_allclose(axis.sections.middle[5:-5, :2], 0, atol=1e-9)
    lit = np.pi * 0.09**2 / VOXEL**2 * LAYERS
    np.testing.assert_allclose(axis.light.sum(1), lit, rtol=0.1, err_msg="no light is lost between layers")


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
