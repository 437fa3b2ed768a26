"""What the gas does at a place between voxels and frames, against fields that are linear there."""

from dataclasses import replace

import numpy as np
import pytest

from gof.core.gaussians import TransientGaussians
from gof.dataset import Dataset
from gof.reconstruct import run_inputs
from gof.reconstruct.flow_prior import VOXELS
from gof.reconstruct.gas import gas_at, look_up_gas, with_gas_of
from gof.reconstruct.optical_flow import dis
from gof.reconstruct.settings import ReconstructionSettings
from gof.reconstruct.shrink import shrink
from tests.reconstruct.plumes import box_of_voxels, changed, field_of
from tests.reconstruct.rising_flame import write_flame

VOXEL, FRAME, FRAMES = 0.05, 0.01, 4
SLOPES = np.array([[0.3, -0.7, 1.1], [2.0, 0.4, -0.2], [-0.5, 0.9, 0.6]])  # 1/s
GROWTH = np.array([3.0, -8.0, 40.0])  # m/s2


def linear(place, time_s):
    return place @ SLOPES.T + np.asarray(time_s)[..., None] * GROWTH + [1.0, 2.0, 3.0]


@pytest.fixture
def field():
    """A velocity that is linear in space and time, and a deviation that is linear in time."""
    voxels = box_of_voxels((6, 8, 10), VOXEL)
    velocity = [linear(voxels.center, np.full(len(voxels.center), FRAME * f)) for f in range(FRAMES)]
    made = field_of(voxels, velocity, np.ones((FRAMES, len(voxels.center))), FRAME)
    frames = [replace(f, velocity_sd=np.full(len(f.known), 0.5 + 10 * f.time_s)) for f in made.frames]
    return replace(made, frames=tuple(frames))


def places(field, n=200):
    """Between the outermost centres."""
    low, high = field.voxels.center.min(0), field.voxels.center.max(0)
    rng = np.random.default_rng(0)
    return rng.uniform(low, high, (n, 3)), rng.uniform(0, FRAME * (FRAMES - 1), n)


def gaussians_at(place, time_s, dynamic=True, velocity=(0, 0, 0), t_sigma=1e-9):
    n = len(place)
    return TransientGaussians(
        position=place,
        velocity=np.tile(np.float64(velocity), (n, 1)),
        t_mu=time_s,
        t_sigma=np.full(n, t_sigma),
        scale=np.ones((n, 3)),
        rotation=np.tile([1.0, 0, 0, 0], (n, 1)),
        opacity=np.ones(n),
        color=np.ones((n, 3)),
        dynamic=np.full(n, dynamic),
        gas_velocity=np.full((n, 3), 77.0),
        velocity_sd=np.full(n, 7.0),
    )


def test_linear_fields_come_back_exactly(field):
    place, time_s = places(field)
    velocity, sd = gas_at(field, place, time_s)
    np.testing.assert_allclose(velocity, linear(place, time_s), atol=1e-10)
    np.testing.assert_allclose(sd, 0.5 + 10 * time_s, atol=1e-10)


def test_what_is_not_known_does_not_pull(field):
    """Unknown voxels hold nonsense; a place among known and unknown ones gets the known ones' velocity."""
    uniform = changed(field, velocity=lambda v: np.tile([0.0, 0.0, 2.0], (len(v), 1)))
    unknown = field.voxels.index[:, 2] >= 5
    wrong = [
        replace(f, known=~unknown, velocity=np.where(unknown[:, None], np.nan, f.velocity)) for f in uniform.frames
    ]
    level = field.voxels.center[field.voxels.index[:, 2] == 4][0, 2]
    place = np.array([[0.0, 0.0, level + 0.9 * VOXEL], [0.0, 0.0, level + 1.1 * VOXEL]])
    velocity, sd = gas_at(replace(uniform, frames=tuple(wrong)), place, np.full(2, FRAME))
    np.testing.assert_allclose(velocity[0], [0, 0, 2.0])
    assert np.isnan(velocity[1]).all() and np.isposinf(sd[1])


def test_nobody_sure_of_it(field):
    unsure = changed(field, velocity_sd=lambda sd: np.full_like(sd, np.inf))
    velocity, sd = gas_at(unsure, *places(field))
    assert np.isfinite(velocity).all() and np.isposinf(sd).all()


def test_before_the_first_frame_and_of_a_single_one(field):
    place, _ = places(field)
    first = linear(place, np.zeros(len(place)))
    for some in (field, replace(field, frames=field.frames[:1])):
        velocity, _ = gas_at(some, place, np.full(len(place), -0.3))
        np.testing.assert_allclose(velocity, first, atol=1e-10)


def test_a_life_is_heard_from_its_beginning_to_its_end(field):
    """A velocity that grows as the square of the time, and a Gaussian that is carried up: the mean over its life."""
    sigma, rise, middle = FRAME, 1.0, np.array([[0.0, 0.0, 5 * VOXEL]])
    squared = [replace(f, velocity=f.velocity + (0, 0, 1e4 * f.time_s**2)) for f in field.frames]
    told = look_up_gas(
        gaussians_at(middle, [2 * FRAME], velocity=(0, 0, rise), t_sigma=sigma), replace(field, frames=tuple(squared))
    )
    expected = linear(middle, [2 * FRAME])[0] + (0, 0, 1e4 * ((2 * FRAME) ** 2 + sigma**2))
    np.testing.assert_allclose(told.gas_velocity[0], expected, rtol=1e-5)
    forever = look_up_gas(gaussians_at(middle, [2 * FRAME], t_sigma=np.inf), field)
    np.testing.assert_allclose(forever.gas_velocity, linear(middle, [2 * FRAME]), rtol=1e-5)


def test_nobody_saw_what_comes_after_the_clip(field):
    """Brightest in the last frame, it is heard there and before, not on its way to where it would have gone."""
    end, place = FRAME * (FRAMES - 1), np.array([[0.0, 0.0, 5 * VOXEL]])
    told = look_up_gas(gaussians_at(place, [end], velocity=(0, 0, 100.0), t_sigma=1e-3), field)
    expected = (linear(place, [end]) + linear(place - [0, 0, 0.1], [end - 1e-3])) / 2
    np.testing.assert_allclose(told.gas_velocity, expected, rtol=1e-5)


def test_who_left_the_flame_keeps_what_it_says_and_what_is_still_rests(field):
    place, time_s = places(field, 3)
    place[1] += 10.0
    told = look_up_gas(gaussians_at(place, time_s), field)
    np.testing.assert_allclose(told.gas_velocity[[0, 2]], linear(place, time_s)[[0, 2]], rtol=1e-5)
    assert (told.gas_velocity[1] == 77).all() and told.velocity_sd[1] == 7
    still = look_up_gas(gaussians_at(place, time_s, dynamic=False), field)
    assert (still.gas_velocity == 0).all() and (still.velocity_sd == 7).all()


@pytest.mark.parametrize("away", [[5e5, 6e6, 100.0]])
def test_far_from_the_origin(field, away):
    """Metres of a map: places in float64 lose nothing that matters."""
    far = changed(field, voxels=lambda v: replace(v, center=v.center + away))
    place, time_s = places(field)
    velocity, _ = gas_at(far, place + away, time_s)
    np.testing.assert_allclose(velocity, linear(place, time_s), atol=1e-6)


# ---- on other voxels -------------------------------------------------------------------------------------------------


def test_a_linear_field_is_the_same_on_other_voxels(field):
    """Between the outermost centres; beyond the box, where nobody knows the gas, it goes with the light."""
    fine = box_of_voxels((20, 20, 35), 0.02)
    light = np.full((FRAMES, len(fine.center), 3), 5.0)
    told = with_gas_of(field_of(fine, light, np.ones((FRAMES, len(fine.center))), FRAME), field)
    low, high = field.voxels.center.min(0), field.voxels.center.max(0)
    inside = ((fine.center >= low) & (fine.center <= high)).all(1)
    outside = ((fine.center < low - VOXEL) | (fine.center > high + VOXEL)).any(1)
    assert inside.sum() > 1000 and outside.sum() > 1000
    for f, frame in enumerate(told.frames):
        here = linear(fine.center[inside], np.full(inside.sum(), FRAME * f))
        np.testing.assert_allclose(frame.velocity[inside], here, atol=1e-9)
        np.testing.assert_allclose(frame.velocity_sd[inside], 0.5 + 10 * FRAME * f, atol=1e-10)
        assert (frame.velocity[outside] == 5).all() and np.isinf(frame.velocity_sd[outside]).all()
        assert (frame.light_velocity == 5).all() and frame.time_s == FRAME * f


def test_a_clip_in_which_nothing_is_known_moves_as_its_light_does(field):
    nothing = changed(field, known=np.zeros_like)
    told = with_gas_of(field, nothing)
    for frame in told.frames:
        np.testing.assert_array_equal(frame.velocity, frame.light_velocity)
        assert np.isinf(frame.velocity_sd).all()


@pytest.fixture(scope="module")
def rising_flame(tmp_path_factory):
    return write_flame(tmp_path_factory.mktemp("rising") / "flame")


def test_the_prior_is_asked_on_its_own_voxels_whatever_the_others_are(rising_flame, monkeypatch):
    """Gas that the prior made (here: the grid's voxel size as a speed) reaches every other grid unchanged."""
    asked = []

    def correct(prior, field, metres):
        asked.append(field.voxels.voxel_size)
        size = np.full(3, field.voxels.voxel_size)
        return changed(field, velocity=lambda v: 0 * v + size, velocity_sd=np.zeros_like)

    monkeypatch.setattr(run_inputs.FlowPrior, "correct", correct)
    dataset = shrink(Dataset.open(rising_flame), 96)
    heard = []
    for voxels in (VOXELS, 24):
        settings = ReconstructionSettings("flame", iterations=5, gaussians=300, voxels=voxels, longest_side=96)
        observation = run_inputs.observation_of(dataset, settings, dis)
        made = run_inputs.flow_field_of(dataset, settings, observation, lambda done, total: heard.append((done, total)))
        assert made.voxels.voxel_size == pytest.approx(asked[0] * VOXELS / voxels, rel=0.1)
        frame = made.frames[2]
        sure = np.isfinite(frame.velocity_sd)
        assert sure[frame.emission > 0].mean() > 0.9
        np.testing.assert_allclose(frame.velocity[sure], asked[0], rtol=1e-9)
        done, totals = zip(*heard, strict=True)
        assert done == tuple(range(1, totals[0] + 1)) and len(set(totals)) == 1
        heard.clear()
    assert len(asked) == 2 and asked[0] == asked[1]
