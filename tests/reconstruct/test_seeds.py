"""Where seeds are put, and how long they live, on a round column whose radius and speed are known."""

from dataclasses import replace

import numpy as np
import pytest

from gof.core.errors import DataFormatError
from gof.reconstruct.flow_field import FlowField, FrameField
from gof.reconstruct.methods import OURS, PAPER
from gof.reconstruct.seeds import CROSSED, LIFETIME_FRAMES, lifetime_s, sample_seeds
from gof.reconstruct.voxels import carve
from tests.conftest import arc

SPEED, RADIUS = 2.0, 0.15


@pytest.fixture(scope="module")
def column():
    """Voxels of a box, and two frames that shine evenly within RADIUS of the axis and rise at SPEED."""
    voxels = carve(arc(3), np.ones((1, 3, 64, 36), bool), 40)
    inside = np.hypot(voxels.center[:, 0], voxels.center[:, 1]) < RADIUS
    frame = FrameField(
        time_s=0.0,
        emission=inside * 1.0,
        light=1.0,
        light_velocity=np.tile([0, 0, 0.6 * SPEED], (len(inside), 1)),
        velocity=np.tile([0, 0, SPEED], (len(inside), 1)),
        velocity_sd=np.full(len(inside), np.inf),
        known=np.ones(len(inside), bool),
        image=np.full((3, 64, 36, 3), 0.5),
    )
    return FlowField(voxels, (frame, replace(frame, time_s=0.01)))


def changed(field, **changes):
    """The field with other values in all of its frames."""
    return replace(field, frames=tuple(replace(frame, **changes) for frame in field.frames))


def test_a_life_is_the_time_to_cross_a_part_of_the_radius(column):
    distance = np.hypot(column.voxels.center[:, 0], column.voxels.center[:, 1])[column.frames[0].emission > 0]
    expected = CROSSED * np.sqrt((distance**2).mean()) / SPEED
    assert lifetime_s(column, frame_time_s=expected / 2) == pytest.approx(expected, rel=0.05)
    shortest = 2 * expected * LIFETIME_FRAMES[0]
    assert lifetime_s(column, frame_time_s=2 * expected) == pytest.approx(shortest), (
        "never less than about a frame time"
    )
    longest = expected / 10 * 4
    assert lifetime_s(column, frame_time_s=expected / 10) == pytest.approx(longest), "nor more than the paper's"


def test_what_does_not_move_or_shine_lives_as_long_as_allowed(column):
    frame = column.frames[0]
    for change in ({"velocity": frame.velocity * 0}, {"emission": frame.emission * 0}):
        assert lifetime_s(changed(column, **change), 0.01) == pytest.approx(0.04)


def test_seeds_move_with_the_light_and_say_what_the_gas_does(column):
    seeds = sample_seeds(column, OURS.seeding, 0.02, 100, np.random.default_rng(0))
    np.testing.assert_allclose(seeds.velocity, np.tile([0, 0, 0.6 * SPEED], (len(seeds), 1)), rtol=1e-6)
    np.testing.assert_allclose(seeds.gas_velocity, np.tile([0, 0, SPEED], (len(seeds), 1)), rtol=1e-6)


def test_seeds_follow_the_emission(column):
    first, second = column.frames
    high = column.voxels.center[:, 2] > 1
    uneven = replace(first, emission=first.emission * np.where(high, 3.0, 1.0))
    dark = replace(second, emission=0 * second.emission)
    field = replace(column, frames=(uneven, dark))
    seeds = sample_seeds(field, OURS.seeding, 0.02, 20_000, np.random.default_rng(0))
    assert np.unique(seeds.t_mu).tolist() == [0.0] and (seeds.t_sigma == np.float32(0.02)).all()
    half = column.voxels.voxel_size
    assert np.hypot(seeds.position[:, 0], seeds.position[:, 1]).max() < RADIUS + half
    lit = first.emission > 0
    above, below = (lit & high).sum(), (lit & ~high).sum()
    assert (seeds.position[:, 2] > 1).mean() == pytest.approx(3 * above / (3 * above + below), abs=0.03)


def test_seeds_follow_light_that_is_nearer_together(column):
    """A frame of which no such light was found keeps to its emission."""
    core = np.hypot(column.voxels.center[:, 0], column.voxels.center[:, 1]) < RADIUS / 2
    seeds = sample_seeds(
        column, OURS.seeding, 0.02, 20_000, np.random.default_rng(0), light=np.stack([7.0 * core, 0.0 * core])
    )
    away, half = np.hypot(seeds.position[:, 0], seeds.position[:, 1]), column.voxels.voxel_size
    first = seeds.t_mu == 0
    assert away[first].max() < RADIUS / 2 + half < away[~first].max()
    areas = [(column.frames[0].emission > 0).sum(), core.sum()]
    assert (~first).sum() / first.sum() == pytest.approx(areas[0] / areas[1], rel=0.01), "a larger flame has more seeds"


def test_seeds_of_the_papers_method_are_in_half_of_the_voxels_whose_motion_is_known(column):
    known = column.voxels.center[:, 0] > 0
    field = changed(column, known=known)
    seeds = sample_seeds(field, PAPER.seeding, 0.02, 10**6, np.random.default_rng(0))
    half, voxel = known.sum() // 2, column.voxels.voxel_size
    for time_s in (frame.time_s for frame in field.frames):
        one = seeds[seeds.t_mu == np.float32(time_s)]
        share = len(one) / len(field.frames) if len({f.time_s for f in field.frames}) == 1 else len(one)
        assert share == half
    outside = np.hypot(seeds.position[:, 0], seeds.position[:, 1]) > RADIUS
    dark = column.frames[0].emission == 0
    assert outside.mean() == pytest.approx((dark & known).sum() / known.sum(), abs=0.05), "emission plays no part"
    assert seeds.position[:, 0].min() > -voxel
    assert (seeds.color == 0.5).all() and seeds.scale.max() == pytest.approx(0.25 * voxel)
    few = sample_seeds(field, PAPER.seeding, 0.02, 500, np.random.default_rng(0))
    assert 490 < len(few) <= 500, "the number asked for is the most"


def test_nothing_to_seed_is_an_error(column):
    nothing = np.zeros(len(column.voxels.center))
    with pytest.raises(DataFormatError, match="no voxel"):
        sample_seeds(changed(column, emission=nothing), OURS.seeding, 0.02, 100, np.random.default_rng(0))
