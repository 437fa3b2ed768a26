"""Lamps under a cloud throw as much light on the scene as its Gaussians do, at the recording's time."""

import json
import shutil
import subprocess

import numpy as np
import pytest

from gof.core.gaussians import TransientGaussians
from tests.blender.runs import ADDON, in_blender
from tests.blender.test_cloud_light import flame

pytestmark = pytest.mark.blender
BLENDER, SCREEN = shutil.which("blender"), shutil.which("xvfb-run")
WALL = """
import numpy as np
import gof_blender
gof_blender.register()
folder = sys.argv[1]
scene = bpy.context.scene
for thing in list(scene.objects):
    bpy.data.objects.remove(thing)
scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0
scene.view_settings.view_transform = "Standard"
scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 128, False
scene.render.resolution_x = scene.render.resolution_y = 24
bpy.ops.mesh.primitive_plane_add(size=4, location=(0, 0.8, 0.3), rotation=(np.pi / 2, 0, 0))
camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
scene.collection.objects.link(camera)
scene.camera, camera.location, camera.rotation_euler = camera, (1.2, 0.1, 0.3), (np.pi / 2, 0, 0.7)  # past the flame
bpy.ops.gof.import_result(filepath=folder + "/result.npz", mode="ellipsoids", fit="keep")
flame, settings = bpy.context.object, scene.render.image_settings
settings.file_format, scene.render.filepath = "OPEN_EXR", folder + "/wall.exr"


def wall():
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(scene.render.filepath)
    found = np.array(image.pixels[:]).reshape(-1, 4)[:, :3].mean(0).tolist()
    bpy.data.images.remove(image)
    return found


lamps = [thing for thing in scene.objects if thing.type == "LIGHT"]
result["lamps"] = len(lamps)
result["by lamps"] = wall()
for lamp in lamps:
    lamp.hide_render = True
result["by none"] = wall()
flame.visible_diffuse = True
result["by Gaussians"] = wall()
"""
CLOCK = """
import numpy as np
import gof_blender
from gof_blender.scene import point_cloud
gof_blender.register()
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.render.fps = 100
bpy.ops.gof.import_result(filepath=sys.argv[1] + "/result.npz", start_frame=11, fit="keep")
thing = bpy.context.object
settings = point_cloud.inputs(thing)


def energy(frame):
    scene.frame_set(int(frame // 1), subframe=frame % 1)
    bpy.context.view_layer.update()
    return sum(lamp.data.energy for lamp in scene.objects if lamp.type == "LIGHT")


result["over time"] = [energy(frame) for frame in range(11, 112, 5)]
settings["Time Scale"], settings["Start Frame"] = 0.5, 0.0
result["slow"] = [energy(frame) for frame in range(0, 201, 10)]
settings["Emission"] = 3.0
result["bright"] = energy(100)
settings["Light on Scene"] = 0.5
result["half"] = energy(100)
thing.scale = (2, 2, 2)
result["large"] = energy(100)
settings["Color By"] = 1
result["mapped"] = energy(100)
settings["Color By"], thing.hide_render = 0, True
result["hidden"] = energy(100)
"""


@pytest.mark.parametrize("emissive", [True, False])
def test_a_wall_gets_what_the_gaussians_would_give_it(tmp_path, emissive):
    flame(emissive).save(tmp_path / "result.npz")
    found = in_blender(WALL, tmp_path)
    assert found["lamps"] == 4 and max(found["by none"]) < 1e-5
    assert found["by Gaussians"][0] > 0.005
    np.testing.assert_allclose(found["by lamps"], found["by Gaussians"], rtol=0.15)


def test_lamps_follow_the_clock_and_the_settings(tmp_path):
    rng, n = np.random.default_rng(1), 400
    t_mu = 0.5 + 0.15 * rng.standard_normal(n)
    TransientGaussians(
        position=rng.normal(0, 0.05, (n, 3)),
        velocity=np.zeros((n, 3)),
        t_mu=t_mu,
        t_sigma=np.full(n, 0.05),
        scale=np.full((n, 3), 0.004),
        rotation=np.tile([1.0, 0, 0, 0], (n, 1)),
        opacity=np.full(n, 0.05),
        color=np.tile([1.0, 0.5, 0.1], (n, 1)),
        dynamic=np.ones(n, bool),
        emissive=True,
    ).save(tmp_path / "result.npz")
    found = in_blender(CLOCK, tmp_path)
    over_time = np.array(found["over time"])
    wanted = [np.exp(-0.5 * ((t - t_mu) / 0.05) ** 2).sum() for t in np.arange(0, 1.01, 0.05)]
    # Faint Gaussians beside each other: their light adds up.
    np.testing.assert_allclose(over_time / over_time.sum(), wanted / np.sum(wanted), atol=0.02)
    np.testing.assert_allclose(found["slow"], over_time, rtol=1e-4, atol=1e-6 * over_time.max())
    assert found["bright"] == pytest.approx(3 * over_time[10], rel=1e-4)
    assert found["half"] == pytest.approx(found["bright"] / 2, rel=1e-4)
    assert found["large"] == pytest.approx(4 * found["half"], rel=1e-4)
    assert found["mapped"] == found["hidden"] == 0


@pytest.mark.skipif(not (BLENDER and SCREEN), reason="needs a Blender with a window (Debian: blender, xvfb)")
def test_a_wall_is_lit_in_eevee_as_in_cycles(tmp_path):
    flame(True).save(tmp_path / "result.npz")
    (tmp_path / "gof_blender").symlink_to(ADDON)
    script = WALL.partition("lamps = [")[0] + (
        "scene.cycles.diffuse_bounces = 0\n"
        "for engine in ('CYCLES', 'BLENDER_EEVEE'):\n    scene.render.engine = engine\n    result[engine] = wall()\n"
    )
    (tmp_path / "look.py").write_text(
        f"import json, os, sys\nsys.path.insert(0, {str(tmp_path)!r})\nsys.argv = ['', {str(tmp_path)!r}]\n"
        + f"import bpy\nresult = {{}}\n{script}"
        + "print('RESULT' + json.dumps(result), flush=True)\nos._exit(0)\n"
    )
    command = [SCREEN, "-a", BLENDER, "--factory-startup", "--python-exit-code", "1", "--python"]
    run = subprocess.run([*command, str(tmp_path / "look.py")], capture_output=True, text=True, timeout=240)
    assert "RESULT" in run.stdout, run.stderr
    found = json.loads(next(line for line in run.stdout.splitlines() if line.startswith("RESULT"))[6:])
    assert found["CYCLES"][0] > 0.005
    np.testing.assert_allclose(found["BLENDER_EEVEE"], found["CYCLES"], rtol=0.2)
