"""A script that uses the add-on in the bpy wheel ends by itself, with the status that Python has, whatever it did."""

import subprocess
import sys

import pytest

START = "import bpy, gof_blender\ngof_blender.register()\n"
RENDER = """
scene = bpy.context.scene
scene.render.engine, scene.cycles.samples = "CYCLES", 1
scene.render.resolution_x = scene.render.resolution_y = 8
bpy.ops.render.render()
"""
BURN = """
bpy.ops.gof.add_fire()
for frame in range(3):
    bpy.context.scene.frame_set(frame)
"""
WORKER = """
from pathlib import Path
from gof_blender.pure import spec
from gof_blender.pure.timing import Clip
from gof_blender.worker import generate
clip = Clip(frames=2, fps=60.0, warm_up_frames=1)
toy = spec.SceneSpec("toy", clip=clip, domain=spec.Domain(resolution=16), background="studio")
spec.save(toy, Path("spec.json"))
Path("out/.cache").mkdir(parents=True)
assert generate.main(["--stage", "bake", "--spec", "spec.json", "--out", "out"]) == 0
"""
OPEN = f"""
import os, subprocess, sys
path = os.getcwd() + "/fire.blend"
made = "bpy.ops.object.quick_smoke()\\nbpy.ops.wm.save_as_mainfile(filepath=sys.argv[1])\\nos._exit(0)"
subprocess.run([sys.executable, "-c", "import bpy, os, sys\\n" + made, path])
{START}
bpy.ops.wm.open_mainfile(filepath=path)
bpy.context.scene.frame_set(2)
"""
SCRIPTS = {
    "registered": START,
    "registered twice": START + "gof_blender.unregister()\ngof_blender.register()\n",
    "unregistered": START + "gof_blender.unregister()\n",
    "new file": START + "bpy.ops.wm.read_factory_settings(use_empty=True)\n",
    "rendered": START + RENDER,
    "burnt": START + BURN,
    "burnt and rendered": START + BURN + RENDER,
    "burnt, then unregistered": START + BURN + "gof_blender.unregister()\n",
    "fire taken away": START + BURN + "bpy.ops.wm.read_homefile(use_factory_startup=True)\n",
    "opened a fire": OPEN,
    "worker in a script": WORKER,
}


@pytest.mark.blender
@pytest.mark.parametrize("name", SCRIPTS)
def test_a_script_ends(name, tmp_path):
    done = _run(SCRIPTS[name], tmp_path)
    assert done.returncode == 0, done.stderr


@pytest.mark.blender
@pytest.mark.parametrize(("last", "status"), [("raise SystemExit(3)", 3), ("1 / 0", 1)])
def test_its_status_is_pythons(last, status, tmp_path):
    done = _run(START + BURN + last, tmp_path)
    assert done.returncode == status
    assert ("ZeroDivisionError" in done.stderr) == (status == 1)


def _run(script: str, folder) -> subprocess.CompletedProcess:
    """Raises subprocess.TimeoutExpired: it does not end."""
    command = [sys.executable, "-c", script]
    return subprocess.run(command, capture_output=True, text=True, cwd=folder, timeout=90)
