"""What the Benchmark panel expects of a job, and what it writes down of its costs, for the library to read."""

from dataclasses import replace

import pytest

from gof_blender.pure import cost_model
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
