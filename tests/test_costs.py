"""`costs.json`: one entry per stage, and the clock time of all runs."""

import pytest

from gof.costs import StageLog


def test_log_replaces_and_adds_up(tmp_path):
    log = StageLog(tmp_path / "costs.json")
    log.record("bake", 2.0, 100, {"cells": 3})
    log.record("render", 1.0, 50)
    log.record("bake", 3.0, 80, resumed=True)
    log.record("render", 4.0, 60)
    assert [(s.name, s.seconds, s.peak_mb) for s in log.stages()] == [("bake", 5.0, 100), ("render", 4.0, 60)]
    with pytest.raises(ZeroDivisionError), log.measure("broken"):
        1 / 0
    assert len(log.stages()) == 2, "a failed stage is not recorded"
