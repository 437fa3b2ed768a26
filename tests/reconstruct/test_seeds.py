"""Where seeds are put, and how long they live, on a round column whose radius and speed are known."""

import numpy as np
import pytest

from gof.errors import DataFormatError
from gof.reconstruct.seeds import CROSSING, LIFETIME_FRAMES, lifetime_s, sample_seeds
from gof.reconstruct.voxels import carve
from tests.conftest import arc

SPEED, RADIUS = 2.0, 0.15


@pytest.fixture(scope="module")
def column():
    """Voxels of a box, and two frames that shine evenly within RADIUS of the axis and rise at SPEED."""
    voxels = carve(arc(3), np.ones((1, 3, 64, 36), bool), 40)
    inside = np.hypot(voxels.center[:, 0], voxels.center[:, 1]) < RADIUS
    frame = {
        "time_s": 0.0,
        "emission": inside * 1.0,
        "density": inside * 1.0,
        "known": np.ones(len(inside), bool),
        "velocity": np.tile([0, 0, SPEED], (len(inside), 1)),
        "image": np.full((3, 64, 36, 3), 0.5),
    }
    return voxels, [frame, frame | {"time_s": 0.01}]


def test_a_life_is_the_time_to_cross_a_part_of_the_radius(column):
    voxels, frames = column
    distance = np.hypot(voxels.center[:, 0], voxels.center[:, 1])[frames[0]["emission"] > 0]
    expected = CROSSING * np.sqrt((distance**2).mean()) / SPEED
    assert lifetime_s(voxels, frames, frame_time_s=expected / 2) == pytest.approx(expected, rel=0.05)
    assert lifetime_s(voxels, frames, frame_time_s=2 * expected) == pytest.approx(2 * expected * LIFETIME_FRAMES[0]), (
        "never less than about a frame time"
    )
    assert lifetime_s(voxels, frames, frame_time_s=expected / 10) == pytest.approx(expected / 10 * 4), (
        "nor more than the paper's"
    )


def test_what_does_not_move_or_shine_lives_as_long_as_allowed(column):
    voxels, frames = column
    for change in ({"velocity": frames[0]["velocity"] * 0}, {"emission": frames[0]["emission"] * 0}):
        assert lifetime_s(voxels, [f | change for f in frames], 0.01) == pytest.approx(0.04)


def test_seeds_follow_the_density(column):
    voxels, frames = column
    uneven = frames[0] | {"density": frames[0]["density"] * np.where(voxels.center[:, 2] > 1, 3.0, 1.0)}
    seeds = sample_seeds(
        voxels, [uneven, frames[1] | {"density": 0 * frames[1]["density"]}], 0.02, 20_000, 0.1, np.random.default_rng(0)
    )
    assert np.unique(seeds.t_mu).tolist() == [0.0] and (seeds.t_sigma == np.float32(0.02)).all()
    half = voxels.voxel_size
    assert np.hypot(seeds.position[:, 0], seeds.position[:, 1]).max() < RADIUS + half
    lit = frames[0]["density"] > 0
    above, below = (lit & (voxels.center[:, 2] > 1)).sum(), (lit & (voxels.center[:, 2] <= 1)).sum()
    expected = 3 * above / (3 * above + below)
    seen = (seeds.position[:, 2] > 1).mean()
    assert seen == pytest.approx(expected, abs=0.03)


def test_nothing_to_seed_is_an_error(column):
    voxels, frames = column
    with pytest.raises(DataFormatError, match="no voxel"):
        sample_seeds(
            voxels, [f | {"density": 0 * f["density"]} for f in frames], 0.02, 100, 0.1, np.random.default_rng(0)
        )
