"""Closed forms against Monte Carlo, and the study's claims on a small run."""

import json

import numpy as np
import pytest

from gof.core.rotations import rotation_matrices
from gof_benchmark.evidence.dve_orders import LINES, abc, gaussian_vortex, gaussians, linear, main, taylor_green
from tests.look.printed import marks, texts

pytestmark = pytest.mark.long


@pytest.mark.parametrize("flow", [linear(), taylor_green(10.0), abc(10.0), gaussian_vortex(0.15)], ids=lambda f: f.name)
def test_closed_forms_against_a_million_samples(flow):
    x, s, q = gaussians(4, 1.2, 10.0)
    axes = rotation_matrices(q) * s[:, None, :]
    rng = np.random.default_rng(0)
    truth = flow.mean(x, axes @ axes.transpose(0, 2, 1))
    for i in range(len(x)):
        draws = flow.velocity(x[i] + rng.standard_normal((1_000_000, 3)) @ axes[i].T)
        assert (np.abs(draws.mean(0) - truth[i]) < 5 * draws.std(0) / 1000 + 1e-12).all()


def test_the_study_shows_what_it_claims(tmp_path, capsys):
    main(["--out", str(tmp_path), "--gaussians", "1000", "--samples", "10000"])
    assert "Expected velocity" in capsys.readouterr().out
    rows = json.loads((tmp_path / "study_dve.json").read_text())["rows"]
    error = {(r["study"], r["flow"], r["setting"], r["k_sigma"]): r["error"] for r in rows}
    for order in (1, 3, 5, 7):
        assert error["order", "linear", f"order {order}", 1.5] < 1e-13  # exact at any order
    for flow in ("Taylor-Green", "ABC", "Gaussian vortex"):
        for k_sigma in (0.25, 0.5, 1.0):
            falling = [error["order", flow, f"order {n}", k_sigma] for n in (1, 3, 5, 7)]
            assert falling == sorted(falling, reverse=True) and falling[3] < 1e-3
        assert error["grid", flow, "128^3 order 3", 0.5] < error["grid", flow, "32^3 order 3", 0.5] / 8
        assert (
            error["precision", flow, "float32 kernel", 0.5]
            < 1e-6
            < error["precision", flow, "float16 kernel", 0.5]
            < 1e-3
        )
    drawn = {(study, k_sigma) for study, k_sigma, _ in LINES}
    charts = {path.stem: path.read_text() for path in tmp_path.glob("*.svg")}
    assert sorted(charts) == [
        "study_dve_abc",
        "study_dve_gaussian_vortex",
        "study_dve_linear",
        "study_dve_taylor-green",
    ]
    assert "Monte Carlo, 100 to 1 000 000 samples" in texts(charts["study_dve_abc"])
    in_linear = [r for r in rows if r["flow"] == "linear" and (r["study"], r["k_sigma"]) in drawn]
    in_linear = [r for r in in_linear if r["study"] != "grid" or r["setting"].endswith("order 3")]
    assert sum(map(len, marks(charts["study_dve_linear"]).values())) == len(in_linear) == 12
    assert all(r["seconds"] > 0 for r in rows)
