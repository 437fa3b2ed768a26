"""The camera's clock with any pattern of dropped and repeated frames."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gof.capture import clock

PERIOD = 4000.0


def positions(pattern):
    return np.concatenate([[0], np.cumsum(pattern)]), np.concatenate([[False], np.array(pattern) == 0])


def times(index, repeated, interval, noise, seed):
    """Noisy times of frames at these positions; a repeated picture has its original's."""
    time = 1e6 + interval * index + np.random.default_rng(seed).normal(0, noise, len(index))
    for k in np.flatnonzero(repeated):
        time[k] = time[k - 1]
    return time


def test_fifteen_seconds_with_thirty_drops_a_pause_and_a_drifting_interval():
    rng = np.random.default_rng(0)
    pattern = np.ones(5999, int)
    pattern[rng.choice(5999, 30, replace=False)] = rng.integers(2, 6, 30)
    pattern[2000] = 500
    index, repeated = positions(pattern)
    time = times(index, repeated, 2500.03, 20.0, 0)  # 0.2 ms over the clip
    time[rng.choice(6000, 60, replace=False)] += PERIOD
    np.testing.assert_array_equal(clock.link(time, 2500.0, repeated, PERIOD, counted=True), index)


# Position steps of 120 frames: 1 as a rule, 0 repeated, 2 to 4 after drops. What happens beside the clip's ends is left
# open to noise, so there is nothing.
steps = st.lists(st.sampled_from([1] * 12 + [0, 2, 3, 4]), min_size=115, max_size=115).map(lambda s: [1, 1, *s, 1, 1])
intervals = st.sampled_from([2500.0, 1e6 / 240, 1e6 / 120])


@settings(max_examples=150, deadline=None)
@given(steps, intervals, st.integers(0, 1000), st.floats(-0.2, 0.2))
@pytest.mark.long
def test_any_drops_and_repeats_are_found(pattern, interval, seed, wrong_interval):
    """With counted times, even where single counts are wrong and the interval is a little off."""
    index, repeated = positions(pattern)
    time = times(index, repeated, interval, 10.0, seed)
    rng = np.random.default_rng(seed)
    # Between two drops a misread frame could be in either gap; elsewhere its neighbours tell.
    for k in rng.choice(np.arange(4, 114, 9), 5, replace=False):
        if pattern[k - 2 : k + 2] == [1, 1, 1, 1]:
            time[k] += PERIOD * rng.choice([-1, 1])
    found = clock.link(time, interval + wrong_interval, repeated, PERIOD, counted=True)
    np.testing.assert_array_equal(found, index)


@settings(max_examples=150, deadline=None)
@given(st.integers(0, 7), st.integers(0, 7), intervals, st.integers(0, 1000))
@pytest.mark.long
def test_without_counts_drops_below_a_cycle_are_found(first, second, interval, seed):
    """At 2500 us eight frames fill five periods: up to seven missing ones are seen by the phase alone."""
    pattern = [1] * 20 + [0] + [1] * 30 + [1 + first] + [1] * 12 + [1 + second] + [1] * 40
    index, repeated = positions(pattern)
    phase = times(index, repeated, interval, 5.0, seed) % PERIOD
    np.testing.assert_array_equal(clock.link(phase, interval, repeated, PERIOD, counted=False), index)


@settings(max_examples=100, deadline=None)
@given(st.lists(st.floats(-2000, 2000), min_size=1, max_size=12), st.booleans(), st.integers(0, 1000))
@pytest.mark.long
def test_wrong_single_times_are_not_drops(wrong, counted, seed):
    index, repeated = positions([1] * 95)
    time = times(index, repeated, 2500.0, 5.0, seed)
    time[np.random.default_rng(seed).choice(np.arange(2, 94, 7), len(wrong), replace=False)] += wrong
    np.testing.assert_array_equal(
        clock.link(time if counted else time % PERIOD, 2500.0, repeated, PERIOD, counted), index
    )


def test_unwrap_follows_drops_and_repeats():
    index, repeated = positions([1] * 9 + [3, 1, 0, 1, 8, 1])
    time = times(index, repeated, 2500.0, 0.0, 0)
    unwrapped = clock.unwrap(time % PERIOD, index, 2500.0, PERIOD)
    np.testing.assert_allclose(np.diff(unwrapped), np.diff(time), atol=1e-6)


@settings(max_examples=100, deadline=None)
@given(st.floats(1000, 35_000), st.integers(0, 1000))
def test_interval_from_counter_and_phase(interval, seed):
    rng = np.random.default_rng(seed)
    time = 1e6 * rng.random() + interval * np.arange(64)
    count, phase = np.floor(time / PERIOD), time % PERIOD
    found = clock.estimate_interval(count, phase + rng.normal(0, 5, 64), PERIOD)
    assert abs(found - interval) < 5
