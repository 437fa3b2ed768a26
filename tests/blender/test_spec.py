"""The scene spec: JSON round trip, presets, and errors that name the field."""

import ast
import copy
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from gof_benchmark.scenes import FOLDER as SCENES
from gof_blender.core.checked_json import SpecError
from gof_blender.pure import effects
from gof_blender.pure import spec as scene_spec
from gof_blender.pure.effects import motion_blur, rolling_shutter, smoke, vorticity, wind
from gof_blender.pure.rig import Rig
from gof_blender.pure.spec import Domain, Fire, Render, SceneSpec
from gof_blender.pure.timing import Clip

SCENE_EFFECTS = Path(__file__).parents[2] / "blender_addon" / "scene" / "effects"


def example() -> SceneSpec:
    return SceneSpec(
        "example",
        seed=7,
        clip=Clip(9, 50.0, 5, 0.5),
        domain=Domain((-1, -1, 0), (2, 2, 3), 30),
        fire=Fire("wood", "sphere", (0, 0, 0.5), 0.2),
        cameras=Rig(2, arc_deg=40.0, focal_mm=35.0, roll_deg=-90),
        render=Render(10, samples=3),
        background="studio",
        effects=(wind.Settings(strength=0.7), smoke.Settings(), vorticity.Settings(gas=0.1)),
    )


def test_json_round_trip(tmp_path):
    spec = example()
    scene_spec.save(spec, tmp_path / "spec.json")
    assert scene_spec.load(tmp_path / "spec.json") == spec
    assert spec.effect_names == ["wind", "smoke", "vorticity"]
    assert not list(tmp_path.glob(".*")), "no temporary file is left"


def test_left_out_fields_take_their_defaults():
    assert SceneSpec.from_dict({"schema": "gof-scene", "version": 3, "name": "x"}) == SceneSpec("x")


def test_a_spec_of_version_2_shines_as_it_did():
    for fire, light in (({}, "soot"), ({"light": "sheets"}, "sheets"), ({"speeds": "solver"}, "soot")):
        old = SceneSpec.from_dict({"schema": "gof-scene", "version": 2, "name": "x", "fire": fire})
        assert old.fire.light == light and old.fire.speeds == fire.get("speeds", "physical")
        assert SceneSpec.from_dict(old.to_dict()) == old, "kept when it is written as version 3"
    assert SceneSpec("x").fire.light == "sheets"


def test_a_spec_of_version_1_is_the_fire_that_it_was():
    """Its light and its solver's constants are those of before there were others, whatever is the default today."""
    for fire in ({}, {"fuel": "wood", "radius": 0.01}):
        old = SceneSpec.from_dict({"schema": "gof-scene", "version": 1, "name": "x", "fire": fire})
        assert (old.fire.light, old.fire.speeds, old.fire.intensity) == ("reaction", "solver", 1.0)
        constants = old.solver
        assert (constants.gravity, constants.confinement, constants.drift) == (1.0, 1.0, 1.0)
        assert (constants.burning_rate, constants.amount) == (old.fuel.burning_rate, old.fuel.amount)
        assert SceneSpec.from_dict(old.to_dict()) == old, "kept when it is written as version 3"
    windy = {"schema": "gof-scene", "version": 1, "name": "x", "effects": [{"name": "wind"}]}
    assert SceneSpec.from_dict(windy).effects == (wind.Settings(0.3, unit="field"),)
    grids = {"schema": "gof-scene", "version": 1, "name": "x", "fire": {"grids": "somewhere"}}
    assert SceneSpec.from_dict(grids).fire.grids == "somewhere"


def test_frames_of_the_clip():
    spec = SceneSpec("x", clip=Clip(frames=10, fps=50.0, warm_up_frames=4, time_scale=0.5))
    timeline = spec.timeline
    assert (timeline.first_frame, timeline.last_frame, timeline.solver_step_s) == (5, 14, 0.01)
    finer = replace(spec, clip=replace(spec.clip, steps_per_frame=3)).timeline
    assert (finer.first_frame, finer.last_frame, finer.steps_per_second) == (13, 40, 150.0)
    assert finer.solver_step_s == pytest.approx(0.01 / 3)


def test_effects_ask_for_steps_between_frames_and_for_what_the_shutter_sees():
    clip = Clip(frames=3, fps=100.0, warm_up_frames=2)
    blurred = SceneSpec("x", clip=clip, effects=(motion_blur.Settings(shutter=1.0, steps=4),))
    timeline = blurred.timeline
    assert (timeline.steps_per_frame, timeline.first_frame, timeline.last_frame) == (4, 9, 17 + 2)
    both = replace(
        blurred, effects=(motion_blur.Settings(shutter=1.0, steps=4), rolling_shutter.Settings(0.01, steps=6))
    )
    assert (both.timeline.steps_per_frame, both.timeline.last_frame) == (12, 1 + 12 * 4 + 6 + 12)
    with pytest.raises(SpecError, match="long enough for the shutter to open before frame 0"):
        replace(blurred, clip=replace(clip, warm_up_frames=0))


@pytest.mark.parametrize(
    "path, value, message",
    [
        (("clip", "frames"), 0, "clip.frames must be at least 1"),
        (("clip", "frames"), 2.5, "clip.frames must be a whole number"),
        (("clip", "frames"), True, "clip.frames must be a whole number"),
        (("clip", "fps"), float("nan"), "'clip.fps' is NaN"),
        (("schema",), "x" * 10**6, "expected .schema.: .gof-scene., .version.: 3, got 'xxx"),
        (("clip", "fps"), "x" * 10**6, "clip.fps must be a finite number, got 'xxx"),
        (("clip", "fps"), "fast", "clip.fps must be a finite number"),
        (("clip", "fsp"), 25, "clip.fsp is not a field"),
        (("domain", "size"), [1, 1], "domain.size must be 3 numbers"),
        (("domain", "size"), [1, 0, 1], r"domain.size must be in \[0.001, 1000\] m"),
        (("display",), {"gamma": 0}, r"display.gamma must be in \[0.1, 5\]"),
        (("display",), {"exposure": 1e9}, r"display.exposure must be in \[-10, 10\] stops"),
        (("effects",), [{"name": "smoke", "density": -5}], "effects.smoke.density must be in"),
        (("effects",), [{"name": "smoke", "albedo": 7}], r"effects.smoke.albedo must be in \[0, 1\]"),
        (("effects",), [{"name": "vorticity", "gas": -100}], "effects.vorticity.gas must be in"),
        (("effects",), [{"name": "vorticity", "flame": 1e9}], "effects.vorticity.flame must be in"),
        (("fire", "jet_speed"), 1e6, r"fire.jet_speed must be in \[0, 100\] m/s"),
        (("cameras", "focal_mm"), 1e-6, r"cameras.focal_mm must be in \[1, 5000\] mm"),
        (("cameras", "sensor_px"), [10**6, 10**6], "cameras.sensor_px must be 16 to 65536 pixels"),
        (("name",), "..", "name must be a plain file name"),
        (("name",), "a\nb\0", "name must be a plain file name"),
        (("fire", "fuel"), "plutonium", "fire.fuel must be one of"),
        (("fire", "position"), [0, 0, 9], r"fire\.position: the burner reaches from .* along z, the domain from"),
        (("cameras", "roll_deg"), 45, "cameras.roll_deg must be one of"),
        (("cameras", "count"), 0, "cameras.count must be at least 1"),
        (("background",), "moon", "background must be one of"),
        (("effects",), [{"name": "rain"}], "effects must be one of"),
        (("effects",), [{"name": "wind", "speed": 1}], "effects.wind.speed is not a field"),
        (("effects",), [{"name": "wind"}, {"name": "wind"}], "effects must be listed once each"),
        (("effects",), ["wind"], "effects must be objects"),
        (("name",), "../up", "name must be a plain file name"),
        (("version",), 4, "version 4"),
        (("clip",), 3, "clip must be an object"),
    ],
)
def test_errors_name_the_file_and_the_field(tmp_path, path, value, message):
    data = example().to_dict()
    target = data
    for key in path[:-1]:
        target = target[key]
    target[path[-1]] = value
    file = tmp_path / "spec.json"
    file.write_text(json.dumps(data))
    with pytest.raises(SpecError, match=message) as error:
        scene_spec.load(file)
    assert str(file) in str(error.value) and len(str(error.value)) < 1000


@pytest.mark.parametrize("content", ["", "[]", "{", '{"schema": "gof-scene", "version": 1}'])
def test_broken_files_are_named(tmp_path, content):
    file = tmp_path / "spec.json"
    file.write_text(content)
    with pytest.raises(SpecError, match=r"spec\.json"):
        scene_spec.load(file)


def test_presets_change_cost_not_content():
    spec = example()
    before = copy.deepcopy(spec)
    for name in scene_spec.PRESETS:
        other = spec.with_preset(name)
        assert (other.name, other.effects, other.fire, other.cameras) == (
            spec.name,
            spec.effects,
            spec.fire,
            spec.cameras,
        )
        assert other.render != spec.render
    assert spec == before
    with pytest.raises(SpecError, match="preset must be one of"):
        spec.with_preset("huge")


PURE_HOOKS = {"ABSORBS_LIGHT", "CHANGES_BAKE", "steps_per_frame", "timing", "expose", "gain", "SHOWS_BOARD", "ENCODES"}
SCENE_HOOKS = {"apply", "overlay", "board_mask"}


def test_every_effect_keeps_the_contract():
    """Every effect changes something, and the half in the scene belongs to an effect."""
    assert effects.names()
    scene = {path.stem: _defined(path) for path in SCENE_EFFECTS.glob("[!_]*.py")}
    assert set(scene) <= set(effects.names()) and all(hooks & SCENE_HOOKS for hooks in scene.values())
    for name in effects.names():
        module = effects.module(name)
        assert effects.name_of(module.Settings()) == name
        assert PURE_HOOKS & set(vars(module)) or name in scene, "an effect changes something"
        assert bool(getattr(module, "SHOWS_BOARD", False)) == ("board_mask" in scene.get(name, set()))
        assert bool(getattr(module, "CHANGES_BAKE", False)) == ("apply" in scene.get(name, set()))


def _defined(path: Path) -> set[str]:
    return {node.name for node in ast.parse(path.read_text()).body if isinstance(node, ast.FunctionDef)}


@pytest.mark.parametrize("path", sorted(SCENES.glob("*/spec.json")), ids=lambda path: path.parent.name)
def test_built_in_scenes_load_and_have_a_card(path):
    assert scene_spec.load(path).name == path.parent.name
    assert (path.parent / "README.md").is_file()


def test_reading_a_spec_needs_no_blender():
    code = "import sys; from gof_blender.pure import spec; spec.load(sys.argv[1]); print('bpy' in sys.modules)"
    path = next(SCENES.glob("*/spec.json"))
    run = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "False"
