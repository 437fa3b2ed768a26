"""The Fire panel: the generator's own fire and cameras as data of the user's scene, found again and read back."""

import re

import numpy as np
import pytest

from tests.blender.runs import in_blender

pytest.importorskip("bpy", reason="the add-on's operators need the bpy wheel")
pytestmark = pytest.mark.blender

START = """
import traceback
def fail(*what):  # the wheel hangs in its normal exit after a fire
    traceback.print_exception(*what)
    mantaflow.leave(1)
sys.excepthook = fail
import numpy as np
import gof_blender
from gof_blender.core.checked_json import SpecError
from gof_blender.scene import place
from gof_blender.ui import scene_spec
gof_blender.register()
scene = bpy.context.scene
fire = scene.gof.fire
def message(call):
    try:
        return str(call())
    except (RuntimeError, SpecError) as error:
        return str(error)
def parts():
    return sorted(place.part_of(thing) for thing in bpy.context.scene.objects if place.part_of(thing))
"""


def in_addon(script: str, *args) -> dict:
    import textwrap

    return in_blender(START + textwrap.dedent(script), *args)


def test_only_what_is_chosen_is_in_the_scene():
    found = in_addon("""
        bpy.ops.gof.add_fire()
        result["default"] = parts()
        settings = place.find(scene, "domain").modifiers["Fluid"].domain_settings
        result["vorticity"] = settings.vorticity
        fire.effects.vorticity.use, fire.effects.wind.use, fire.effects.wind.strength = False, True, 0.7
        fire.effects.motion_blur.use, fire.effects.wind.gusts = True, 0
        fire.effects.sync_board.use, fire.effects.sync_board.position = True, (0.1, -0.4, 0.13)
        before = len(bpy.data.objects)
        bpy.ops.gof.add_fire()
        result["windy"], result["more"] = parts(), len(bpy.data.objects) - before
        settings = place.find(scene, "domain").modifiers["Fluid"].domain_settings
        result["calm"] = [settings.vorticity, settings.flame_vorticity, settings.flame_smoke, settings.use_noise]
        result["wind"] = place.find(scene, "effect").field.strength
        result["pushed"] = [scene.render.fps, fire.resolution, fire.radius]
        spec = scene_spec.of_scene(scene)
        result["spec"], result["board"] = spec.effect_names, spec.effects[1].position
    """)
    assert found["default"] == ["domain", "emitter", "place"] and found["vorticity"] > 0
    assert found["windy"] == ["domain", "effect", "emitter", "place"] and found["more"] == 1
    assert found["calm"] == [0.0, 0.0, 0.0, False]
    fps, cells, radius = found["pushed"]
    push = 0.7 * 6.8 / (2 * (2.5 * 2 * radius) ** 0.5)  # the wind's speed within the time that gas is in the flame
    assert found["wind"] == pytest.approx(push / fps * cells / 0.15, rel=1e-5) and found["spec"] == [
        "motion_blur",
        "sync_board",
        "wind",
    ]
    assert found["board"] == [0.1, -0.4, 0.13], "as typed, not in single precision"


def test_parts_are_those_the_generator_builds():
    found = in_addon("""
        from dataclasses import replace
        from gof_blender.scene import build
        fire.fuel, fire.shape, fire.radius = "wood", "logs", 0.2
        fire.cameras.eval_count, fire.cameras.focal_mm = 1, 35
        bpy.ops.gof.add_fire(); bpy.ops.gof.add_cameras()
        bpy.context.view_layer.update()
        spec = scene_spec.of_scene(scene)
        def facts(domain, emitter, cameras, where):
            settings, flow = domain.modifiers["Fluid"].domain_settings, emitter.modifiers["Fluid"].flow_settings
            return {
                "burn": [settings.burning_rate, settings.flame_max_temp, settings.beta],
                "amount": [flow.fuel_amount, settings.resolution_max],
                "mesh": [tuple(emitter.matrix_world @ v.co - where) for v in emitter.data.vertices],
                "box": [tuple(domain.matrix_world @ v.co - where) for v in domain.data.vertices],
                "lens": [(camera.data.lens, camera.data.sensor_fit) for camera in cameras],
                "poses": [[list(row) for row in camera.matrix_world] for camera in cameras],
                "size": [scene_.render.resolution_x, scene_.render.resolution_y],
            }
        from mathutils import Vector
        scene_ = scene
        names = spec.cameras.names
        domain, emitter = place.find(scene, "domain"), place.find(scene, "emitter")
        result["ours"] = facts(domain, emitter, place.cameras(scene), Vector((0, 0, 0)))
        build.scene(replace(spec, background="studio"))
        scene_ = bpy.context.scene
        bpy.context.view_layer.update()
        domain, emitter = bpy.data.objects["Fire Domain"], bpy.data.objects["Fire Burner"]
        result["its"] = facts(domain, emitter, [bpy.data.objects[n] for n in names], Vector((0, 0, 0)))
    """)
    assert found["ours"] == found["its"]


def test_place_at_the_cursor_on_an_object_and_in_centimetres():
    found = in_addon("""
        scene.cursor.location = (1, 2, 3)
        bpy.ops.gof.add_fire()
        result["cursor"] = list(place.find(scene, "place").location)
        bpy.data.objects["Cube"].location.x = 5
        bpy.context.view_layer.objects.active = bpy.data.objects["Cube"]
        bpy.context.view_layer.update()
        fire.spot = "OBJECT"
        bpy.ops.gof.add_fire()
        result["cube"] = list(place.find(scene, "place").location)
        place.find(scene, "place").location.y = 2
        bpy.context.view_layer.objects.active = place.find(scene, "place")
        bpy.ops.gof.add_fire()
        result["itself"] = list(place.find(scene, "place").location)
        for thing in [t for t in scene.objects if place.part_of(t)]:
            bpy.data.objects.remove(thing)
        bpy.context.view_layer.objects.active = None
        result["none"] = message(bpy.ops.gof.add_fire)
        scene.unit_settings.scale_length = 0.01
        fire.spot = "CURSOR"
        bpy.ops.gof.add_fire(); bpy.ops.gof.add_cameras()
        bpy.context.view_layer.update()
        result["size"] = list(place.find(scene, "domain").dimensions)
        result["same"] = scene_spec.of_scene(scene) == scene_spec.of_settings(scene)
    """)
    assert found["cursor"] == [1, 2, 3]
    np.testing.assert_allclose(found["cube"], [5, 0, 1], atol=1e-6)
    np.testing.assert_allclose(found["itself"], [5, 2, 1], atol=1e-6)
    assert "there is no active object to burn" in found["none"]
    np.testing.assert_allclose(found["size"], [80, 80, 160], rtol=1e-5)
    assert found["same"], "a scene in centimetres is the same spec"


def test_what_is_moved_by_hand_stays_there_when_time_goes_on():
    """Burner and wind have keys of their own (fuel, gusts), of which none may take them back to where they were."""
    found = in_addon("""
        fire.resolution, fire.effects.wind.use, fire.effects.wind.gusts = 16, True, 0.5
        bpy.ops.gof.add_fire()
        for part in ("emitter", "effect"):
            thing = place.find(scene, part)
            result[part] = thing.animation_data.action is not None
            thing.location.x += 0.1
            result[part] = [result[part], tuple(thing.location)]
        scene.frame_set(scene.frame_current + 1)
        for part in ("emitter", "effect"):
            result[part].append(tuple(place.find(scene, part).location))
    """)
    for keyed, put, later in (found["emitter"], found["effect"]):
        assert keyed and later == put


def test_edits_of_the_objects_are_read_back():
    found = in_addon("""
        from math import radians
        bpy.ops.gof.add_fire(); bpy.ops.gof.add_cameras()
        marker, domain, emitter = (place.find(scene, part) for part in ("place", "domain", "emitter"))
        marker.location, marker.rotation_euler[2] = (4, -1, 2), radians(40)
        bpy.context.view_layer.update()
        result["moved"] = scene_spec.of_scene(scene) == scene_spec.of_settings(scene)
        emitter.location.x += 0.1
        emitter.scale = (1.5, 1.5, 1.5)
        domain.scale.x = 1.5
        for camera in place.cameras(scene):
            camera.data.lens, camera.name = 35, "renamed"
        place.cameras(scene)[1].location.z += 0.25
        bpy.context.view_layer.update()
        spec = scene_spec.of_scene(scene)
        result["spec"] = spec.to_dict()
        from gof_blender.scene import rig
        to_ours = place.to_our_world(marker.matrix_world, 1.0)
        result["poses"] = max(float(np.abs(np.array(to_ours @ camera.matrix_world) - np.array(pose)).max())
                              for camera, pose in zip(place.cameras(scene), rig.poses(spec.cameras)))
        domain.rotation_euler[0] = 0.3
        bpy.context.view_layer.update()
        result["turned"] = message(lambda: scene_spec.of_scene(scene))
        domain.rotation_euler[0] = 0
        place.cameras(scene)[0].data.lens = 80
        bpy.context.view_layer.update()
        result["lenses"] = message(lambda: scene_spec.of_scene(scene))
        fire.cameras.count = 5
        result["count"] = message(lambda: scene_spec.of_scene(scene))
    """)
    assert found["moved"], "where the whole stands is no part of the spec"
    spec = found["spec"]
    np.testing.assert_allclose(spec["fire"]["position"][:2], [0.1, 0.0], atol=1e-5)
    assert spec["fire"]["radius"] == pytest.approx(0.195, rel=1e-4)
    np.testing.assert_allclose(spec["domain"]["size"], [1.2, 0.8, 1.6], rtol=1e-5)
    np.testing.assert_allclose(spec["domain"]["min"], [-0.6, -0.4, 0.0], atol=1e-5)
    assert spec["cameras"]["focal_mm"] == 35 and len(spec["cameras"]["placed"]) == 3
    assert spec["cameras"]["placed"][1]["position"][2] == pytest.approx(1.15, abs=1e-5)
    assert found["poses"] < 5e-6
    assert "turned against its empty" in found["turned"] and "different focal lengths" in found["lenses"]
    assert "press Replace Cameras" in found["count"]


def test_save_and_reload_append_and_undo(tmp_path):
    found = in_addon(
        """
        fire.fuel, fire.effects.wind.use, fire.effects.wind.strength = "ethanol", True, 0.9
        scene.gof.benchmark.preset = "standard"
        bpy.ops.gof.add_fire(); bpy.ops.gof.add_cameras()
        before = parts()
        bpy.ops.wm.save_as_mainfile(filepath=sys.argv[1])
        bpy.ops.wm.read_factory_settings()
        result["fresh"] = [parts() == [], bpy.context.scene.gof.fire.fuel]
        bpy.ops.wm.open_mainfile(filepath=sys.argv[1])
        scene = bpy.context.scene
        gof = scene.gof
        wind = gof.fire.effects.wind
        result["reloaded"] = [gof.fire.fuel, wind.use, round(wind.strength, 6), gof.benchmark.preset]
        result["parts"] = parts() == before
        bpy.ops.wm.read_factory_settings()
        with bpy.data.libraries.load(sys.argv[1], link=False) as (theirs, ours):
            ours.collections = ["Fire"]
        other = bpy.data.scenes.new("Other")
        other.collection.children.link(ours.collections[0])
        result["appended"] = [place.find(other, part) is not None for part in ("domain", "emitter")]
        """,
        tmp_path / "fire.blend",
    )
    assert found["fresh"] == [True, "propane_high"]
    assert found["reloaded"] == ["ethanol", True, 0.9, "standard"] and found["parts"]
    assert found["appended"] == [True, True]


def test_operators_can_be_undone():
    found = in_addon("""
        bpy.ops.ed.undo_push(message="before")
        for call in (bpy.ops.gof.add_fire, bpy.ops.gof.add_cameras):
            call("EXEC_DEFAULT", True)
        operators = bpy.types.GOF_OT_add_fire, bpy.types.GOF_OT_add_cameras
        result["flags"] = ["UNDO" in operator.bl_options for operator in operators]
        result["before"] = len(parts())
        bpy.ops.ed.undo(); bpy.ops.ed.undo()
        scene = bpy.context.scene
        result["after"] = len(parts())
        result["cube"] = "Cube" in scene.objects
    """)
    assert found["flags"] == [True, True] and found["before"] == 6
    assert found["after"] == 0 and found["cube"]


def test_bad_settings_are_named_and_change_nothing():
    found = in_addon("""
        fire.radius = 0.6
        result["radius"] = message(bpy.ops.gof.add_fire)
        fire.radius, fire.effects.fine_noise.use, fire.effects.fine_noise.scale = 0.1, True, 99
        result["noise"] = message(bpy.ops.gof.add_fire)
        fire.effects.fine_noise.use, fire.resolution = False, 2048
        result["cells"] = message(bpy.ops.gof.add_fire)
        fire.resolution = 16
        result["parts"] = parts()
        bpy.ops.gof.add_cameras()
        views = []
        for _ in range(4):
            bpy.ops.gof.next_view()
            views.append(scene.camera.name)
        result["views"] = views
        fire.cameras.roll_deg = "0"
        bpy.ops.gof.add_cameras()
        result["size"] = [scene.render.resolution_x, scene.render.resolution_y]
        result["cameras"] = len(place.cameras(scene))
    """)
    x = "the burner reaches from -0.6 to 0.6 m along x, the domain from -0.4 to 0.4 m"
    assert f"Burner: {x}; move it, or change Radius or Domain\n" in found["radius"]
    assert "Fine noise: Scale must be between 2 and 8" in found["noise"]
    assert re.search(r"needs about \d+ GB of memory.* lower Cells from 2048 to \d+", found["cells"])
    assert found["parts"] == []
    assert found["views"] == ["cam_1", "cam_2", "cam_0", "cam_1"]
    assert found["size"] == [1280, 720] and found["cameras"] == 3


def test_a_fire_in_the_users_scene_burns_when_played():
    found = in_addon("""
        fire.resolution, scene.frame_end = 24, 12
        bpy.ops.gof.add_fire()
        domain = place.find(scene, "domain")
        for frame in range(1, 9):
            scene.frame_set(frame)
        settings = domain.evaluated_get(bpy.context.evaluated_depsgraph_get()).modifiers["Fluid"].domain_settings
        flame = np.array(settings.flame_grid)
        result["flame"] = [int(flame.size), float(flame.max())]
    """)
    assert found["flame"][0] == 12 * 12 * 24 and found["flame"][1] > 0.1


def test_every_number_says_its_unit_and_no_label_is_cut():
    """Lengths, angles, times and rates of the panels, by their labels; 15 characters fit the sidebar's first width."""
    found = in_addon("""
        from gof_blender.ui import effect_groups
        groups = {"fire": fire, "cameras": fire.cameras, "benchmark": scene.gof.benchmark}
        groups |= {name: getattr(fire.effects, name) for name in effect_groups.GROUPS}
        for group, owner in groups.items():
            for name, kind in owner.bl_rna.properties.items():
                if kind.type in ("FLOAT", "INT"):
                    result[f"{group}.{name}"] = kind.name
    """)
    units = {"fire.radius": "m", "fire.domain_size": "m", "cameras.arc_deg": "°", "cameras.focal_mm": "mm"}
    units |= {
        "cameras.sensor_px": "px",
        "cameras.fps": "fps",
        "rolling_shutter.readout_s": "s",
        "sync_board.tick_us": "µs",
    }
    units |= {"moving_emitter.reach": "m", "exposure.drift_ev_per_s": "EV/s", "sensor_noise.read_noise": "e⁻"}
    for name, unit in units.items():
        assert found[name].endswith(f"({unit})"), name
    without = {name for name in found if "(" not in found[name]}
    lengths = ("radius", "height", "size", "position", "_deg", "_m", "_s", "_us", "_px", "_mm", "fps")
    assert not {name for name in without if name.endswith(lengths)}
    assert max(map(len, found.values())) <= 20


def test_one_spelling_of_color_in_blenders_window():
    """What the user reads in Blender is spelt as Blender spells it."""
    import ast
    from pathlib import Path

    ui = Path(__file__).parents[2] / "blender_addon" / "ui"
    for path in [*ui.glob("*.py"), ui.parent / "scene" / "gaussian_nodes.py"]:
        tree = ast.parse(path.read_text())
        said = [n.value for n in ast.walk(tree) if isinstance(n, ast.Constant) and isinstance(n.value, str)]
        own = [
            ast.get_docstring(n, clean=False) for n in ast.walk(tree) if isinstance(n, (ast.Module, ast.FunctionDef))
        ]
        assert not [text for text in said if "olour" in text and text not in own], path
