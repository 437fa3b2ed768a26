"""What the add-on asks of a Blender's version: of the one at hand, and of 5.3 where GOF_BPY_5_3 names a Python that has
its bpy (`python3.13 -m venv b53 && b53/bin/pip install bpy==5.3.0`)."""

import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

from gof.core.gaussians import TransientGaussians
from tests.blender.runs import in_blender
from tests.conftest import random_gaussians

ROOT = Path(__file__).resolve().parents[2]
PYTHON = os.environ.get("GOF_BPY_5_3", "")
SPLATS = """
import json, sys
import bpy
import numpy as np
import gof_blender

gof_blender.register()
folder, result = sys.argv[1], {}
result["version"] = list(bpy.app.version)
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.render.fps = 100
bpy.ops.gof.import_result(filepath=folder + "/result.npz", start_frame=0, fit="keep")
thing = bpy.context.object
thing.location = (1, 2, 3)
result["answer"] = list(bpy.ops.gof.native_splats())


def look(scene, frame):
    # what the modifier makes of the splats at a frame
    scene.frame_set(frame)
    thing = next(other for other in scene.objects if other.type == "POINTCLOUD")
    there = thing.evaluated_get(bpy.context.evaluated_depsgraph_get())
    found = {"type": there.data.type, "at": list(there.matrix_world.translation)}
    for name, field, width in (
        ("position", "vector", 3), ("scale", "vector", 3), ("rotation", "value", 4), ("radiance:base", "color", 4),
        ("velocity", "vector", 3)
    ):
        data = there.data.attributes[name].data
        values = np.zeros(len(data) * width, np.float32)
        data.foreach_get(field, values)
        found[name] = values.reshape(-1, width).tolist()
    return found


result["looks"] = {frame: look(scene, frame) for frame in (30, 65)}
bpy.ops.gof.add_fire()
bpy.ops.wm.save_as_mainfile(filepath=folder + "/flame.blend")
gof_blender.unregister()
bpy.ops.wm.open_mainfile(filepath=folder + "/flame.blend")
result["alone"] = look(bpy.context.scene, 65)
gof_blender.register()
bpy.ops.wm.read_factory_settings(use_empty=True)
with bpy.data.libraries.load(folder + "/flame.blend", link=True) as (there, here):
    here.objects = ["result"]
bpy.context.scene.collection.objects.link(here.objects[0])
bpy.context.view_layer.update()
result["surfaces"] = bpy.context.scene.cycles.transparent_max_bounces
print("RESULT" + json.dumps(result), flush=True)
"""


@pytest.fixture(scope="module")
def found(tmp_path_factory) -> dict:
    if not PYTHON:
        pytest.skip("no Blender 5.3 here: set GOF_BPY_5_3 to a Python that has its bpy")
    folder = tmp_path_factory.mktemp("newer")
    (folder / "gof_blender").symlink_to(ROOT / "blender_addon")
    random_gaussians(50).save(folder / "result.npz")
    command = [PYTHON, "-W", "error::DeprecationWarning:gof_blender", "-c", SPLATS, str(folder)]
    environment = os.environ | {"PYTHONPATH": str(folder)}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=folder, timeout=240)
    assert done.returncode == 0, done.stderr
    assert "DeprecationWarning" not in done.stderr
    result = json.loads(next(line for line in done.stdout.splitlines() if line.startswith("RESULT"))[6:])
    assert result["version"] >= [5, 3, 0], f"{PYTHON} has an older Blender"
    return result | {"truth": TransientGaussians.load(folder / "result.npz")}


@pytest.mark.blender
@pytest.mark.parametrize("frame", [30, 65, None])
def test_splats_of_blender_5_3_move(found, frame):
    """x0 + (t - t_mu) v and opacity exp(-0.5 ((t - t_mu) / t_sigma)^2) of what is not fainter than 1/255.

    Without a frame: of the saved file, opened without the add-on.
    """
    look, time_s = (found["looks"][str(frame)], frame / 100) if frame else (found["alone"], 0.65)
    g = found["truth"]
    age = np.where(g.dynamic, time_s - g.t_mu, 0.0)
    opacity = g.opacity * np.exp(-0.5 * (age / g.t_sigma) ** 2)
    seen = opacity >= 1 / 255
    assert found["answer"] == ["FINISHED"] and look["type"] == "GAUSSIAN_SPLAT" and look["at"] == [1, 2, 3]
    assert 0 < seen.sum() < len(g)
    np.testing.assert_allclose(look["position"], (g.position + age[:, None] * g.velocity)[seen], atol=1e-5)
    np.testing.assert_allclose(look["velocity"], np.where(g.dynamic[:, None], g.velocity, 0)[seen], atol=1e-6)
    np.testing.assert_allclose(look["scale"], g.scale[seen], rtol=1e-5)
    turned = np.array(look["rotation"])  # q and -q are the same rotation
    turned *= np.sign((turned * g.rotation[seen]).sum(1, keepdims=True))
    np.testing.assert_allclose(turned, g.rotation[seen], atol=1e-6)
    radiance = np.array(look["radiance:base"])
    np.testing.assert_allclose(radiance[:, 3], opacity[seen], rtol=1e-4)
    np.testing.assert_allclose(0.5 + 0.28209479 * radiance[:, :3], g.color[seen], atol=1e-5)


@pytest.mark.blender
def test_a_linked_flame_shines_in_blender_5_3(found):
    assert found["surfaces"] == 1024


@pytest.mark.blender
def test_a_function_of_blenders_own_is_found():
    """Blender's classes do not show their functions: `hasattr` says there is none, whatever the version."""
    result = in_blender(
        """
from gof_blender.scene.compat import has_function
result["there"] = [has_function("UILayout", "label"), has_function("UILayout", "progress")]
result["absent"] = [has_function("UILayout", "no_such"), has_function("NoSuchType", "resize")]
result["resize"] = [has_function("PointCloud", "resize"), hasattr(bpy.data.pointclouds.new("probe"), "resize")]
"""
    )
    assert result["there"] == [True, True] and result["absent"] == [False, False]
    assert result["resize"][0] == result["resize"][1]
