"""One scene's rows in full, on the submissions of tests/suite/test_entering.py."""

import json

import numpy as np
import pytest

from gof_benchmark.evidence.baseline_rows import table
from tests.suite.test_entering import SCENES, work  # noqa: F401


def test_a_scenes_rows_in_full(work):  # noqa: F811
    """Means over the runs of what `gof evaluate` gave, and the trivial baselines on the Gaussians of a flame alone."""
    for method in ("good", "bad"):
        lines = [line.split(" | ") for line in table([work / method], SCENES[0]).splitlines()]
        heads = dict(zip(lines[0], zip(*lines[2:7], strict=True), strict=False))
        runs = [json.loads(path.read_text()) for path in (work / method / SCENES[0]).rglob("scores.json")]
        assert len(runs) == (2 if method == "good" else 1)
        known = {
            "DVE L2": runs[0]["trivial_baselines"]["constant"]["l2"],
            "DVE CosSim": runs[0]["trivial_baselines"]["constant"]["cos_sim"],
        }
        for head, of, digits in (
            ("DVE L2", lambda run: run["dve"]["l2"], 3),
            ("in the domain CosSim", lambda run: run["dve"]["inside"]["cos_sim"], 3),
            ("in the domain L2", lambda run: run["dve"]["inside"]["l2"], 3),
            ("PSNR flame (dB)", lambda run: run["psnr_flame"], 2),
        ):
            assert float(heads[head][0]) == pytest.approx(np.mean([of(run) for run in runs]), abs=0.6 * 10**-digits)
        for head, value in known.items():
            assert lines[4][0] == "| trivial: constant" and float(heads[head][2]) == pytest.approx(value, abs=6e-4)
