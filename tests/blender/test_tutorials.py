"""The Blender tutorials' scripts and steps, as their readers run them; names of buttons: test_addon_labels.py."""

import json
import os
import re
import stat
import sys
from pathlib import Path

import numpy as np
import pytest

from gof.dataset import Dataset
from gof.sample import unpack_sample
from tests.blender.test_addon_fire import in_addon
from tests.reader import run
from tests.test_site import BLOCK, without_numbers

ROOT = Path(__file__).parents[2]
FIRE, FLAME = (ROOT / f"docs/tutorials/blender_{name}.md" for name in ("fire", "flame"))

pytest.importorskip("bpy", reason="the add-on's operators need the bpy wheel")
pytestmark = [pytest.mark.blender, pytest.mark.checkout]

NOT_RUN = {  # commands within a sentence: why
    "gof generate spec.json --out DIR": "test_addon_benchmark.py makes a dataset again from its spec",
    "gof sample": "the block below it runs",
    "gof convert": "tests/io runs it into each format",
}
BLENDER = """#!{python}
import sys, warnings
import bpy, gof_blender
from gof_blender.scene import mantaflow
_, background, blend, option, script = sys.argv
assert (background, option) == ("-b", "--python")
gof_blender.register()  # a Blender whose user has ticked the add-on
bpy.ops.wm.open_mainfile(filepath=blend)
exec(compile(open(script).read(), script, "exec"))
sys.stdout.flush()
mantaflow.leave()
"""


@pytest.mark.parametrize("page", [FIRE, FLAME], ids=lambda page: page.stem)
def test_every_command_is_run_or_has_its_reason(page):
    text = page.read_text(encoding="utf-8")
    languages = re.findall(r"^```(\w*)\n(?:.*?)^```", text, re.MULTILINE | re.DOTALL)
    assert languages and set(languages) <= {"bash", "python", "text"}, "a block without a language is not run"
    named = re.findall(r"`((?:gof|python|blender) [^`]+)`", text)
    assert [command for command in named if command not in NOT_RUN] == []


@pytest.mark.long
@pytest.mark.timeout(900)
def test_the_script_of_many_fires_runs_as_printed(tmp_path, monkeypatch):
    """By the bpy wheel in place of Blender's program, on the scene of part 2 with small settings."""
    blocks = BLOCK.findall(FIRE.read_text(encoding="utf-8"))
    assert [language for language, _ in blocks] == ["python", "bash", "text"]
    (tmp_path / "loop.py").write_text(blocks[0][1])
    in_addon(
        """
        scene.gof.benchmark.preset, fire.cameras.count, fire.cameras.sensor_px = "toy", 1, (640, 320)
        fire.spot = "OBJECT"
        bpy.context.view_layer.objects.active = bpy.data.objects["Cube"]
        bpy.ops.gof.add_fire(); bpy.ops.gof.add_cameras()
        bpy.ops.wm.save_as_mainfile(filepath=sys.argv[1])
        """,
        tmp_path / "kitchen.blend",
    )
    program = tmp_path / "bin/blender"
    program.parent.mkdir()
    program.write_text(BLENDER.format(python=sys.executable))
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("PATH", f"{program.parent}{os.pathsep}{os.environ['PATH']}")
    printed = run(tmp_path, blocks[1][1], "bash")
    for line in blocks[2][1].splitlines():
        assert without_numbers(line) in without_numbers(printed)
    assert "RuntimeWarning" not in printed and printed.count("Dataset finished") == 3
    made = sorted(path.parent.name for path in tmp_path.glob("*/dataset.json"))
    assert made == ["fire_0", "fire_1", "fire_2"]
    seeds = [json.loads((tmp_path / name / "spec.json").read_text())["seed"] for name in made]
    assert seeds == [0, 1, 2]
    datasets = [Dataset.open(tmp_path / name) for name in made]
    flames = {dataset.image(0, dataset.frames(0)[-1]).tobytes() for dataset in datasets}
    assert len(flames) == 3, "each its own flame"


def test_the_sample_has_the_flame_that_the_tutorial_imports(tmp_path):
    """Under the page's name, as one object of all its Gaussians; where it stands: test_addon_places.py."""
    name = re.search(r"You need `(\S+)` only", FLAME.read_text(encoding="utf-8"))[1]
    unpack_sample(tmp_path / "sample")
    found = in_addon(
        """
        bpy.ops.gof.import_result(filepath=sys.argv[1], spot="CURSOR")
        result["objects"] = [thing.name for thing in bpy.context.selected_objects]
        result["size"] = len(bpy.context.object.data.vertices)
        """,
        tmp_path / name,
    )
    assert found["objects"] == ["result"]
    with np.load(tmp_path / name) as arrays:
        assert found["size"] == len(arrays["x0"]) > 5000
