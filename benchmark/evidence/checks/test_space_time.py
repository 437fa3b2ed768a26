"""The slope of traces in height against time, on traces whose slope is known."""

import numpy as np
import pytest

from gof_benchmark.evidence.rise_speed import climb

HEIGHT, FRAME_S = 160, 0.01


def rising(speed, frames=36, life=8.0, standing=0.0, seed=0):
    """(T, H) blobs that climb at `speed` px per frame, come and go, in the light of a flame that stands."""
    rng = np.random.default_rng(seed)
    rows, times = np.arange(HEIGHT), np.arange(frames)[:, None]
    light = np.exp(-0.5 * ((rows - 110) / 30.0) ** 2) * np.ones((frames, 1)) * 2
    for _ in range(150):
        start, when, amount = rng.uniform(-50, HEIGHT + 50), rng.uniform(-10, frames + 10), rng.uniform(0.1, 0.4)
        place = start - (speed if rng.random() >= standing else 0) * (times - when)
        light += amount * np.exp(-0.5 * ((times - when) / life) ** 2 - 0.5 * ((rows - place) / 3.0) ** 2)
    return light


@pytest.mark.parametrize("speed", [1.0, 2.0, 5.0])
def test_climbing_blobs(speed):
    found = np.mean([climb(rising(speed, seed=seed), FRAME_S) for seed in range(3)])
    assert found == pytest.approx(speed / FRAME_S, rel=0.08)


def test_drawn_oftener_it_is_the_same_speed():
    often = rising(0.5, frames=144, life=32.0)
    assert climb(often, FRAME_S / 4, (8, 12, 16, 20, 24)) == pytest.approx(200, rel=0.08), "0.5 px in 2.5 ms"


def test_blobs_that_only_come_and_go_do_not_climb():
    assert climb(rising(3.0, standing=1.0), FRAME_S) < 0.3 / FRAME_S


def test_nothing_to_measure():
    assert np.isnan(climb(np.ones((36, HEIGHT)), FRAME_S)), "a steady flame"
    assert np.isnan(climb(rising(2.0, frames=3), FRAME_S)), "too short"
