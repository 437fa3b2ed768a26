"""Objects of a user's own scene in the fire: said where the gas does not feel them, obstacles where Blender says so."""

import re
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from gof_blender.core.checked_json import SpecError
from gof_blender.pure import bodies, dataset_process, plausibility
from gof_blender.pure.effects.obstacles import Obstacle, Settings
from gof_blender.pure.fires import Domain, GridFire
from gof_blender.pure.layout import Layout
from gof_blender.pure.spec import BlendFile, SceneSpec
from tests.blender.runs import TOY
from tests.blender.test_addon_fire import in_addon

PLAIN = SceneSpec("plain", background="studio", domain=Domain(resolution=32))  # cells of 5 cm; burner at z = 0.12


def cut(triangle: np.ndarray, low: np.ndarray, high: np.ndarray) -> list:
    """Corners of what a box leaves of a triangle: Sutherland and Hodgman, one side after another."""
    corners = list(triangle)
    for axis in range(3):
        for sign, limit in ((1, high[axis]), (-1, -low[axis])):
            kept = []
            for here, there in zip(corners, corners[1:] + corners[:1], strict=True):
                a, b = limit - sign * here[axis], limit - sign * there[axis]
                kept += [here] if a >= 0 else []
                kept += [here + (there - here) * a / (a - b)] if a * b < 0 else []
            corners = kept
    return corners


def test_triangles_that_reach_into_a_box_are_those_that_cutting_leaves():
    rng = np.random.default_rng(0)
    low, high = np.array([-0.4, -0.3, 0.0]), np.array([0.5, 0.3, 1.2])
    triangles = rng.uniform(-1, 1.5, (3000, 1, 3)) + rng.normal(0, 1, (3000, 3, 3)) * rng.choice([0.1, 3], (3000, 1, 1))
    expected = np.array([bool(cut(triangle, low, high)) for triangle in triangles])
    assert 300 < expected.sum() < 2700
    np.testing.assert_array_equal(bodies.reach_into(triangles, low, high), expected)
    assert bodies.reach_into(np.empty((0, 3, 3)), low, high).shape == (0,)


def box(centre, size, name="Thing", **more) -> bodies.Body:
    """The twelve triangles of a box."""
    corner = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * np.array(size) / 2 + centre
    quads = [(0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5)]
    return bodies.Body(name, np.array([corner[[q[0], *q[k : k + 2]]] for q in quads for k in (1, 2)]), **more)


def test_what_the_gas_does_not_feel_is_said_with_the_obstacle_that_would_be_right():
    (note,) = bodies.notes(PLAIN, [box((0.1, 0, 0.8), (0.3, 0.2, 0.2), "Shelf")])
    assert "'Shelf' is in the domain and no obstacle" in note
    assert "shape box, position (0.1, 0, 0.8), size (0.3, 0.2, 0.2) m" in note
    right = replace(PLAIN, effects=(Settings((Obstacle("box", (0.1, 0.0, 0.8), (0.3, 0.2, 0.2)),)),))
    assert not [*plausibility.findings(right)]
    half_out = bodies.notes(PLAIN, [box((0.4, 0, 0.8), (0.4, 0.2, 0.2))])
    assert "position (0.3, 0, 0.8), size (0.2, 0.2, 0.2) m" in half_out[0], "only what is in the domain"
    (thin,) = bodies.notes(PLAIN, [box((0, 0, 0.8), (0.4, 0.4, 0.01))])
    assert "size (0.4, 0.4, 0.152)" in thin, "three cells, through which no gas leaks"
    tunnel = bodies.Body(
        "Tunnel", np.r_[box((0, 0, 0.8), (0.3, 0.3, 0.1)).triangles, box((0, 0, 0), (1, 1, 0.1)).triangles]
    )
    (note,) = bodies.notes(PLAIN, [tunnel])
    assert "'Tunnel'" in note and "effects.obstacles" not in note, "a block there would stand on the burner"


def test_what_is_harmless_is_not_said():
    harmless = [
        box((0, 0, -0.05), (4, 4, 0.1), "Floor"),
        box((0, 0, 2), (9, 9, 9), "Room"),
        box((0.6, 0, 0.8), (0.4, 3, 3), "Wall at its side"),
        box((2, 0, 0.8), (1, 1, 1), "Far"),
        box((0.1, 0, 0.8), (0.3, 0.2, 0.2), "Stone", is_obstacle=True),
    ]
    assert bodies.notes(PLAIN, harmless) == []
    grids = replace(PLAIN, domain=None, fire=GridFire("pool"))
    assert bodies.notes(grids, [box((0, 0, 0.8), (0.2, 0.2, 0.2))]) == [], "another solver knew what stood there"


def test_what_stands_in_the_burner_is_said():
    (note,) = bodies.notes(PLAIN, [box((0, 0, 0.1), (0.2, 0.05, 0.05), "Log")])
    assert "'Log' stands in the burner at (0, 0, 0.12): fuel comes out of it" in note
    (note,) = bodies.notes(PLAIN, [box((0, 0, 0.1), (0.2, 0.05, 0.05), "Stone", is_obstacle=True)])
    assert "no gas comes out there" in note


def test_many_are_told_in_one_line():
    told = bodies.notes(PLAIN, [box((0, 0, 0.8), (0.1, 0.1, 0.1), f"Tile {number}") for number in range(20)])
    assert len(told) == 4 and told[3].startswith("and 17 more: 'Tile 3', ") and told[3].endswith("'Tile 12' ...")


MAKE = """
import bpy, os, sys
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.unit_settings.scale_length = 0.01  # drawn in centimetres
def link(name, data, place=(0, 0, 0)):
    thing = bpy.data.objects.new(name, data)
    thing.location = place
    scene.collection.objects.link(thing)
    return thing
def box(name, place, size):
    bpy.ops.mesh.primitive_cube_add(size=1, location=[100 * x for x in place])
    thing = bpy.context.object
    thing.name, thing.scale = name, [100 * x for x in size]
    return thing
link("Fire", None)
box("Floor", (0, 0, -0.5), (9, 9, 1))
box("Room", (0, 0, 2), (9, 9, 9))
link("Lamp", bpy.data.lights.new("Lamp", "POINT"), (0, 0, 80))
link("Camera", bpy.data.cameras.new("Camera"), (0, 0, 80))
box("Hidden", (0, 0, 1), (0.3, 0.3, 0.3)).hide_render = True
box("Log", (0, 0, 0.12), (0.1, 0.1, 0.02))
shelf = box("Shelf", (0.1, 0.1, 1.2), (0.4, 0.3, 0.3))
text = link("Sign", bpy.data.curves.new("Sign", "FONT"), (-20, 0, 100))
text.data.body, text.data.size = "X", 30
crate = box("Crate", (0, 0, 0), (0.3, 0.3, 0.3))
pile = bpy.data.collections.new("Pile")
pile.objects.link(crate)
scene.collection.objects.unlink(crate)
shown = link("Crates", None, (10, 0, 140))
shown.instance_type, shown.instance_collection = "COLLECTION", pile
def effector(name, place, size, kind="COLLISION"):
    thing = box(name, place, size)
    modifier = thing.modifiers.new("Fluid", "FLUID")
    modifier.fluid_type = "EFFECTOR"
    modifier.effector_settings.effector_type = kind
    return thing
effector("Stone", (0, 0, 0.7), (0.48, 0.48, 0.3))
effector("Unseen", (0.22, 0.22, 0.36), (0.32, 0.32, 0.3)).hide_render = True
effector("Guide", (0.3, -0.3, 1.4), (0.1, 0.1, 0.1), "GUIDE")
bpy.context.view_layer.update()
bpy.ops.wm.save_as_mainfile(filepath=sys.argv[1])
os._exit(0)
"""


@pytest.fixture(scope="module")
def users(tmp_path_factory) -> SceneSpec:
    path = tmp_path_factory.mktemp("user") / "cellar.blend"
    made = subprocess.run([sys.executable, "-c", MAKE, str(path)], capture_output=True, text=True)
    assert path.is_file(), made.stderr[-2000:]
    long = replace(TOY.clip, warm_up_frames=40)  # until there is gas at the shelf
    return replace(TOY, clip=long, background="blend_file", blend_file=BlendFile(str(path), "Fire"))


@pytest.mark.blender
def test_a_look_into_the_users_file_names_what_stands_in_the_flame(users):
    notes = dataset_process.scene_notes(users, [sys.executable, "-c"])
    named = sorted(re.findall(r"'(\w+)'", " ".join(notes)))
    assert named == ["Crates", "Guide", "Log", "Shelf", "Sign"], "and neither floor, room, lamp, obstacles nor hidden"
    shelf = next(note for note in notes if "'Shelf'" in note)
    assert "position (0.1, 0.1, 1.2), size (0.4, 0.3, 0.3) m" in shelf, "in our metres, whatever the file's unit is"
    wrong = replace(users, blend_file=replace(users.blend_file, empty="Hearth"))
    with pytest.raises(SpecError, match="no object 'Hearth'; its empties: Crates, Fire"):
        dataset_process.scene_notes(wrong, [sys.executable, "-c"])


@pytest.mark.blender
def test_gas_flows_around_effectors_of_the_file_and_through_everything_else(users, tmp_path):
    """Seen and hidden ones, and again from the surroundings that the dataset keeps."""
    from gof.core.fields import VelocitySequence
    from gof_benchmark.generator.blender_process import run_stage

    layout = Layout(tmp_path / "data")
    layout.claim(users)
    for stage in ("bake", "ground-truth"):
        run_stage(stage, layout.root)
    field = VelocitySequence.open(layout.velocity).at(0.05)
    speed = np.linalg.norm(field.velocity.astype(float), axis=-1)
    centres = np.stack(np.meshgrid(*(np.arange(n) + 0.5 for n in speed.shape), indexing="ij"), -1)
    world = centres @ field.index_to_world[:3, :3].T + field.index_to_world[:3, 3]

    def fastest(centre, size):
        """In what is one cell inside."""
        inside = (np.abs(world - centre) < np.array(size) / 2 - field.index_to_world[2, 2]).all(-1)
        assert inside.any()
        return speed[inside].max() / speed.max()

    assert fastest((0, 0, 0.7), (0.48, 0.48, 0.3)) < 0.02, "Stone"
    assert fastest((0.22, 0.22, 0.36), (0.32, 0.32, 0.3)) < 0.02, "Unseen"
    assert fastest((0.1, 0.1, 1.2), (0.4, 0.3, 0.3)) > 0.02, "the shelf is air"
    kept = replace(users, blend_file=replace(users.blend_file, path=str(layout.background)))
    again = " ".join(dataset_process.scene_notes(kept, [sys.executable, "-c"]))
    assert "'Shelf'" in again and "'Stone'" not in again and "'Unseen'" not in again


@pytest.mark.blender
def test_the_panel_says_it_of_this_scene(tmp_path):
    """Also after an object has been moved; and the open file stays as it is."""
    found = in_addon(
        """
        from gof_blender.ui import benchmark
        from mathutils import Matrix, Vector
        fire.spot = "OBJECT"
        bpy.context.view_layer.objects.active = bpy.data.objects["Cube"]
        bpy.ops.gof.add_fire(); bpy.ops.gof.add_cameras()
        bpy.ops.mesh.primitive_cube_add(size=0.3, location=(0.1, 0, 1 + 0.8))  # the fire burns on the cube, at z = 1
        beam = bpy.context.object
        beam.name = "Beam"
        scene.gof.benchmark.folder = sys.argv[1]
        blocks = lambda: [len(bpy.data.objects), len(bpy.data.meshes)]
        def said(again=False):
            bpy.context.view_layer.update()
            spec, _ = benchmark.planned(scene)
            return benchmark._in_this_scene(bpy.context, spec, again)
        before = blocks()
        result["there"], result["asked again"] = said(), said(True)
        beam.location.x = 5
        result["away"] = said()
        beam.location.x = 0.1
        beam.modifiers.new("Fluid", "FLUID").fluid_type = "EFFECTOR"
        result["effector"] = said()
        result["same"] = blocks() == before
        """,
        tmp_path / "data",
    )
    (note,) = found["there"]
    assert "'Beam' is in the domain" in note and "position (0.1, 0, 0.8), size (0.3, 0.3, 0.3) m" in note
    assert found["asked again"] == found["there"] and found["away"] == found["effector"] == [] and found["same"]
