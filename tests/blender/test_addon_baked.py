"""A dataset's scene.blend without its cache, which may be deleted: the add-on says why there is no flame."""

import shutil
import subprocess
import sys
from dataclasses import replace

import pytest

from gof_blender.pure import spec
from tests.blender.runs import TOY, in_blender

pytestmark = pytest.mark.blender
OPEN = """
import gof_blender
gof_blender.register()
from gof_blender.scene import baked
bpy.ops.wm.open_mainfile(filepath=sys.argv[1] + "/scene.blend")
result["said"] = baked.missing(bpy.context.scene)
"""


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """A bake, as far as `scene.blend`."""
    folder = tmp_path_factory.mktemp("baked")
    spec.save(replace(TOY, domain=spec.Domain(resolution=16)), folder / "spec.json")
    (folder / "data" / ".cache").mkdir(parents=True)
    command = [sys.executable, "-m", "gof_blender.worker.generate", "--stage", "bake"]
    command += ["--spec", folder / "spec.json", "--out", folder / "data"]
    subprocess.run(list(map(str, command)), check=True, capture_output=True)
    return folder / "data"


def test_a_moved_scene_with_its_cache_is_whole(dataset, tmp_path):
    shutil.copytree(dataset, tmp_path / "another place")
    assert in_blender(OPEN, tmp_path / "another place")["said"] == []


def test_a_scene_without_its_cache_says_so(dataset, tmp_path):
    moved = tmp_path / "another place"
    shutil.copytree(dataset, moved, ignore=shutil.ignore_patterns(".cache"))
    (line,) = in_blender(OPEN, moved)["said"]
    assert str(moved / ".cache" / "bake") in line and "gof generate" in line
    script = "import bpy, sys, gof_blender\ngof_blender.register()\nbpy.ops.wm.open_mainfile(filepath=sys.argv[1])"
    done = subprocess.run([sys.executable, "-c", script, moved / "scene.blend"], capture_output=True, text=True)
    assert done.returncode == 0 and f"Gaussians on Fire: {line}" in done.stdout


def test_nothing_is_said_of_other_files(tmp_path):
    """A fire that simulates as it plays, and a volume of the user's own that is not there."""
    found = in_blender(
        """
import gof_blender
gof_blender.register()
from gof_blender.scene import baked
bpy.ops.gof.add_fire()
volume = bpy.data.volumes.new("smoke")
volume.filepath = "//no_such.vdb"
bpy.context.scene.collection.objects.link(bpy.data.objects.new("smoke", volume))
bpy.ops.wm.save_as_mainfile(filepath=sys.argv[1] + "/mine.blend")
result["said"] = baked.missing(bpy.context.scene)
""",
        tmp_path,
    )
    assert found["said"] == []
