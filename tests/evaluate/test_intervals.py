"""Intervals and ranks against closed forms, scipy's tests, and series whose true mean and correlation are known."""

import numpy as np
import pytest
from scipy import stats

from gof.core.errors import GofError, NonFiniteError
from gof.evaluate.eddy_time import integral_time
from gof.evaluate.intervals import (
    Estimate,
    apart,
    block_length,
    block_variance,
    missing_share,
    over_frames,
    over_runs,
    over_scenes,
    ranks,
)


def correlated(count: int, eddy_frames: float, repeats: int, seed: int = 0) -> np.ndarray:
    """(repeats, count) of mean 0, variance 1 and correlation exp(-lag / eddy_frames): a first-order autoregression."""
    rng = np.random.default_rng(seed)
    memory = np.exp(-1 / eddy_frames) if eddy_frames else 0.0
    series = rng.standard_normal((repeats, count))
    for k in range(1, count):
        series[:, k] = memory * series[:, k - 1] + np.sqrt(1 - memory**2) * series[:, k]
    return series


def variance_of_the_mean(n: int, eddy_frames: float) -> float:
    """The textbook's, for `correlated` values."""
    phi = np.exp(-1 / eddy_frames)
    return ((1 + phi) / (1 - phi) - 2 * phi * (1 - phi**n) / (n * (1 - phi) ** 2)) / n


def test_the_closed_form_is_what_drawing_blocks_gives():
    series = correlated(36, 3, 1)[0]
    rng, block = np.random.default_rng(1), 4
    starts = rng.integers(0, 36, (20000, 36 // block))
    drawn = series[(starts[..., None] + np.arange(block)) % 36].reshape(20000, -1).mean(1)
    assert block_variance(series, block) == pytest.approx(drawn.var(), rel=0.04)


@pytest.mark.parametrize(("count", "eddy_frames"), [(24, 1), (36, 2), (36, 4), (100, 6)])
def test_blocks_alone_miss_the_share_that_the_closed_form_says(count, eddy_frames):
    block = block_length(count, eddy_frames)
    seen = np.mean([block_variance(series, block) for series in correlated(count, eddy_frames, 8000)])
    assert seen * missing_share(count, block, eddy_frames) == pytest.approx(
        variance_of_the_mean(count, eddy_frames), rel=0.04
    )


@pytest.mark.parametrize("count", [24, 36, 100])
@pytest.mark.parametrize("eddy_frames", [0, 1, 2, 4, 6])
def test_intervals_hold_the_true_mean_as_often_as_they_say(count, eddy_frames):
    held = [
        abs(estimate.mean) <= estimate.half_width
        for estimate in (over_frames(series, eddy_frames) for series in correlated(count, eddy_frames, 1500))
    ]
    assert np.mean(held) > 0.933  # 0.95 less three standard errors of 1500 draws


def test_without_correlation_it_is_students_t():
    series = np.random.default_rng(2).normal(0.3, 1, 20)
    found, known = over_frames(series, 0), stats.ttest_1samp(series, 0)
    interval = known.confidence_interval(0.95)
    assert (found.mean - found.half_width, found.mean + found.half_width) == pytest.approx(tuple(interval), rel=1e-12)
    assert found.p_value == pytest.approx(known.pvalue, rel=1e-12)


def test_paired_frames_tell_apart_what_means_do_not():
    clip = correlated(60, 2, 1)[0]
    ours, theirs = clip, clip + 0.2 + 0.05 * correlated(60, 2, 1, seed=5)[0]
    assert over_frames(ours - theirs, 2).p_value < 1e-6
    assert over_frames(ours, 2).half_width > 0.2


def test_scenes_are_a_sample_from_three_on():
    scenes = [Estimate(mean, 0.01, 5) for mean in (0.1, 0.4, 0.2, 0.3)]
    known = stats.ttest_1samp([0.1, 0.4, 0.2, 0.3], 0)
    assert over_scenes(scenes).p_value == pytest.approx(known.pvalue, rel=1e-12)
    two = over_scenes(scenes[:2])
    assert (two.standard_error, two.degrees) == (pytest.approx(0.01 / np.sqrt(2)), 5)
    assert over_scenes([Estimate(0.1, None, 0)]).half_width is None


def test_seeds_add_their_own_spread():
    frames = correlated(36, 1, 1)[0]
    runs = [frames - 0.3, frames, frames + 0.3]  # seeds that differ by a constant: standard deviation 0.3
    alone = over_frames(frames, 1).standard_error
    assert over_runs(runs, 1).standard_error == pytest.approx(np.hypot(alone, 0.3 / np.sqrt(3)), rel=1e-12)
    assert over_runs(runs[1:2], 1) == over_frames(frames, 1)


def test_holms_procedure():
    # Holm's own rule on p = 0.010, 0.020, 0.030: 0.010 <= 0.05 / 3, 0.020 <= 0.05 / 2, 0.030 <= 0.05
    p_values = np.array([[1, 0.010, 0.030], [0.010, 1, 0.020], [0.030, 0.020, 1]])
    assert apart(p_values).sum() == 6
    p_values[0, 1] = p_values[1, 0] = 0.018  # the smallest fails, and with it all
    assert not apart(p_values).any()


def test_methods_that_cannot_be_told_apart_share_a_rank():
    p_values = np.array([[1, 0.4, 1e-4], [0.4, 1, 0.3], [1e-4, 0.3, 1]])
    assert ranks([0.30, 0.35, 0.50], p_values, better=-1) == [(1, 2), (1, 3), (2, 3)], "the middle one is behind nobody"
    assert ranks([0.30, 0.35, 0.50], p_values, better=1) == [(2, 3), (1, 3), (1, 2)]


def test_bad_points():
    assert over_frames([0.5], 3).half_width is None
    assert over_frames([0.5], 3).p_value == 1
    same = over_frames([0.5] * 8, 3)
    assert (same.half_width, same.p_value) == (0, 0)
    assert over_frames([0.0] * 8, 3).p_value == 1
    assert np.isfinite(over_frames(np.arange(6.0), 1e9).half_width), "a clip shorter than an eddy"
    for values, eddy in (([], 1), ([1.0, 2.0], np.inf), ([1.0], -1)):
        with pytest.raises(GofError):
            over_frames(values, eddy)
    with pytest.raises(NonFiniteError):
        over_frames([1.0, np.nan], 1)


@pytest.mark.parametrize("count", [24, 36, 48])
@pytest.mark.parametrize("eddy_frames", [0.5, 2.0, 4.0, 8.0])
def test_the_eddy_time_of_a_short_clip_is_that_of_a_long_one(count, eddy_frames):
    history = correlated(count, eddy_frames, 3000).T
    assert integral_time(history) == pytest.approx(eddy_frames, rel=0.08)


def test_eddy_times_at_their_ends():
    assert integral_time(np.ones((24, 5))) == 0, "what never changes has no eddies"
    drift = np.linspace(0, 1, 24)[:, None] * np.ones(5)
    assert integral_time(drift) == np.inf
