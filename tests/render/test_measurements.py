"""The measurement scripts measure what they say: the peers draw our picture, the phases run, the gradient table is small."""

import numpy as np
import pytest

pytest.importorskip("drjit")

from gof_benchmark.evidence import render_agreement, render_speed


def test_training_step_and_phases_run():
    training = render_speed.Training(300, 48, 32)
    before = np.array(training.optimizer["position"].numpy())
    training.step()
    assert np.abs(np.array(training.optimizer["position"].numpy()) - before).max() > 0
    phases = training.phases(1)
    assert len(phases) == 6 and all(wall > 0 for wall, _ in phases.values())


def test_torch_peer_draws_the_same_picture():
    pytest.importorskip("torch")
    ours = np.mean([c.numpy().mean() for c in render_speed.Training(400, 64, 48).draw().color])
    peer = render_speed.torch_peer(400, 64, 48, 1)
    assert peer["mean"] == pytest.approx(ours, rel=0.01)  # it keeps the tails that a 3 sigma radius leaves


def test_mitsuba_peer_draws_the_same_picture():
    pytest.importorskip("mitsuba")
    ours = np.mean([c.numpy().mean() for c in render_speed.Training(400, 64, 48).draw().color])
    assert render_speed.mitsuba_peer(400, 64, 48, ours=True)["mean"] == pytest.approx(ours, rel=0.1)


def test_gradient_table_is_small():
    assert max(render_agreement.gradient_table(scenes=1, n=8).values()) < 1e-4


def test_report_prints_every_goal():
    t = (1.0, 2.0)
    row = {"n": 10, "width": 4, "height": 4, "pairs": 1, "wall_ms": 1.0, "cpu_ms": 1.0, "compiled_late": 0}
    kernel = {"ns_per_pair": 1.0, "limit_ns": 0.5, "ops": 26}
    text = render_speed.report(
        {
            "scene": [1, 2, 3],
            "pairs": 4,
            "machine": {"cpu": "x", "threads": 2},
            "phases": {"project": t},
            "step": t,
            "forward": t,
            "both": t,
            "one_thread": {"step_ms": 1.0, "both_ms": 1.0, "fma_per_ns": 80.0},
            "mean": 0.1,
            "fma_per_ns": 80.0,
            "kernels": {"forward": kernel, "backward": kernel},
            "mitsuba": {"its own settings": {"forward": (80.0, 80.0), "both": (80.0, 80.0), "mean": 0.1}},
            "torch": {"scene": [1, 2, 3], "peer": {"forward": t, "both": (300.0, 300.0)}, "ours_both": t},
            "growth": [row],
            "exponents": {"cpu ~ N^": 0.5},
        }
    )
    assert "80x" in text and "150x" in text and "50%" in text and "N^0.50" in text
