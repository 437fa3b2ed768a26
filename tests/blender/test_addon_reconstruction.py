"""The panel Reconstruction in real Blender: import by operator, settings, bad files, undo, saved clouds."""

import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gof.core.gaussians import TransientGaussians
from tests.blender.runs import in_blender
from tests.conftest import random_gaussians

pytestmark = pytest.mark.blender

ROOT = Path(__file__).resolve().parents[2]
BLENDER = shutil.which("blender")
# Works in all Blender versions: a cloud is a point cloud or a mesh among the instances of the evaluated scene.
LOOK = """
import os, sys, traceback
from pathlib import Path

def stop(*error):  # a Python process with bpy may hang at its end
    traceback.print_exception(*error)
    sys.stderr.flush()
    os._exit(1)

sys.excepthook = stop
import bpy
import numpy as np
import gof_blender
from gof_blender.scene import point_cloud

folder = Path(sys.argv[-1])
bpy.ops.wm.read_factory_settings(use_empty=True)
gof_blender.register()
scene = bpy.context.scene
scene.render.fps = 50

def drawn(thing):
    graph = bpy.context.evaluated_depsgraph_get()
    for instance in graph.object_instances:
        data = instance.object.data
        if instance.object.original == thing and "gs_alpha" in getattr(data, "attributes", {}):
            return data, np.array(instance.matrix_world)
    return None, None

def values(data, name, width):
    attribute = data.attributes[name]
    out = np.zeros(len(attribute.data) * width, np.float32)
    attribute.data.foreach_get({1: "value", 3: "vector", 4: "color"}[width], out)
    return out.reshape(-1, width).astype(float)

def instanced(thing):
    "World positions of the corners of instances, and ones for their opacities."
    places = [np.zeros((0, 3))]
    for instance in bpy.context.evaluated_depsgraph_get().object_instances:
        data = instance.object.data
        if instance.is_instance and instance.parent.original == thing and getattr(data, "vertices", None):
            corners = np.zeros(len(data.vertices) * 3, np.float32)
            data.vertices.foreach_get("co", corners)
            matrix = np.array(instance.matrix_world)
            places.append(corners.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3])
    place = np.concatenate(places)
    return place, np.ones(len(place))

def state(thing):
    "World positions and opacities of what is drawn; of ellipsoids, of every vertex."
    data, matrix = drawn(thing)
    if data is None:
        return instanced(thing)
    if hasattr(data, "vertices"):
        place = np.zeros(len(data.vertices) * 3, np.float32)
        data.vertices.foreach_get("co", place)
        place = place.reshape(-1, 3).astype(float)
    else:
        place = values(data, "position", 3)
    return place @ matrix[:3, :3].T + matrix[:3, 3], values(data, "gs_alpha", 1)[:, 0]

def everything():
    return sorted((kind, item.name) for kind in ("objects", "meshes", "materials", "node_groups", "images", "scenes")
                  for item in getattr(bpy.data, kind))
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """One result in every form that the panel imports."""
    from gof.core.ftgs import save
    from tests.blender.test_gaussians_file import plain_ply

    folder = tmp_path_factory.mktemp("results")
    result = random_gaussians(300)
    result.save(folder / "result.npz")
    result.save(folder / "result.ply")
    save(result, folder / "clip.ftgs.ply", start_s=0.0, end_s=1.0)
    (folder / "sequence").mkdir()
    for number in (0, 1, 2):
        result.position[:] += 0.1
        plain_ply(folder / "sequence" / f"{number:04d}.ply", result)
    return folder


def at(result: TransientGaussians, time_s: float) -> tuple[np.ndarray, np.ndarray]:
    position, opacity = result.at(time_s)
    seen = opacity >= 1 / 255
    return position[seen], opacity[seen]


def test_every_format_and_every_mode(folder):
    found = in_blender(
        LOOK
        + """
scene.frame_set(26)
files = {"result.npz": {}, "result.ply": {}, "clip.ftgs.ply": {"clip_seconds": 1.0}, "sequence/0001.ply": {}}
for name, options in files.items():
    bpy.ops.gof.import_result(filepath=str(folder / name), **options)
    result[name] = [bpy.context.object.name, len(state(bpy.context.object)[1])]
bpy.ops.gof.import_result(directory=str(folder / "sequence"), fps=10.0)
thing = bpy.context.object
for frame in (1, 3.5, 8):
    scene.frame_set(int(frame), subframe=frame % 1)
    result[f"sequence at {frame}"] = state(thing)[0].mean(0).tolist()
scene.frame_set(16)
result["after the sequence"] = len(state(thing)[1])
files = [{"name": "0002.ply"}, {"name": "0000.ply"}]
bpy.ops.gof.import_result(directory=str(folder / "sequence"), files=files, fps=10.0)
result["two files"] = len(bpy.context.object.data.vertices)
bpy.ops.gof.import_result(filepath=str(folder / "result.npz"), step=4)
result["every fourth"] = len(bpy.context.object.data.vertices)
settings = scene.gof.reconstruction
for mode in ("ellipsoids", "arrows", "streaks", "points"):
    settings.mode = mode
    result[mode] = [type(drawn(bpy.context.object)[0]).__name__, settings.mode, len(state(bpy.context.object)[0])]
""",
        folder,
    )
    result = TransientGaussians.load(folder / "result.npz")
    shown = len(at(result, 0.5)[0])
    assert found["result.npz"] == ["result", shown] and found["result.ply"] == ["result.001", shown]
    assert found["clip.ftgs.ply"][1] > shown / 2 and found["sequence/0001.ply"] == [
        "0001",
        (result.opacity >= 1 / 255).sum(),
    ]
    mean = result.position[result.opacity >= 1 / 255].mean(0).astype(float)
    for frame, steps in ((1, 1), (3.5, 1.5), (8, 2.4)):  # 10 files and 50 frames per second
        assert found[f"sequence at {frame}"] == pytest.approx(mean + 0.1 * steps, abs=1e-4)
    assert found["after the sequence"] == 0
    assert found["two files"] == 600 and found["every fourth"] == 75
    shown = found["points"][2]
    assert shown and found["points"] == ["PointCloud", "points", shown]
    assert found["ellipsoids"] == ["PointCloud", "ellipsoids", shown], "in the viewport; renders have meshes"
    for mode, corners in (("arrows", 10), ("streaks", 4)):
        assert found[mode] == ["NoneType", mode, corners * shown], "instances; renders have meshes"


def test_arrows_and_streaks_are_the_way_of_line_time(folder):
    found = in_blender(
        LOOK
        + """
bpy.ops.gof.import_result(filepath=str(folder / "one.npz"))
thing = bpy.context.object
cloud = point_cloud.inputs(thing)
cloud["Line Time"] = 0.25
scene.frame_set(1)
for mode in ("arrows", "streaks"):
    scene.gof.reconstruction.mode = mode
    place, _ = state(thing)
    along = place @ np.array([0, 0.6, 0.8])
    axis = np.outer(along, [0, 0.6, 0.8])
    result[mode] = [along.min(), along.max(), float(np.linalg.norm(place - axis, axis=1).max())]
scene.gof.reconstruction.mode = "arrows"
point_cloud.add_column(thing.data, "gs_true_velocity", np.array([[0, 0, 1.0]], np.float32))
for vectors in ("true velocity", "error"):
    scene.gof.reconstruction.vectors = vectors
    place, _ = state(thing)
    result[vectors] = place[np.linalg.norm(place, axis=1).argmax()].tolist()
cloud["Time Scale"] = 0.5
scene.gof.reconstruction.mode = "points"
result["velocity"] = values(drawn(thing)[0], "velocity", 3)[0].tolist()
""",
        one_gaussian(folder, velocity=[0, 1.2, 1.6]),
    )
    assert found["arrows"] == pytest.approx([0, 0.5, 0.5 * 0.09], abs=1e-5)  # 2 m/s for 0.25 s
    assert found["streaks"] == pytest.approx([-0.5, 0, 0.3 * 0.02], abs=1e-5)
    assert found["true velocity"] == pytest.approx([0, 0, 0.25], abs=1e-5)
    assert found["error"] == pytest.approx([0, 0.3, 0.15], abs=1e-5)
    assert found["velocity"] == pytest.approx([0, 0.6, 0.8], abs=1e-5)  # of what is seen at half speed


def one_gaussian(folder: Path, velocity=(0, 0, 0), t_sigma=np.inf) -> Path:
    TransientGaussians(
        position=[[0, 0, 0]],
        velocity=[velocity],
        t_mu=[0],
        t_sigma=[t_sigma],
        scale=[[0.02] * 3],
        rotation=[[1, 0, 0, 0]],
        opacity=[1],
        color=[[1, 0.5, 0.25]],
        dynamic=[True],
    ).save(folder / "one.npz")
    return folder


def test_colours_opacity_cut_share_and_emission(folder):
    found = in_blender(
        LOOK
        + """
bpy.ops.gof.import_result(filepath=str(folder / "result.npz"))
thing, settings = bpy.context.object, scene.gof.reconstruction
cloud = point_cloud.inputs(thing)
scene.frame_set(26)

def colors():
    return values(drawn(thing)[0], "gs_color", 4)

image = colors()
speed = np.linalg.norm(values(drawn(thing)[0], "velocity", 3), axis=1)
settings.color = "error"
result["before scoring"] = settings.color
point_cloud.add_column(thing.data, "gs_true_velocity", np.zeros((len(thing.data.vertices), 3)))
for color in ("speed", "age", "lifetime", "error"):
    settings.color = color
    low, high = cloud["Color Min"], cloud["Color Max"]
    result[color] = [low, high, colors()[:, 3].max()]
    if color == "speed":
        result["order"] = [int(colors()[speed.argmin(), 0] < 0.3), int(colors()[speed.argmax(), 0] > 0.9)]
        cloud["Color Max"] = 2 * high
        result["poll"] = bpy.ops.gof.fit_colors.poll()
        bpy.ops.gof.fit_colors()
        result["fitted"] = cloud["Color Max"] == high
settings.color = "image"
result["same again"] = bool((colors() == image).all())
cloud["Emission"], cloud["Light on Scene"] = 3.0, 0.25
result["emission"] = [float(np.abs(colors()[:, :3] / np.maximum(image[:, :3], 1e-9) - 3).max()), float(colors()[0, 3])]
cloud["Opacity Cut"] = 0.3
result["cut"] = state(thing)[1].tolist()
cloud["Share"] = 0.5
result["share"] = state(thing)[1].tolist()
scene.frame_set(27)
scene.frame_set(26)
result["share again"] = state(thing)[1].tolist()
""",
        folder,
    )
    result = TransientGaussians.load(folder / "result.npz")
    speed = np.linalg.norm(result.velocity[result.dynamic], axis=1)
    assert found["speed"][0] == 0 and np.percentile(speed, 90) < found["speed"][1] <= speed.max()
    assert found["age"][0] == -found["age"][1] < 0 < found["lifetime"][0] < found["lifetime"][1] < 0.5
    assert [found[color][2] for color in ("speed", "age", "lifetime", "error")] == [
        0
    ] * 4  # a colour map lights nothing
    assert found["before scoring"] == "image", "there is no error yet to show"
    assert found["error"][:2] == found["speed"][:2], "against a truth that stands still"
    assert found["order"] == [1, 1] and found["poll"] and found["fitted"] and found["same again"]
    assert found["emission"][0] < 1e-4 and found["emission"][1] == 0.25
    opacity = at(result, 0.5)[1]
    assert len(found["cut"]) == (opacity >= 0.3).sum() > 0 and min(found["cut"]) >= 0.3
    assert 0.3 < len(found["share"]) / len(found["cut"]) < 0.7 and found["share"] == found["share again"]
    assert set(found["share"]) < set(found["cut"])


def test_colour_by_how_sure_the_velocity_is(tmp_path):
    """Dark where the velocity is sure; where nobody says how sure, as bright as its speed; refused without."""
    result = replace(random_gaussians(60), t_sigma=np.full(60, np.inf), dynamic=np.ones(60, bool))
    result.save(tmp_path / "silent.npz")
    uncertainty = np.linspace(0, 1, 60)
    uncertainty[7] = np.inf
    replace(result, velocity_sd=uncertainty).save(tmp_path / "unsure.npz")
    found = in_blender(
        LOOK
        + """
for name in ("unsure", "silent"):
    bpy.ops.gof.import_result(filepath=str(folder / f"{name}.npz"))
    thing = bpy.context.object
    scene.gof.reconstruction.color = "uncertainty"
    cloud = point_cloud.inputs(thing)
    cloud["Opacity Cut"] = 0.0
    data = drawn(thing)[0]
    result[name] = [values(data, "gs_color", 4)[:, :3].tolist(), cloud["Color Max"], scene.gof.reconstruction.color]
""",
        tmp_path,
    )
    shown = np.array(found["unsure"][0])
    speed = np.linalg.norm(result.velocity[7])
    assert found["unsure"][1] == pytest.approx(np.percentile(np.append(np.delete(uncertainty, 7), speed), 98), rel=1e-5)
    assert shown[0, 1] < 0.02 and shown[0, 2] > shown[0, 0], "the dark end of the map is violet"
    assert shown[-1, 0] > 0.9 and shown[-1, 2] < 0.1, "the bright end is yellow"
    assert found["silent"][2] == "image", "there is nothing to colour by"


@pytest.mark.parametrize(
    "name, options, message",
    [
        ("nothing.npz", "", "no such file"),
        ("readme.txt", "", "unknown suffix"),
        ("empty", "", "no numbered"),
        ("truncated.ply", "", "truncated"),
        ("cut.npz", "", "not a readable npz"),
        ("none.npz", "", "0 points"),
        ("nan.npz", "", "NaN or Inf"),
        ("clip.ftgs.ply", "", "set Clip ("),
        ("huge.ply", "", "Set Every n-th to 5 or more"),
        ("huge.ply", "step=3", "tick No Limit"),
    ],
)
def test_bad_input_is_an_error_and_changes_nothing(folder, bad_files, name, options, message):
    found = in_blender(
        LOOK
        + f"""
bpy.ops.mesh.primitive_cube_add()
before = everything()
try:
    result["answer"] = list(bpy.ops.gof.import_result(filepath=str(folder / "{name}"), {options}))
except RuntimeError as error:
    result["error"] = str(error)
result["same"] = everything() == before and bpy.context.object.name == "Cube"
""",
        bad_files,
    )
    assert message in found["error"] and (name in found["error"] or name == "huge.ply")
    assert found["same"] and "answer" not in found


@pytest.fixture(scope="module")
def bad_files(folder) -> Path:
    bad = folder / "bad"
    bad.mkdir()
    (bad / "empty").mkdir()
    (bad / "readme.txt").write_text("hello")
    lines = (folder / "clip.ftgs.ply").read_bytes().split(b"\n")  # as others write it, without its seconds
    (bad / "clip.ftgs.ply").write_bytes(b"\n".join(x for x in lines if not x.startswith(b"comment gof_clip_s")))
    for name, source, keep in (("truncated.ply", "result.ply", -9), ("cut.npz", "result.npz", 2000)):
        (bad / name).write_bytes((folder / source).read_bytes()[:keep])
    with np.load(folder / "result.npz") as data:
        fields = dict(data)
    np.savez(bad / "none.npz", **{k: v[:0] if v.ndim else v for k, v in fields.items()})
    np.savez(bad / "nan.npz", **(fields | {"v": np.full_like(fields["v"], np.nan)}))
    # Ten million points: a file of the right size without content on disk.
    data = (folder / "result.ply").read_bytes()
    head, _, body = data.partition(b"end_header\n")
    record = len(body) // 300
    with (bad / "huge.ply").open("wb") as file:
        file.write(head.replace(b"element vertex 300", b"element vertex 10000000") + b"end_header\n")
        file.truncate(file.tell() + 10_000_000 * record)
    return bad


def test_undo_register_twice_save_append_and_link(folder, tmp_path):
    found = in_blender(
        LOOK
        + """
for _ in range(2):
    gof_blender.unregister()
    gof_blender.register()
result["property"] = hasattr(scene, "gof") and hasattr(bpy.types, "GOF_PT_reconstruction")
gof_blender.unregister()
result["gone"] = not hasattr(scene, "gof") and not hasattr(bpy.types, "GOF_PT_reconstruction")
gof_blender.register()

bpy.ops.ed.undo_push(message="start")
before = everything()
bpy.ops.gof.import_result("EXEC_DEFAULT", True, filepath=str(folder / "result.npz"))
bpy.ops.ed.undo()
result["undone"] = everything() == before
bpy.ops.ed.redo()
scene = bpy.context.scene
thing = bpy.data.objects["result"]
thing.name = "Campfire"
thing.scale = (2, 1, 1)
scene.frame_set(26)
first = state(thing)
result["count"] = len(first[1])
blend, other = str(folder / "scene.blend"), bpy.context.scene
scene.name = "First Scene"
bpy.ops.wm.save_as_mainfile(filepath=blend)

def same(thing):
    now = state(thing)
    return len(now[1]) == len(first[1]) and all(float(np.abs(a - b).max()) < 1e-6 for a, b in zip(now, first))

bpy.ops.wm.open_mainfile(filepath=blend)
bpy.context.scene.frame_set(26)
result["reloaded"] = same(bpy.data.objects["Campfire"])
for link in (False, True):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.render.fps = 50
    with bpy.data.libraries.load(blend, link=link) as (there, here):
        here.objects = ["Campfire"]
    thing = here.objects[0]
    bpy.context.scene.collection.objects.link(thing)
    bpy.context.scene.frame_set(26)
    start = point_cloud.inputs(thing)["Start Frame"]
    result["linked" if link else "appended"] = [same(thing), thing.name, len(bpy.data.scenes), start]
""",
        folder_with(folder, tmp_path),
    )
    assert found["property"] and found["gone"] and found["undone"]
    assert found["count"] > 100 and found["reloaded"]
    assert found["appended"] == found["linked"] == [True, "Campfire", 1, 1.0]


def folder_with(folder: Path, tmp_path: Path) -> Path:
    shutil.copy(folder / "result.npz", tmp_path)
    return tmp_path


def test_drop_and_menu():
    found = in_blender("""
import gof_blender
gof_blender.register()
handler = bpy.types.GOF_FH_result
result["drop"] = [handler.bl_import_operator, handler.bl_file_extensions, handler.poll_drop(bpy.context)]
result["menu"] = len(bpy.types.TOPBAR_MT_file_import._dyn_ui_initialize())
gof_blender.unregister()
result["menu after"] = len(bpy.types.TOPBAR_MT_file_import._dyn_ui_initialize())
""")
    assert found["drop"] == ["gof.import_result", ".npz;.ply", False]  # no area without a window
    assert found["menu"] == found["menu after"] + 1


@pytest.mark.skipif(not BLENDER, reason="no Blender application on this machine (Debian: apt-get install blender)")
def test_debians_blender(folder, tmp_path):
    """Blender 3.4: import by operator, all modes, the same positions and opacities."""
    (tmp_path / "gof_blender").symlink_to(ROOT / "blender_addon")  # the name that the installed package has
    script = tmp_path / "look.py"
    script.write_text(
        f"import sys\nsys.path.insert(0, {str(tmp_path)!r})\n"
        + LOOK
        + """
bpy.ops.gof.import_result(filepath=str(folder / "result.npz"), start_frame=-4.5)
thing = bpy.context.object
first_mode = scene.gof.reconstruction.mode
scene.gof.reconstruction.mode = "points"
from mathutils import Matrix
thing.matrix_world = Matrix(((0, -2, 0, 1), (1, 0, 0, 2), (0, 0, 0.5, 3), (0, 0, 0, 1)))
scene.render.fps, scene.render.fps_base = 60, 1.5
scene.frame_set(10, subframe=0.25)
bpy.context.view_layer.update()
place, alpha = state(thing)
counts = []
for mode in ("ellipsoids", "arrows", "streaks"):
    scene.gof.reconstruction.mode = mode
    counts.append(len(state(thing)[1]))
scene.gof.reconstruction.color = "speed"
np.savez(folder / "seen.npz", place=place, alpha=alpha, counts=counts, version=bpy.app.version, first_mode=first_mode)
gof_blender.unregister()
"""
    )
    run = subprocess.run(
        [BLENDER, "-b", "--factory-startup", "--python-exit-code", "1", "--python", str(script), "--", str(folder)],
        capture_output=True,
        text=True,
        timeout=120,
        cwd=tmp_path,
    )
    assert run.returncode == 0, run.stdout[-2000:] + run.stderr[-2000:]
    seen = np.load(folder / "seen.npz")
    assert seen["first_mode"] == ("points" if tuple(seen["version"]) >= (4, 2) else "ellipsoids")
    position, opacity = at(TransientGaussians.load(folder / "result.npz"), 14.75 / 40)
    assert np.abs(seen["alpha"] - opacity).max() < 1e-5
    matrix = np.array([[0, -2, 0], [1, 0, 0], [0, 0, 0.5]])
    assert np.abs(seen["place"] - (position @ matrix.T + [1, 2, 3])).max() < 1e-5
    n = len(opacity)
    assert seen["counts"].tolist() == [12 * n, 10 * n, 4 * n]


def test_the_first_minute(folder):
    """A new file is fitted to the clip, a user's timeline is left alone; what is imported can be seen in EEVEE."""
    found = in_blender(
        LOOK
        + """
from gof_blender.scene import clip_in_scene, gaussian_nodes
timeline = lambda: [scene.frame_start, scene.frame_end, scene.render.fps, scene.render.fps_base]
def load(name, **options):
    bpy.ops.gof.import_result(filepath=str(folder / name), **options)
    return bpy.context.object
result["quick"] = gaussian_nodes.QUICK
load("result.npz")
result["users"] = timeline()
scene.render.fps = 24
thing = load("result.npz")
result["mode"] = scene.gof.reconstruction.mode
result["new"], result["line"], result["clip"] = timeline(), clip_in_scene.line(scene, thing), list(thing["gof_clip_s"])
scene.frame_start, scene.frame_end, scene.render.fps = 1, 250, 24
load("result.npz", fit="keep")
result["kept"] = timeline()
point_cloud.inputs(bpy.context.object)["Time Scale"] = 0.1
bpy.ops.gof.fit_scene()
result["slow"] = timeline()
point_cloud.inputs(bpy.context.object)["Start Frame"] = -500
bpy.ops.gof.fit_scene()
result["moved"] = [timeline()[:2], point_cloud.inputs(bpy.context.object)["Start Frame"]]
bpy.ops.gof.import_result(directory=str(folder / "sequence"), fps=10.0, fit="fit")
result["sequence"] = timeline()
load("sequence/0001.ply", fit="fit")
result["still"] = [timeline() == result["sequence"], bpy.ops.gof.fit_scene.poll()]
""",
        folder,
    )
    result = TransientGaussians.load(folder / "result.npz")
    fading = result.dynamic & np.isfinite(result.t_sigma)
    first, last = np.percentile(result.t_mu[fading], [1, 99])
    assert found["quick"] == found["mode"] == "points", "Blender 4.2 and later draw points in every view"
    assert found["clip"] == pytest.approx([first, last], abs=1e-6)
    assert found["users"] == [1, 250, 50, 1.0] and found["kept"] == [1, 250, 24, 1.0]
    rate = next(rate for rate in (24, 25, 30, 50) if rate * (last - first) >= 30)  # 30 frames are no flicker
    assert found["new"] == [round(1 + first * rate), round(1 + last * rate), rate, 1.0]
    assert f"frames {found['new'][0]} to {found['new'][1]} at {rate} fps" in found["line"]
    assert found["slow"] == [round(1 + 240 * first), round(1 + 240 * last), 24, 1.0], "long enough at the scene's rate"
    assert found["moved"] == [[1, round(1 + 240 * (last - first))], pytest.approx(1 - 240 * first, abs=1e-3)]
    assert found["sequence"] == [1, 1 + 0.3 * 100, 100, 1.0], "three files, 10 a second"
    assert found["still"] == [True, False]


def test_a_view_from_where_no_camera_filmed_is_a_guess(folder):
    """Cameras at -35, 0 and 35 degrees on an arc; those held out do not count, nor does a camera of the user's own."""
    found = in_blender(
        LOOK
        + """
import math
from mathutils import Vector
from gof_blender.scene import captured

def add(name, degrees, of_ours=True):
    camera = bpy.data.objects.new(name, bpy.data.cameras.new(name))
    camera.rotation_euler = (math.pi / 2, 0, math.radians(degrees))
    scene.collection.objects.link(camera)
    if of_ours:
        camera[captured.NAME] = name

def guess(degrees):
    bpy.context.view_layer.update()
    return captured.guess(scene, Vector((-math.sin(math.radians(degrees)), math.cos(math.radians(degrees)), 0)))

add("mine", 180, of_ours=False)
result["none"] = guess(0)
for number, degrees in enumerate((-35, 0, 35)):
    add(f"cam_{number}", degrees)
add("eval_0", 120)
add("around_3", 180)
result["words"] = [guess(degrees) for degrees in (0, 17, 54, 56, 90, 180, -125)]
""",
        folder,
    )
    assert found["none"] == "Sides that no camera filmed are guesses"
    away = [None, None, None, 21, 55, 145, 90]
    said = "{}\N{DEGREE SIGN} from the nearest camera: its shape is a guess"
    assert found["words"] == [None if angle is None else said.format(angle) for angle in away]
