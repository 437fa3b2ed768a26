"""`gof demo` end to end at toy size through the real parts: real bake, real Cycles, real Dr.Jit, real kill -9."""

import json
import os
import re
import signal
import subprocess
import sys
import time

import pytest

from gof.core.gaussians import TransientGaussians
from tests.test_contracts import OURS, strange

pytestmark = pytest.mark.blender


def spec(folder):
    """The built-in demo scene, coarse: 6 frames of 72x128 pixels, frame 4 held out."""
    from gof_benchmark.scenes import load_scene

    data = load_scene("demo", "toy").to_dict()
    data["clip"] |= {"frames": 6, "warm_up_frames": 40}
    data["domain"]["resolution"] = 32
    data["render"]["percentage"] = 10
    path = folder / "toy.json"
    path.write_text(json.dumps(data))
    return path


def command(folder, scene):
    effort = ["--gaussians", "3000", "--steps", "150"]
    return [sys.executable, "-m", "gof", "demo", "--scene", str(scene), *effort, "--out", str(folder / "demo")]


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """A demo that was killed in the middle of rendering and started again.

    Returns its folder, what was finished before, and what it printed.
    """
    folder = tmp_path_factory.mktemp("run")
    scene = spec(folder)
    cameras = folder / "demo" / "dataset" / "cameras"

    def finished():
        """Files of finished frames; a frame's EXR is written last."""
        frames = [(exr.parent.parent, exr.stem) for exr in cameras.glob("*/exr/0*.exr")]
        files = [
            f / kind / f"{k}.{suffix}"
            for f, k in frames
            for kind, suffix in (("rgb", "png"), ("mask", "png"), ("exr", "exr"))
        ]
        return {p: p.stat().st_mtime_ns for p in files}

    first = subprocess.Popen(command(folder, scene), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 240
    while len(finished()) < 20 and time.monotonic() < deadline:  # 108 files in all, with those from all around
        time.sleep(0.02)
    os.kill(first.pid, signal.SIGKILL)
    first.wait()
    time.sleep(1)  # a worker that had survived would go on writing
    before = finished()
    assert 20 <= len(before) < 108, "the kill must fall into the rendering"
    done = subprocess.run(command(folder, scene), capture_output=True, text=True, timeout=500)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
    return folder, before, done.stdout


def test_no_finished_frame_is_made_again(demo):
    _, before, _ = demo
    for path, when in before.items():
        assert path.stat().st_mtime_ns == when, f"{path} was finished before the kill and written again"


def test_scores_beat_random_and_still_velocities_and_the_plate(demo):
    folder, _, _ = demo
    scores = json.loads((folder / "demo" / "scores.json").read_text())
    assert scores["dve"]["l2"] < min(
        scores["trivial_baselines"]["zero"]["l2"], scores["trivial_baselines"]["random"]["l2"]
    )
    assert scores["dve"]["cos_sim"] > scores["trivial_baselines"]["random"]["cos_sim"] + 0.3
    assert scores["psnr_flame"] > scores["psnr_flame_plate"] + 6
    assert len(scores["around"]) == 9 and min(view["psnr_flame"] for view in scores["around"]) > 8
    stages = {s["name"]: s for s in scores["stages"]}
    assert {"bake", "render", "ground-truth", "motion", "flow_field", "optimize", "evaluate", "import"} <= set(stages)
    assert all(s["seconds"] > 0 and s["peak_mb"] > 50 for s in stages.values())


def test_everything_a_newcomer_opens_is_there(demo):
    out = demo[0] / "demo"
    page = (out / "report.html").read_text()
    assert page.count("data:image/") >= 23 and "From all around" in page and "Flame PSNR (higher is better)" in page
    assert 'src="http' not in page
    tiles = re.findall(r"<div(?: class=\"\w+\")?>([a-zA-Z ]+)[^<]*<b>", page.partition('class="hero"')[0])
    assert tiles == ["motion error ", "speed over true speed ", "flame PSNR", "time it took"]
    assert "from other sides (55° to 144°)" in page and str(demo[0]) not in page
    assert (out / "preview.png").stat().st_size > 1000
    player = (out / "share.html").read_text()
    assert "<canvas" in player and '"name":"reconstruction"' in player and "http://" not in player
    assert len(TransientGaussians.load(out / "reconstruct" / "result.ply")) > 1000


def test_the_blend_opens_and_holds_scene_and_cloud(demo):
    out = demo[0] / "demo"
    code = f"""
import bpy, numpy as np, os
bpy.ops.wm.open_mainfile(filepath={str(out / "result.blend")!r})
names = {{o.type for o in bpy.data.objects}}
assert 'CAMERA' in names and sum(o.type == 'MESH' for o in bpy.data.objects) > 10, names
cloud = next(o for o in bpy.data.objects if any(m.type == 'NODES' for m in o.modifiers) and len(o.data.vertices) > 1000)
print('cloud of', len(cloud.data.vertices), flush=True); os._exit(0)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0 and "cloud of" in done.stdout, done.stdout + done.stderr


def test_a_third_start_does_nothing(demo):
    folder = demo[0]
    times = {
        p: p.stat().st_mtime_ns for p in (folder / "demo").rglob("*") if p.is_file() and p.name not in ("scores.json",)
    }
    done = subprocess.run(command(folder, folder / "toy.json"), capture_output=True, text=True, timeout=120)
    assert done.returncode == 0 and done.stdout.count("finished before") == 6
    assert {p: p.stat().st_mtime_ns for p in times} == times


def test_every_file_holds_its_record(demo):
    """Real writers against the records: each JSON file of the run has a known schema and exactly its fields."""
    found = set()
    for path in sorted(demo[0].rglob("*.json")):
        data = json.loads(path.read_text()) if "zarr" not in str(path) and ".cache" not in path.parts else {}
        if data.get("schema") in OURS:
            found.add(data["schema"])
            if path.name == "scores.json":
                data.pop("stages")  # the demo adds what its stages cost
            assert not strange(data, OURS[data["schema"]]), path
    assert found >= {"gof-dataset", "gof-scores", "gof-costs", "gof-curve", "gof-captions", "gof-preview"}
