"""How fast a flame is as a whole, on flames whose every number is known."""

from dataclasses import replace

import numpy as np
import pytest

from gof.reconstruct.flame_axis import FlameAxis
from gof.reconstruct.flow_field import FlowField
from gof.reconstruct.log_light import LogLight
from gof.reconstruct.mean_speed import FARTHEST, MeanSpeed, SpeedClues, buoyant_speed, carried_speed
from tests.reconstruct.plumes import box_of_voxels, field_of

STEP_S = 0.01  # between the frames of field_of


def column(height_m: float = 1.5, seen: float = 0.5, radius_m: float = 0.05, bands=lambda z, t: 1.0) -> FlowField:
    """An upright round flame from z = 0 to its top that is seen to rise at `seen` m/s, its light times bands(z, t)."""
    voxels = box_of_voxels((12, 12, 60), height_m / 60)
    x, y, z = voxels.center.T
    round_flame = np.exp(-(x**2 + y**2) / (2 * radius_m**2))
    velocity = np.broadcast_to([0, 0, seen], voxels.center.shape)
    return field_of(voxels, [velocity] * 3, [round_flame * bands(z, f * STEP_S) for f in range(3)])


def clues_of(field: FlowField) -> SpeedClues:
    return SpeedClues.of(FlameAxis.of(field), LogLight.of(field))


@pytest.mark.parametrize("height_m", [0.1, 1.5, 20.0])
def test_buoyant_speed_of_a_column(height_m):
    """McCaffrey's 6.83 sqrt(z) m/s, over the part of a column that 30 % of its light are below and 10 % above."""
    expected = 6.83 * np.sqrt(0.6 * height_m)
    found = buoyant_speed(FlameAxis.of(column(height_m, radius_m=height_m / 30)))
    assert found == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize(
    "tilt_deg, faster", [(30, 1.0746), (45, 1.1892), (60, 1.4142), (75, 1.1615), (90, 1), (180, 1)]
)
def test_wind_leaves_the_rise_as_it_is(tilt_deg, faster):
    """Of a column s long, tilted by a: rise sqrt(s cos a), over cos a. Beyond 60 degrees less; lying none."""
    axis = FlameAxis.of(column())
    turned = np.array([np.sin(np.deg2rad(tilt_deg)), 0, np.cos(np.deg2rad(tilt_deg))])
    tilted = replace(axis, layers=replace(axis.layers, direction=turned))
    assert buoyant_speed(tilted) / buoyant_speed(axis) == pytest.approx(faster, abs=2e-3)


def carried(bands) -> float:
    field = column(bands=bands)
    return carried_speed(FlameAxis.of(field), LogLight.of(field))


def test_bands_that_rise_are_carried_at_their_own_speed():
    """Whatever the optical flow said of them (0.5 m/s)."""
    assert carried(lambda z, t: np.exp(np.sin(2 * np.pi * (z - 0.8 * t) / 0.3))) == pytest.approx(0.8, rel=0.1)


def test_bands_that_go_out_and_on_in_place_are_not_carried():
    standing = carried(lambda z, t: np.exp(np.sin(2 * np.pi * z / 0.3) * np.cos(2 * np.pi * t / 0.02)))
    assert abs(standing) < 0.05
    assert abs(carried(lambda z, t: 1 + 50 * t)) < 0.05


def test_nothing_is_carried_in_a_single_frame():
    field = column()
    alone = FlowField(field.voxels, field.frames[:1])
    assert carried_speed(FlameAxis.of(alone), LogLight.of(alone)) == 0


def test_a_line_is_found_again():
    """Flames that obey a line exactly, and one far from them that obeys it too."""
    flames = [
        SpeedClues(seen, seen * law, seen * carried, slenderness, 1.0)
        for seen, law, carried, slenderness in np.random.default_rng(0).uniform(
            [0.1, 2, 0.2, 0.05], [3, 8, 1, 0.3], (30, 4)
        )
    ]
    line = np.array([0.6, 0.9, -0.4, 0.3])
    true = [flame.seen * np.exp(line @ [1, *flame.logs]) for flame in flames]
    fitted = MeanSpeed.fit(flames, true)
    assert fitted.of(flames[0]) == pytest.approx(true[0], rel=0.05)
    far = SpeedClues(9.0, 9.0 * 12, 9.0 * 1.5, 0.04, 1.0)
    assert fitted.of(far) == pytest.approx(far.seen * np.exp(line @ [1, *far.logs]), rel=0.1)


def test_one_flame_is_enough_and_says_only_its_factor():
    clues = clues_of(column())
    fitted = MeanSpeed.fit([clues], [3 * clues.seen])
    assert fitted.of(clues) == pytest.approx(3 * clues.seen, rel=1e-3)
    assert np.abs(fitted.metric[1:]).max() < 0.9


@pytest.mark.parametrize("size", [1e-3, 1e3])
def test_without_metres_the_unit_of_length_does_not_matter(size):
    pace = MeanSpeed(np.array([0.5, 0.8, -0.4, 0.3]), np.array([0.5, 0.0, -0.4, 0.3]))
    same = pace.of(clues_of(column(bands=rising)), metres=False)
    larger = clues_of(column(1.5 * size, 0.5 * size, 0.05 * size, lambda z, t: rising(z / size, t)))
    assert pace.of(larger, metres=False) / size == pytest.approx(same, rel=1e-6)


PACE = MeanSpeed(np.array([0.5, 0.8, -0.4, 0.3]), np.array([0.5, 0.0, -0.4, 0.3]))


def two_columns(*energy: float) -> list[SpeedClues]:
    """One of four times the height of the other, in all its lengths; each is seen to move in its own way."""
    tall, short = column(1.6, seen=0.9, radius_m=0.08), column(0.4, seen=0.2, radius_m=0.02)
    return [replace(clues_of(flame), energy=e) for flame, e in zip((tall, short), energy, strict=True)]


@pytest.mark.parametrize("metres", [True, False])
def test_gas_beside_other_gas_goes_with_the_root_of_its_flames_height(metres):
    """Buoyancy: four times the height, twice the speed."""
    clues = two_columns(1.0, 1.0)
    of_tall, of_short = PACE.side_by_side(clues, metres)
    assert of_tall / of_short == pytest.approx(2, rel=1e-3)
    assert of_tall * of_short == pytest.approx(np.prod([PACE.of(flame, metres) for flame in clues]), rel=1e-9)


def test_of_flames_side_by_side_the_one_that_is_seen_to_move_is_believed():
    clues = two_columns(1.0, 1e-12)
    of_tall, of_short = PACE.side_by_side(clues)
    assert of_tall == pytest.approx(PACE.of(clues[0]), rel=1e-9)
    assert of_short == pytest.approx(PACE.of(clues[0]) / 2, rel=1e-3)


def test_energy_is_light_times_the_square_of_the_speed():
    slow, fast = (clues_of(column(seen=seen)).energy for seen in (0.5, 1.0))
    assert fast / slow == pytest.approx(4)


def test_one_flame_says_its_pace_by_itself():
    clues = clues_of(column())
    assert PACE.side_by_side([clues]) == [PACE.of(clues)]
    assert PACE.side_by_side([]) == []


def rising(z, t):
    return 1.5 + np.sin(2 * np.pi * (z - 0.4 * t) / 0.3)


def test_what_is_stranger_than_all_flames_counts_no_more_than_the_strangest():
    crawling = clues_of(column(seen=1e-6))
    assert np.abs(crawling.logs).max() <= FARTHEST
    assert np.isfinite(MeanSpeed(np.ones(4), np.ones(4)).of(crawling))
    falling = clues_of(column(bands=lambda z, t: rising(z, -t)))
    assert falling.carried < 0
    assert falling.logs[2] == -FARTHEST
