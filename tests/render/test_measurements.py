"""The measurement scripts measure what they say: peers draw our picture, phases run, the gradient table is small."""

import numpy as np
import pytest

pytest.importorskip("drjit")

from gof_benchmark.evidence import render_agreement, render_kernels, render_lasting, render_speed


def test_training_step_and_phases_run():
    training = render_speed.Training(300, 48, 32)
    before = np.array(training.optimizer["position"].numpy())
    training.step()
    assert np.abs(np.array(training.optimizer["position"].numpy()) - before).max() > 0
    phases = training.phases(1)
    assert len(phases) == 6 and all(wall > 0 for wall, _ in phases.values())


def test_both_sets_of_kernels_are_timed_in_turn():
    pytest.importorskip("numba")
    figures = render_kernels.measure(300, 48, 32, 1, morton=True)
    assert figures.pop("pairs") > 0
    assert all(len(times) == 1 and times[0] > 0 for kinds in figures.values() for times in kinds.values())
    assert "native" in render_kernels.report("300 Gaussians", figures | {"pairs": 10})


def test_a_long_training_grows_and_its_memory_is_read():
    rows = render_lasting.long_training(101, 100, 48, 32)
    assert [row[:2] for row in rows] == [(100, 102)] and rows[0][2] > 1


@pytest.mark.long
def test_torch_peer_draws_the_same_picture():
    pytest.importorskip("torch")
    ours = np.mean([c.numpy().mean() for c in render_speed.Training(400, 64, 48).draw().color])
    peer = render_speed.torch_peer(400, 64, 48, 1)
    assert peer["mean"] == pytest.approx(ours, rel=0.01)  # it keeps the tails that a 3 sigma radius leaves


@pytest.mark.long
def test_mitsuba_peer_draws_the_same_picture():
    pytest.importorskip("mitsuba")
    ours = np.mean([c.numpy().mean() for c in render_speed.Training(400, 64, 48).draw().color])
    assert render_speed.mitsuba_peer(400, 64, 48, ours=True)["mean"] == pytest.approx(ours, rel=0.1)


@pytest.mark.long
def test_gradient_table_is_small():
    assert max(render_agreement.gradient_table(scenes=1, n=8).values()) < 1e-4
