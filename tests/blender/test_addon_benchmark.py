"""The Benchmark panel: the same dataset as `gof generate` makes, resumed after a stop, refused when it cannot be."""

import json
import shutil
import sys
from dataclasses import replace

import cv2
import numpy as np
import pytest

import gof.core.costs
from gof.core.records import read_record
from gof.dataset import Dataset
from gof_benchmark.commands import generate
from gof_blender.pure import dataset_process
from gof_blender.pure import spec as scene_spec
from gof_blender.pure.dataset_process import stages
from gof_blender.pure.layout import Layout
from tests.blender.runs import TOY
from tests.blender.test_addon_fire import in_addon

pytest.importorskip("bpy", reason="the add-on's operators need the bpy wheel")
PYTHON = [sys.executable, "-c"]


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Layout:
    """A dataset of the default scene, made by the operator; tests must not change it."""
    folder = tmp_path_factory.mktemp("addon") / "cube fire"
    found = in_addon(
        """
        fire.spot = "OBJECT"
        bpy.context.view_layer.objects.active = bpy.data.objects["Cube"]
        bpy.ops.gof.add_fire(); bpy.ops.gof.add_cameras()
        place.cameras(scene)[1].location.z += 0.2
        fire.effects.wind.use = True
        bpy.ops.gof.add_fire()
        scene.gof.benchmark.preset, scene.gof.benchmark.folder = "toy", sys.argv[1]
        result["made"] = list(bpy.ops.gof.bake_render())
        result["again"] = list(bpy.ops.gof.bake_render())
        fire.seed = 7
        result["other"] = message(bpy.ops.gof.bake_render)
        result["objects"] = len(scene.objects)
        """,
        folder,
    )
    assert found["made"] == found["again"] == ["FINISHED"]
    assert "was made from another spec (seed differ)" in found["other"]
    return Layout(folder)


@pytest.mark.blender
def test_dataset_of_the_users_scene(made):
    dataset = Dataset.open(made.root)
    assert (dataset.description.name, dataset.description.effects) == ("cube fire", ("vorticity", "wind"))
    spec = dataset.description.spec
    assert spec["blend_file"] == {"path": "background.blend", "empty": "Fire"}, "the folder can be moved"
    assert spec["display"]["view_transform"] == "AgX", "as the user's scene"
    assert (
        dataset.velocity.at(0.0).velocity.shape == (12, 12, 24, 3)
        and dataset.velocity.at(0.02).velocity[..., 2].max() > 0.3
    )
    heights = [camera.position[2] for camera in dataset.cameras]
    np.testing.assert_allclose(heights, [0.9, 1.1, 0.9], atol=1e-5)
    assert dataset.static(1)[-1].mean() > 1.3 * dataset.static(1)[0].mean(), "the lit cube is below, the world above"
    assert dataset.mask(1, 3).sum() > 3
    costs = read_record(gof.core.costs.Costs, made.costs)
    log = {cost.name: cost for cost in costs.stages}
    assert list(log) == ["bake", "render", "ground-truth", "finish"] == stages(scene_spec.load(made.spec))
    assert all(cost.seconds > 0 and 100 < cost.peak_mb < 2000 for cost in log.values())
    assert costs.wall_s > sum(cost.seconds for cost in costs.stages), "by the clock: one process after another"
    page = made.report.read_text()
    assert page.count("<img") == 3 * 5 and "cube fire" in page
    sources = [part.split('"')[0] for part in page.split('src="')[1:]]
    assert all((made.root / source).is_file() for source in sources)
    assert "finished" in made.job_log.read_text()


@pytest.mark.blender
def test_it_is_what_gof_generate_makes_of_the_spec(made, tmp_path):
    for name in ("spec.json", "background.blend"):
        shutil.copy(made.root / name, tmp_path)
    assert generate.main([str(tmp_path / "spec.json"), "--out", str(tmp_path / "again")]) == 0
    ours, theirs = Dataset.open(made.root), Dataset.open(tmp_path / "again")
    for name in ("time_s", "splits", "effects", "provenance", "cameras", "velocity"):
        assert getattr(ours.description, name) == getattr(theirs.description, name), name
    for frame, time_s in enumerate(ours.times_s):
        np.testing.assert_array_equal(ours.velocity.at(time_s).velocity, theirs.velocity.at(time_s).velocity)
        for camera in range(3):
            np.testing.assert_array_equal(ours.image(camera, frame), theirs.image(camera, frame))


@pytest.mark.blender
def test_what_cannot_be_made_is_refused_with_a_remedy(tmp_path):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "letter.txt").write_text("mine")
    (tmp_path / "broken.json").write_text("{")
    huge = replace(TOY, domain=replace(TOY.domain, size=(1.6, 1.6, 1.6)))
    scene_spec.save(huge, tmp_path / "huge.json")
    found = in_addon(
        """
        settings, folder = scene.gof.benchmark, sys.argv[1]
        press = lambda: message(bpy.ops.gof.bake_render)
        result["unsaved"] = press()
        settings.folder = folder + "/new"
        result["no fire"] = press()
        bpy.ops.gof.add_fire()
        settings.folder = folder + "/full"
        result["full"] = press()
        settings.folder, settings.background = folder + "/new", "file"
        result["no file"] = press()
        settings.spec_file = folder + "/broken.json"
        result["broken"] = press()
        settings.spec_file, settings.preset = folder + "/huge.json", "full"
        from gof_blender.pure import cost_model
        cost_model.memory_mb = lambda: 8000.0
        result["huge"] = press()
        result["log"] = message(lambda: bpy.ops.gof.open_benchmark(what="log"))
        result["made"] = sorted(path.name for path in __import__("pathlib").Path(folder).iterdir())
        result["parts"] = parts()
        """,
        tmp_path,
    )
    assert "choose an output folder: this file has not been saved" in found["unsaved"]
    assert "press Add Fire, or choose another background" in found["no fire"]
    assert "is not empty and holds no spec.json; choose a new output folder" in found["full"]
    assert "choose a spec file" in found["no file"]
    assert "broken.json: not valid JSON" in found["broken"]
    assert (
        "GB of memory, this machine has 8 GB, of which 90 % may be used; lower domain.resolution from 640 to"
        in found["huge"]
    )
    assert "press Bake & Render" in found["log"]
    assert found["made"] == ["broken.json", "full", "huge.json"], "nothing was begun"


@pytest.mark.blender
def test_report_escapes_names(tmp_path, made):
    layout = Layout(tmp_path)
    data = json.loads(made.description.read_text()) | {"name": "<script>"}
    layout.description.write_text(json.dumps(data))
    layout.velocity.mkdir()
    shutil.copy(made.velocity / "zarr.json", layout.velocity)
    dataset_process.write_page(layout)
    assert "<script>" not in layout.report.read_text() and "&lt;script&gt;" in layout.report.read_text()


PAPER = """
        from types import SimpleNamespace
        class Paper:
            "A layout that keeps what is drawn on it."
            def __init__(self):
                self.said = []
            def label(self, text="", icon="NONE", **_):
                self.said.append(text)
            def operator(self, name, text="", **_):
                self.said.append(f"[{text or name}]")
                return SimpleNamespace()
            def prop(self, owner, name, text=None, **_):
                self.said.append(f"({name})")
            def __getattr__(self, name):
                return lambda *a, **k: self
        def plan():
            paper = Paper()
            system = SimpleNamespace(ui_scale=1.0)
            context = SimpleNamespace(scene=scene, view_layer=bpy.context.view_layer, region=SimpleNamespace(width=220),
                                      preferences=SimpleNamespace(system=system))
            bpy.types.GOF_PT_benchmark._draw_plan(None, context, paper)
            return " ".join(paper.said)
"""


@pytest.mark.blender
def test_the_plan_is_that_of_this_spec_and_of_what_is_left(made, tmp_path):
    """A changed spec is not finished; what was begun shows what is left; without a folder the cost is shown all the
    same; what makes no sense is said in the plan and refused by the button."""
    shutil.copytree(made.root, tmp_path / "cube fire")
    begun = Layout(tmp_path / "begun fire")
    shutil.copytree(made.root, begun.root)
    begun.description.unlink()
    for path in sorted(begun.root.glob("cameras/*/exr/0*.exr"))[:5]:
        path.unlink()
    found = in_addon(
        PAPER
        + """
        settings = scene.gof.benchmark
        settings.preset, settings.background = "toy", "file"
        settings.spec_file = settings.folder = ""
        folder = sys.argv[1]
        settings.spec_file = folder + "/cube fire/spec.json"
        result["no folder"] = plan()
        settings.folder = folder + "/cube fire"
        result["finished"] = plan()
        settings.preset = "preview"
        result["changed"] = plan()
        settings.preset, settings.folder = "toy", folder + "/begun fire"
        settings.spec_file = folder + "/begun fire/spec.json"
        result["begun"] = plan()
        settings.folder, settings.background = folder + "/new", "workshop"
        fire.cameras.radius, fire.cameras.height = 0.1, 0.5
        result["inside"], result["pressed"] = plan(), message(bpy.ops.gof.bake_render)
        fire.cameras.radius, fire.cameras.height = 2.8, 0.9
        fire.radius = 0.06
        result["hint"] = plan()
        """,
        tmp_path,
    )
    assert "About" in found["no folder"] and "choose an output folder" in found["no folder"].replace("  ", " ")
    assert "Finished 20" in found["finished"] and "[Bake" not in found["finished"] and "About" not in found["finished"]
    assert "was made from" in found["changed"] and "clip," in found["changed"] and "Finished" not in found["changed"]
    assert "About" in found["changed"] and "choose" in found["changed"]
    assert (
        "18 pictures (6 x 3), 13 made" in found["begun"] and "left" in found["begun"] and "[Resume]" in found["begun"]
    )
    shown = " ".join(found["begun"].split())
    height, width = cv2.imread(str(next(made.root.glob("cameras/cam_0/rgb/*.png")))).shape[:2]
    assert f"of {width} x {height} pixels; 6 frames at 100 per s are 0.06 s" in shown
    for text in (found["inside"], found["pressed"]):
        assert "in the fire" in text and "[Bake" not in text
    assert "cells" in found["hint"] and "[Bake & Render]" in found["hint"]
    assert not (tmp_path / "new").exists()
