"""`costs.json`: one entry per stage, and the clock time of all runs."""

import json

import pytest

from gof.core.costs import StageLog
from gof.core.errors import DataFormatError


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


def test_wall_s_is_the_clock_of_all_runs_and_not_a_sum_of_stages(tmp_path, monkeypatch):
    """Stages of several processes overlap, and a second run adds to the first."""
    clock = iter([100.0, 103.0, 104.0, 500.0, 502.0])  # made, two records; made again, one record
    monkeypatch.setattr("gof.core.costs.time.perf_counter", lambda: next(clock))
    first = StageLog(tmp_path / "costs.json")
    first.record("bake", 2.0, 100)
    first.record("render", 9.0, 50)
    assert first.costs().wall_s == 4.0
    second = StageLog(tmp_path / "costs.json")
    second.record("render", 1.0, 50, resumed=True)
    assert second.costs().wall_s == 6.0
    assert json.loads((tmp_path / "costs.json").read_text())["wall_s"] == 6.0


def test_a_file_of_another_kind_is_refused(tmp_path):
    (tmp_path / "costs.json").write_text('{"schema": "gof-curve", "version": 1, "stages": []}')
    with pytest.raises(DataFormatError, match=r"costs\.json: not schema 'gof-costs' version 1"):
        StageLog(tmp_path / "costs.json").stages()
