"""How fast a flame is as a whole, on flames whose every number is known."""

from dataclasses import replace

import numpy as np
import pytest

from gof.reconstruct.flame_axis import FlameAxis
from gof.reconstruct.flow_field import FlowField
from gof.reconstruct.flow_prior import FlowPrior
from gof.reconstruct.log_light import LogLight
from gof.reconstruct.pace import (
    FARTHEST,
    USUAL,
    USUAL_UNSTEADY,
    Pace,
    PaceClues,
    buoyant_speed,
    carried_speed,
    texture_along,
    unsteadiness,
)
from tests.reconstruct.plumes import box_of_voxels, field_of

STEP_S = 0.01  # between the frames of field_of


def column(height_m: float = 1.5, seen: float = 0.5, radius_m: float = 0.05, bands=lambda z, t: 1.0) -> FlowField:
    """An upright round flame from z = 0 to its top that is seen to rise at `seen` m/s, its light times bands(z, t)."""
    voxels = box_of_voxels((12, 12, 60), height_m / 60)
    x, y, z = voxels.center.T
    round_flame = np.exp(-(x**2 + y**2) / (2 * radius_m**2))
    velocity = np.broadcast_to([0, 0, seen], voxels.center.shape)
    return field_of(voxels, [velocity] * 3, [round_flame * bands(z, f * STEP_S) for f in range(3)])


def clues_of(field: FlowField) -> PaceClues:
    return PaceClues.of(FlameAxis.of(field), LogLight.of(field))


@pytest.mark.parametrize("height_m", [0.1, 1.5, 20.0])
def test_buoyant_speed_of_a_column(height_m):
    """McCaffrey's 6.83 sqrt(z) m/s, averaged over a column that begins where 2 % of its light are below."""
    foot = 0.02 * height_m
    expected = 6.83 * 2 / 3 * (height_m - foot) ** 1.5 / height_m
    found = buoyant_speed(FlameAxis.of(column(height_m, radius_m=height_m / 30)))
    assert found == pytest.approx(expected, rel=0.02)


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


def test_texture_along_is_the_ratio_of_the_slopes():
    """A wave that moves through a broad flame; its crests stand at 45 degrees, lie, stand upright."""

    def found(kx: float, kz: float) -> float:
        voxels = box_of_voxels((32, 8, 32), 0.02)
        x, _, z = voxels.center.T
        waves = [np.exp(0.1 * np.sin(kx * x + kz * z - np.pi / 3 * f)) for f in range(6)]
        field = field_of(voxels, [np.broadcast_to([0, 0, 1.0], voxels.center.shape)] * 6, waves)
        return texture_along(FlameAxis.of(field), LogLight.of(field))

    assert found(10, 10) == pytest.approx(1, rel=0.1)
    assert found(10, 20) == pytest.approx(2, rel=0.25)
    assert found(10, 0) < 0.2
    assert found(0, 10) > 5


def test_a_steady_flame_says_nothing_of_its_texture():
    field = column()
    assert texture_along(FlameAxis.of(field), LogLight.of(field)) == USUAL[3]


def swaying(sideways: float) -> FlowField:
    """The column, whose light in four frames also goes right, left, right, left at a speed, m/s."""
    still = column()
    voxels, emission = still.voxels, still.frames[0].emission
    velocity = [np.broadcast_to([sideways * (-1) ** f, 0, 0.5], voxels.center.shape) for f in range(4)]
    return field_of(voxels, velocity, [emission] * 4)


@pytest.mark.parametrize("sideways", [0.0, 0.25, 2.0])
def test_unsteadiness_of_a_column_that_sways(sideways):
    """Its mean is the rise; what is left is the sway."""
    assert unsteadiness(swaying(sideways), 1.0) == pytest.approx(sideways / np.hypot(sideways, 0.5), abs=1e-6)


def test_unsteadiness_twin():
    """The same, voxel by voxel, of motion and light without any order."""
    rng = np.random.default_rng(1)
    voxels = box_of_voxels((3, 2, 4), 0.1)
    velocity, emission = rng.normal(0.3, 1, (5, 24, 3)), rng.uniform(0, 1, (5, 24)) * (rng.random((5, 24)) > 0.3)
    left = whole = 0.0
    for v in range(24):
        if not emission[:, v].any():
            continue
        mean = sum(e * u for e, u in zip(emission[:, v], velocity[:, v], strict=True)) / sum(emission[:, v])
        for e, u in zip(emission[:, v], velocity[:, v], strict=True):
            left += e * sum((u - mean) ** 2)
            whole += e * sum(u**2)
    assert unsteadiness(field_of(voxels, velocity, emission), 1.0) == pytest.approx((left / whole) ** 0.5, rel=1e-9)


def test_a_window_forgets_what_is_past():
    """A column that goes right for six frames and left for six: in three frames it is steady, but about the turn."""
    still = column()
    voxels, emission = still.voxels, still.frames[0].emission
    turned = [np.broadcast_to([0.25 if f < 6 else -0.25, 0, 0.5], voxels.center.shape) for f in range(12)]
    field = field_of(voxels, turned, [emission] * 12)
    whole = 0.25**2 + 0.5**2
    assert unsteadiness(field, 1.0) == pytest.approx(0.25 / whole**0.5, rel=1e-6)
    about_the_turn = 2 * (1 - (1 / 3) ** 2) * 0.25**2 / (10 * whole)  # two of ten windows, mean a third of the speed
    assert unsteadiness(field, 2 * STEP_S) == pytest.approx(about_the_turn**0.5, rel=1e-6)


def test_two_frames_say_nothing_of_how_unsteady_a_motion_is():
    """Nor does a flame that is not seen to move; a steady one does."""
    field = swaying(0.25)
    assert unsteadiness(FlowField(field.voxels, field.frames[:2]), 1.0) == USUAL_UNSTEADY
    assert unsteadiness(field, 1.5 * STEP_S) == USUAL_UNSTEADY
    assert unsteadiness(column(seen=0.0), 1.0) == USUAL_UNSTEADY
    assert unsteadiness(column(), 1.0) == pytest.approx(0, abs=1e-6)


def test_clues_ask_how_unsteady_a_motion_is_in_a_fifth_of_its_buoyant_time():
    """0.2 v / g, 0.1 s for this column: a turn after each 0.02 s is in every window, one after 0.5 s in an eighth."""
    still = column()
    voxels, emission = still.voxels, still.frames[0].emission

    def turning(every: int) -> float:
        turned = [np.broadcast_to([0.25 * (-1) ** (f // every), 0, 0.5], voxels.center.shape) for f in range(100)]
        return clues_of(field_of(voxels, turned, [emission] * 100)).unsteady

    assert turning(2) == pytest.approx(0.25 / np.hypot(0.25, 0.5), rel=0.05)
    assert turning(50) < 0.4 * turning(2)


LINE = np.array([0.6, 0.9, -0.4, 0.3, -0.5])


def test_a_line_is_found_again():
    """Flames that obey a line exactly, and one far from them that obeys it too."""
    flames = [
        PaceClues(seen, seen * law, seen * carried, slenderness, texture, 1.0, unsteady)
        for seen, law, carried, slenderness, texture, unsteady in np.random.default_rng(0).uniform(
            [0.1, 2, 0.2, 0.05, 0.3, 0.05], [3, 8, 1, 0.3, 1.5, 0.4], (30, 6)
        )
    ]
    true = [flame.seen * np.exp(LINE @ [1, *flame.logs]) for flame in flames]
    fitted = Pace.fit(flames, true)
    assert fitted.of(flames[0]) == pytest.approx(true[0], rel=0.05)
    far = PaceClues(9.0, 9.0 * 12, 9.0 * 1.5, 0.04, 0.2, 1.0, 0.6)
    assert fitted.of(far) == pytest.approx(far.seen * np.exp(LINE @ [1, *far.logs]), rel=0.1)


def test_one_flame_is_enough_and_says_only_its_factor():
    clues = clues_of(column())
    fitted = Pace.fit([clues], [3 * clues.seen])
    assert fitted.of(clues) == pytest.approx(3 * clues.seen, rel=1e-3)
    assert np.abs(fitted.metric[1:]).max() < 0.9


@pytest.mark.parametrize("size", [1e-3, 1e3])
def test_without_metres_the_unit_of_length_does_not_matter(size):
    same = PACE.of(clues_of(column(bands=rising)), metres=False)
    larger = clues_of(column(1.5 * size, 0.5 * size, 0.05 * size, lambda z, t: rising(z / size, t)))
    assert PACE.of(larger, metres=False) / size == pytest.approx(same, rel=1e-6)


PACE = Pace(LINE, LINE * [1, 0, 1, 1, 1])


@pytest.mark.parametrize(("unsteady", "factor"), [(0, 1), (0.14, 1), (0.2, (10 / 7) ** 0.68), (0.9, 2**0.68)])
def test_an_unsteady_motion_is_less_sure_and_no_faster(unsteady, factor):
    """Up to twice the usual; a steady one is no surer."""
    usual = replace(clues_of(column(bands=rising)), unsteady=0.14)
    asked = replace(usual, unsteady=unsteady)
    assert asked.widening == pytest.approx(factor)
    assert PACE.of(asked) == PACE.of(usual)


@pytest.mark.parametrize(("clue", "sign"), [("buoyant", 1), ("slenderness", -1), ("carried", 1), ("texture", -1)])
def test_the_shipped_line_is_monotone_in_every_clue(clue, sign):
    """As physics says, from a tenth to ten times the usual; never more than 20 times or less than a 20th of it."""
    shipped = FlowPrior.load().pace
    usual = PaceClues(1.0, 4.0, 0.6, 0.14, 0.7, 1.0, 0.14)
    factors = np.geomspace(0.1, 10, 9)
    paces = [shipped.of(replace(usual, **{clue: getattr(usual, clue) * factor})) for factor in factors]
    steps = sign * np.diff(np.log(paces))
    assert (steps >= -1e-12).all() and steps.max() > 0.05
    assert max(paces) < 20 * shipped.of(usual) and min(paces) > shipped.of(usual) / 20


def two_columns(*energy: float) -> list[PaceClues]:
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
    assert np.isfinite(Pace(np.ones(5), np.ones(5)).of(crawling))
    falling = clues_of(column(bands=lambda z, t: rising(z, -t)))
    assert falling.carried < 0
    assert falling.logs[2] == -FARTHEST
