"""Numbers of the panels are shown as they were typed: Blender's own two decimals make 12.35 of 12.345."""

import json
import os
import shutil
import signal
import subprocess
from pathlib import Path

import pytest

from tests.blender.test_addon_fire import in_addon

pytestmark = pytest.mark.blender
BLENDER, SCREEN = shutil.which("blender"), shutil.which("xvfb-run")
TYPED = {  # what somebody may type, by the end of the label
    "(s)": 0.01234,
    "(m)": 1.234,
    "(mm)": 35.125,
    "(°)": 12.345,
    "(fps)": 23.976,
    "(per s)": 59.94,
    "": 0.125,
}
MORE = {"start_s": [12.345, 30.3], "radiance": [1e-6, 5.04, 0.000125], "intensity": [1e-4], "exposure_s": [0.000125]}
MORE |= {"clearance": [0.0125], "voxel_m": [0.0125], "readout_s": [0.00833]}
NUMBERS = """
from gof_blender.ui import effect_groups
scene = bpy.context.scene
fire = scene.gof.fire
groups = {"fire": fire, "cameras": fire.cameras, "benchmark": scene.gof.benchmark}
groups |= {name: getattr(fire.effects, name) for name in effect_groups.GROUPS}
def numbers(owner):
    return [kind for kind in owner.bl_rna.properties if kind.type == "FLOAT"]
"""


def test_no_digit_that_was_typed_is_hidden():
    """By the decimals that Blender itself keeps for every number of the add-on."""
    pytest.importorskip("bpy", reason="the add-on's operators need the bpy wheel")
    found = in_addon(
        NUMBERS
        + """
kinds = {name: owner.bl_rna.properties for name, owner in groups.items()}
kinds |= {name: getattr(bpy.ops.gof, name).get_rna_type().properties for name in ("import_result", "export_vdb")}
for group, properties in kinds.items():
    for kind in (kind for kind in properties if kind.type == "FLOAT"):
        result[f"{group}.{kind.identifier}"] = [kind.name, kind.precision, kind.default, kind.hard_min]
"""
    )
    assert {"benchmark.start_s", "import_result.clip_seconds", "export_vdb.voxel_m", "wind.gusts"} <= set(found)
    for name, (label, decimals, default, least) in found.items():
        values = [typed(label), *MORE.get(name.partition(".")[2], []), float(f"{default:.7g}")]
        values += [float(f"{least:.7g}")] if 0 < least < 1 else []
        for value in values:
            assert float(f"{value:.{decimals}f}") == value, name


@pytest.mark.skipif(not (BLENDER and SCREEN), reason="needs a Blender with a window (Debian: blender, xvfb)")
def test_a_window_shows_them(tmp_path):
    """What the fields of a drawn window hold, as Blender tells it (`UILayout.introspect`)."""
    (tmp_path / "gof_blender").symlink_to(Path(__file__).parents[2] / "blender_addon")
    script = tmp_path / "look.py"
    script.write_text(
        f"import sys\nsys.path.insert(0, {str(tmp_path)!r})\n"
        + "import bpy, gof_blender, json, os\ngof_blender.register()\n"
        + NUMBERS
        + f"typed, more = {TYPED!r}, {MORE!r}\n"
        + """
def texts(layout):
    return [text for item in layout for text in (texts(item["items"]) if "items" in item else [item["draw_string"]])]
fields = []
for group, owner in groups.items():
    for kind in (kind for kind in numbers(owner) if not kind.is_array):
        first = next(value for end, value in typed.items() if kind.name.endswith(end))
        fields.append((group, owner, kind.identifier, [first, *more.get(kind.identifier, [])]))
seen, rounds = [], 0
def type_in():  # a timer: no value may be written while a window is drawn
    global rounds
    if len(seen) < rounds:
        return 0.05  # not drawn yet
    if rounds == max(len(values) for *_, values in fields):
        with open(sys.argv[-1], "w") as file:
            json.dump(sum(seen, []), file)
        os._exit(0)
    for group, owner, name, values in fields:
        setattr(owner, name, values[rounds % len(values)])
    rounds += 1
    for area in bpy.context.window_manager.windows[0].screen.areas:
        area.tag_redraw()
    return 0.05
def draw(self, context):
    if len(seen) < rounds:
        drawn = []
        for group, owner, name, values in fields:
            row = self.layout.row()
            row.prop(owner, name, text="")
            drawn.append([f"{group}.{name}", values[(rounds - 1) % len(values)], texts(row.introspect())[-1]])
        seen.append(drawn)
bpy.types.VIEW3D_HT_header.prepend(draw)
bpy.app.timers.register(type_in)
"""
    )
    # Debian's Blender takes the libraries of the python3 that it finds first, which must be Debian's.
    environment = {key: value for key, value in os.environ.items() if not key.startswith(("BLENDER_", "PYTHON"))}
    command = [SCREEN, "-a", BLENDER, "--factory-startup", "--python-exit-code", "1", "--python", str(script)]
    window = subprocess.Popen(
        [*command, "--", str(tmp_path / "seen.json")],
        env=environment | {"LIBGL_ALWAYS_SOFTWARE": "1", "PATH": os.defpath},
        cwd=tmp_path,
        start_new_session=True,
    )
    try:
        window.wait(timeout=120)
    except subprocess.TimeoutExpired:
        os.killpg(window.pid, signal.SIGKILL)  # the virtual screen and Blender are its children
        raise
    seen = json.loads((tmp_path / "seen.json").read_text())
    assert ["benchmark.start_s", 12.345, "12.34500"] in seen and ["benchmark.radiance", 1e-6, "0.000001"] in seen
    for name, value, text in seen:
        assert float(text) == pytest.approx(value, rel=1e-6), name


def typed(label: str) -> float:
    return next(value for end, value in TYPED.items() if label.endswith(end))
