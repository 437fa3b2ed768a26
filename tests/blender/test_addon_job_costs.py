"""What the Benchmark panel expects of a job, and what it writes down of its costs, for the library to read."""

from dataclasses import replace

import pytest

import gof.core.costs
from gof.core.records import read_record
from gof_blender.pure import cost_model
from gof_blender.pure.costs import Costs, StageCost
from gof_blender.pure.dataset_process import expected_s, left_s, stages
from gof_blender.pure.effects import video_compression
from gof_blender.pure.layout import Layout
from tests.blender.runs import TOY


def test_expected_times_and_stages():
    coded = replace(TOY, effects=(video_compression.Settings(),), ground_truth=("flow",))
    assert stages(coded) == ["bake", "render", "video", "ground-truth", "flow", "finish"]
    prediction = cost_model.predict(coded, cost_model.REFERENCE)
    times = expected_s(coded, prediction)
    assert list(times) == stages(coded) and all(seconds > 0 for seconds in times.values())
    assert sum(times.values()) >= prediction.total_s


def test_costs_add_up_and_the_library_reads_them(tmp_path):
    path = tmp_path / "costs.json"
    for seconds, peak, clock_s in ((2.0, 300.0, 2.5), (1.0, 200.0, 1.25)):
        Costs.read(path).adding(StageCost("bake", seconds, peak, {"steps": 5}), clock_s).write(path)
    Costs.read(path).adding(StageCost("render", 4.0, 100.0), 4.5).write(path)
    read = read_record(gof.core.costs.Costs, path)
    assert [(s.name, s.seconds, s.peak_mb, s.settings) for s in read.stages] == [
        ("bake", 3.0, 300.0, {"steps": 5, "wall_s": 3.0}),
        ("render", 4.0, 100.0, {"wall_s": 4.0}),
    ]
    assert read.wall_s == 8.25, "by the clock, what lies between the stages too"


def test_costs_of_the_library_go_on_here(tmp_path):
    path = tmp_path / "costs.json"
    gof.core.costs.StageLog(path).record("bake", 3.0, 300.0, {"steps": 5, "wall_s": 2.0})
    before = read_record(gof.core.costs.Costs, path).wall_s
    Costs.read(path).adding(StageCost("bake", 1.0, 100.0, {"steps": 5}), 1.5).write(path)
    (stage,) = read_record(gof.core.costs.Costs, path).stages
    assert (stage.seconds, stage.peak_mb, stage.settings["wall_s"]) == (4.0, 300.0, 3.0)
    assert read_record(gof.core.costs.Costs, path).wall_s == pytest.approx(before + 1.5, abs=1e-3)


def test_what_is_left_is_not_paid_again(tmp_path):
    layout = Layout(tmp_path)
    expected = expected_s(TOY, cost_model.predict(TOY, cost_model.REFERENCE))
    assert left_s(TOY, layout, expected) == expected
    layout.hidden.mkdir()
    layout.bake_marker.write_text("{}")
    for camera in ("cam_0", "cam_1", "cam_2"):
        path = layout.frame(camera, 0).exr
        path.parent.mkdir(parents=True)
        path.touch()
    left = left_s(TOY, layout, expected)
    assert left["bake"] == 0 and left["render"] == pytest.approx(expected["render"] * 4 / 5)
    assert left["ground-truth"] == expected["ground-truth"]
