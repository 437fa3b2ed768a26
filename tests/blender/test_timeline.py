"""When lines see the fire: weights of solver steps for instants, open shutters, rolling readout and clocks."""

import numpy as np
import pytest

from gof_blender.pure.effects import clock, motion_blur, rolling_shutter
from gof_blender.pure.spec import Render, SceneSpec
from gof_blender.pure.timing import Clip, step_weights

SPEC = SceneSpec("x", clip=Clip(frames=3, fps=100.0, warm_up_frames=3), render=Render(percentage=10))


def with_effects(*effects) -> SceneSpec:
    return SceneSpec("x", clip=SPEC.clip, render=SPEC.render, effects=effects)


def test_nothing_listed_is_one_step_with_weight_one():
    assert SPEC.timeline.steps_per_frame == 1
    first, weights = SPEC.timeline.weights(0, 2)
    assert first == 0 and weights.shape == (1, 72) and (weights == 1).all()


@pytest.mark.parametrize("length", [0.0, 1e-9, 0.3, 1.0, 2.7])
def test_weights_integrate_linear_functions_exactly(length):
    start = np.linspace(-3.2, 5.1, 41)
    first, weights = step_weights(start, length)
    assert (weights >= 0).all() and np.isfinite(weights).all()
    np.testing.assert_allclose(weights.sum(0), 1, atol=1e-12)
    steps = first + np.arange(len(weights))
    np.testing.assert_allclose(steps @ weights, start + length / 2, atol=1e-8)  # the mean of t itself


def test_open_shutter_is_centred_on_the_frame():
    first, weights = with_effects(motion_blur.Settings(shutter=0.5, steps=4)).timeline.weights(0, 1)
    # Open from one step before the frame's own to one after it; linear between the three: the trapezoidal rule.
    assert first == -1
    np.testing.assert_allclose(weights, np.tile([[0.25], [0.5], [0.25]], 72), atol=1e-12)


def test_rolling_readout_moves_on_line_by_line():
    spec = with_effects(rolling_shutter.Settings(readout_s=0.005, steps=4))
    first, weights = spec.timeline.weights(0, 0)
    seen = (first + np.arange(len(weights))) @ weights / 400.0  # seconds
    np.testing.assert_allclose(seen, np.arange(72) * 0.005 / 72, atol=1e-12)
    assert (np.count_nonzero(weights, axis=0) <= 2).all(), "a line needs no more than its two neighbouring steps"


def test_clocks_differ_between_cameras_and_repeat():
    spec = with_effects(clock.Settings(offset_s=0.002, jitter_s=0.0005))
    delays = np.array([[spec.timeline.timing(c, k).delay for k in range(3)] for c in range(3)])
    assert len(np.unique(delays)) == 9 and np.abs(delays).max() < 3 * 0.0025
    again = [[spec.timeline.timing(c, k).delay for k in range(3)] for c in range(3)]
    np.testing.assert_array_equal(delays, again)
    steady = with_effects(clock.Settings()).timeline
    assert len({steady.timing(c, k).delay for c in range(3) for k in range(3)}) == 3, "one offset per camera"


def test_simulation_covers_everything_a_shutter_sees():
    spec = with_effects(motion_blur.Settings(), rolling_shutter.Settings(0.01), clock.Settings(0.004))
    for camera in range(3):
        for frame in range(3):
            first, weights = spec.timeline.weights(camera, frame)
            own = spec.timeline.blender_frame(frame)
            assert own + first >= max(1, spec.timeline.earliest_seen)
            assert own + first + len(weights) - 1 <= spec.timeline.last_frame
