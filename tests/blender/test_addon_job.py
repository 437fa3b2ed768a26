"""The Benchmark panel's job: goes on after a stop, ends with Blender, says why it failed, asks before it ends."""

import sys
import time
from dataclasses import replace

import pytest

from gof.core.costs import StageLog
from gof.dataset import Dataset
from gof_blender.pure import spec as scene_spec
from gof_blender.pure.dataset_process import Job, JobError, left_s
from gof_blender.pure.layout import Layout
from tests.blender.runs import TOY
from tests.blender.test_addon_fire import in_addon

pytest.importorskip("bpy", reason="the add-on's operators need the bpy wheel")
PYTHON = [sys.executable, "-c"]


@pytest.mark.blender
def test_a_stopped_job_goes_on(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))  # runs of this machine say nothing of how far it is
    layout = Layout(tmp_path / "stopped")
    layout.claim(TOY)
    job, fractions = Job(TOY, layout, PYTHON), [0.0]
    while not (job.stage == "render" and len(list(layout.root.glob("cameras/*/exr/0*.exr"))) >= 4):
        assert job.poll()
        fractions.append(job.fraction)
        assert job.seconds_left >= 0 and str(job)
        time.sleep(0.05)
    assert f" of {3 * (1 + TOY.clip.frames)} pictures" in str(job), "the plates of the three cameras count"
    process = job._process
    job.stop()
    assert process.poll() is not None and not layout.description.exists()
    assert fractions == sorted(fractions) and 0.2 < fractions[-1] < 1
    before = {path: path.stat().st_mtime_ns for path in layout.root.glob("cameras/*/exr/0*.exr")}
    StageLog(layout.costs).record("finish", 50.0, 1.0, {"wall_s": 50.0})  # as an earlier run would have
    Job(TOY, layout, PYTHON).run()
    finish = next(cost for cost in StageLog(layout.costs).stages() if cost.name == "finish")
    assert 50 < finish.seconds < 150 and finish.settings["wall_s"] == pytest.approx(finish.seconds, abs=2e-3)
    assert all(path.stat().st_mtime_ns == then for path, then in before.items()), (
        "finished pictures were not made again"
    )
    assert Dataset.open(layout.root).description.spec == TOY.to_dict()
    assert "stopped in render" in layout.job_log.read_text() and layout.job_log.read_text().count("bake ...") == 1


@pytest.mark.blender
def test_a_stopped_bake_goes_on(tmp_path):
    layout = Layout(tmp_path / "kept")
    layout.claim(TOY)
    job = Job(TOY, layout, PYTHON)
    expected = left_s(TOY, layout, {"bake": 100.0, "render": 1.0})["bake"]
    while layout.newest_step() < 8:
        assert job.poll() and job.stage == "bake"
        time.sleep(0.01)
    job.stop()
    assert not layout.bake_marker.exists()
    kept = layout.cached_velocity(6).stat().st_mtime_ns
    assert left_s(TOY, layout, {"bake": 100.0, "render": 1.0})["bake"] < 0.7 * expected
    Job(TOY, layout, PYTHON).run()
    assert layout.description.is_file() and "stopped in bake" in layout.job_log.read_text()
    assert kept < layout.bake_begun.stat().st_mtime_ns


@pytest.mark.blender
def test_a_job_ends_with_the_process_that_started_it(tmp_path):
    import os
    import signal
    import subprocess

    spec = replace(TOY, domain=replace(TOY.domain, resolution=96))
    layout = Layout(tmp_path / "orphan")
    layout.claim(spec)
    script = f"""
import time
from pathlib import Path
from gof_blender.pure import spec
from gof_blender.pure.dataset_process import Job
from gof_blender.pure.layout import Layout
layout = Layout(Path({str(layout.root)!r}))
job = Job(spec.load(layout.spec), layout, {PYTHON!r})
while job.poll():
    print(job._process.pid, flush=True)
    time.sleep(0.1)
"""
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True) as parent:
        child = int(parent.stdout.readline())
        while not layout.blend.is_file():
            time.sleep(0.1)
        parent.send_signal(signal.SIGKILL)
    end = time.monotonic() + 20
    while time.monotonic() < end:
        try:
            os.kill(child, 0)
        except ProcessLookupError:
            break
        time.sleep(0.1)
    else:
        os.kill(child, signal.SIGKILL)
        pytest.fail("the child outlived its parent")


@pytest.mark.blender
def test_failed_stage_says_why(tmp_path):
    spec = replace(TOY, display=scene_spec.Display(look="Nonsense"))
    layout = Layout(tmp_path / "failing")
    layout.claim(spec)
    with pytest.raises(JobError, match=r"bake failed with status 2:\n.*display.look must be one of .*'Very High"):
        Job(spec, layout, PYTHON).run()
    assert "display.look" in layout.job_log.read_text()


@pytest.mark.blender
def test_esc_asks_and_playback_keeps_its_key():
    """The events as Blender hands them to a running operator; a person's own presses: tools/addon_screenshots.py."""
    found = in_addon("""
        from types import SimpleNamespace
        from gof_blender.ui import job_operator
        asked, ended = [], []
        real = job_operator.bpy
        job_operator.bpy = SimpleNamespace(ops=SimpleNamespace(gof=SimpleNamespace(stop_benchmark=asked.append)))
        class Job:
            def poll(self): return True
            def stop(self): ended.append("stopped")
            def __str__(self): return "bake 3 of 9"
        class Operator(job_operator.JobOperator):
            bl_label, job = "Bake", Job()
            def report(self, kind, text): ended.append(text)
        class Asking(Operator):
            ask, job = "gof.stop_benchmark", Job()
        def context(playing):
            window = SimpleNamespace(screen=SimpleNamespace(is_animation_playing=playing, areas=[]))
            manager = SimpleNamespace(windows=[window], event_timer_remove=lambda timer: None)
            return SimpleNamespace(window_manager=manager, workspace=SimpleNamespace(status_text_set=ended.append))
        escape = SimpleNamespace(type="ESC", value="PRESS")
        result["playing"] = [list(Asking().modal(context(True), escape)), list(asked), list(ended)]
        result["asked"] = [list(Asking().modal(context(False), escape)), list(asked), list(ended)]
        quick = Operator()
        quick._timer = None
        result["quick playing"] = list(quick.modal(context(True), escape))
        result["quick"] = [list(quick.modal(context(False), escape)), list(ended)]
        job_operator.bpy = real
    """)
    assert found["playing"] == [["PASS_THROUGH"], [], []], "Blender ends the playback"
    assert found["asked"] == [["RUNNING_MODAL"], ["INVOKE_DEFAULT"], []], "the job goes on"
    assert found["quick playing"] == ["PASS_THROUGH"]
    assert found["quick"] == [["CANCELLED"], ["stopped", None, "Stopped"]]
