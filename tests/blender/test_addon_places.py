"""Units, places, names and paths on the way into Blender and out: held against the camera model and the formulas."""

import json

import numpy as np
import pytest

from gof.core.gaussians import TransientGaussians
from gof_blender.pure.io import camera_files
from tests.blender.runs import in_blender
from tests.conftest import arc, random_gaussians, write_dataset

pytestmark = pytest.mark.blender
START = """
import os
from pathlib import Path
import numpy as np
from mathutils import Vector
from bpy_extras.object_utils import world_to_camera_view
import gof_blender

gof_blender.register()
folder = Path(sys.argv[1])
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.render.fps = 100

def refused(operator, **given):
    try:
        operator(**given)
    except RuntimeError as error:
        return str(error).strip()
    return ""
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A dataset with plates, and a result that stands still at its first frame, all Gaussians alive."""
    folder = tmp_path_factory.mktemp("secret_project_of_anna")
    images = np.random.default_rng(0).random((2, 3, 64, 36, 3))
    write_dataset(folder / "data", arc(3), images, images[0], [0.0, 0.01])
    gaussians = random_gaussians(20)
    gaussians.t_mu[:], gaussians.t_sigma[:], gaussians.opacity[:] = 0.0, 0.5, 0.5
    gaussians.gas_velocity = gaussians.velocity[::-1].copy()
    gaussians.save(folder / "result.npz")
    return folder


@pytest.mark.parametrize("metres", [1.0, 0.01, 0.001, 0.3048])
def test_flame_and_cameras_agree_in_every_unit(folder, tmp_path, metres):
    """A Gaussian is at the pixel K [R | t] of the dataset's camera, and in metres where it was, in USD as well."""
    found = in_blender(
        START
        + """
scale = float(sys.argv[2])
scene.unit_settings.scale_length = scale
bpy.ops.gof.import_cameras(filepath=str(folder / "data" / "dataset.json"), rig=False)
bpy.ops.gof.import_result(filepath=str(folder / "result.npz"), start_frame=0, fit="keep")
thing = bpy.context.object
scene.frame_start = scene.frame_end = 10
scene.frame_set(10)
graph = bpy.context.evaluated_depsgraph_get()
for instance in graph.object_instances:
    if instance.object.original == thing and instance.object.type == "POINTCLOUD":
        points = [instance.matrix_world @ Vector(p.co) for p in instance.object.data.points]
views = [world_to_camera_view(scene, scene.camera, p) for p in points]
result["pixels"] = [[v.x * 36, (1 - v.y) * 64] for v in views]
result["far"] = [camera.clip_end * scale for camera in bpy.data.cameras]
bpy.ops.gof.export_points(filepath=sys.argv[3] + "/out.usda")
from pxr import Usd, UsdGeom
stage = Usd.Stage.Open(sys.argv[3] + "/out.usda")
matrix = np.array(UsdGeom.Xformable(stage.GetPrimAtPath("/reconstruction")).GetLocalTransformation())
points = np.array(UsdGeom.Points(stage.GetPrimAtPath("/reconstruction/points")).GetPointsAttr().Get(10))
result["usd"] = ((points @ matrix[:3, :3] + matrix[3, :3]) * UsdGeom.GetStageMetersPerUnit(stage)).tolist()
""",
        folder,
        metres,
        tmp_path,
    )
    g = TransientGaussians.load(folder / "result.npz")
    place = g.position + np.where(g.dynamic, 0.1, 0.0)[:, None] * g.velocity
    camera = arc(3)[0]
    seen = np.array(camera.K) @ (camera.world_to_camera[:3, :3] @ place.T + camera.world_to_camera[:3, 3:])
    np.testing.assert_allclose(found["pixels"], (seen[:2] / seen[2]).T, atol=0.02)
    np.testing.assert_allclose(found["usd"], place, atol=2e-5)
    assert found["far"] == pytest.approx([1000.0] * 3), "as far as in metres"


@pytest.mark.parametrize("metres", [1.0, 0.01])
def test_an_import_stands_where_it_is_asked_to(tmp_path, metres):
    """A flame whose foot is amid (5, -3) at height 2; on the default cube's top, and at the cursor."""
    gaussians = random_gaussians(400)
    rng = np.random.default_rng(4)
    height = np.linspace(2.0, 4.0, 400)
    gaussians.position[:] = np.column_stack([5 + 0.1 * rng.normal(size=400), -3 + 0.1 * rng.normal(size=400), height])
    gaussians.dynamic[:] = True
    gaussians.save(tmp_path / "result.npz")
    found = in_blender(
        START
        + """
file, scale = str(folder / "result.npz"), float(sys.argv[2])
scene.unit_settings.scale_length = scale
scene.cursor.location = (1 / scale, 2 / scale, 3 / scale)

def foot(spot):
    bpy.ops.gof.import_result(filepath=file, spot=spot)
    bpy.context.view_layer.update()
    return [scale * x for x in bpy.context.object.matrix_world @ Vector((5, -3, 2))]

result["nothing"] = refused(bpy.ops.gof.import_result, filepath=file, spot="OBJECT")
result["filmed"], result["cursor"] = foot("FILMED"), foot("CURSOR")
bpy.ops.mesh.primitive_cube_add(size=2 / scale, location=(-4 / scale, 0, 0))
result["object"] = foot("OBJECT")
""",
        tmp_path,
        metres,
    )
    assert "click one" in found["nothing"]
    for name, place in (("filmed", [5, -3, 2]), ("cursor", [1, 2, 3]), ("object", [-4, 0, 1])):
        np.testing.assert_allclose(found[name], place, atol=0.06, err_msg=name)


def test_cameras_of_a_dataset_come_in_wherever_blender_was_started(folder, tmp_path):
    """Their plates too; where one is missing nothing is left behind, and the message names it."""
    found = in_blender(
        START
        + """
os.chdir("/")
file = folder / "data" / "dataset.json"
result["answer"] = list(bpy.ops.gof.import_cameras(filepath=str(file), rig=False))
result["plates"] = sorted(image.name for image in bpy.data.images if image.has_data or image.packed_file)
bpy.ops.wm.read_factory_settings(use_empty=True)
import shutil
copy = Path(sys.argv[2])
shutil.copy(file, copy)
(copy / "static").mkdir()
shutil.copy(folder / "data" / "static" / "cam_0.png", copy / "static")
result["missing"] = refused(bpy.ops.gof.import_cameras, filepath=str(copy / "dataset.json"), rig=False)
(copy / "static" / "cam_1.png").write_text("no picture")
result["damaged"] = refused(bpy.ops.gof.import_cameras, filepath=str(copy / "dataset.json"), rig=False)
result["left"] = [len(bpy.data.cameras), len(bpy.data.collections), len([o for o in bpy.data.objects])]
""",
        folder,
        tmp_path,
    )
    assert found["answer"] == ["FINISHED"] and found["plates"] == [f"Plate of cam_{n}" for n in range(3)]
    assert str(tmp_path / "static" / "cam_1.png") in found["missing"] and "no such file" in found["missing"]
    assert "cam_1.png" in found["damaged"]
    assert found["left"] == [0, 0, 0]


def test_long_and_foreign_names_stay_apart(tmp_path):
    """Blender keeps 63 bytes of a name. Three names that are alike in those: out again, each has its own, and all."""
    names = [f"{'Kamera-ä' * 8}-{side}" for side in ("links", "Mitte", "rechts")]
    names += ["é", "ü"]
    frames = []
    for k, camera in enumerate(arc(5)):
        pose = np.linalg.inv(camera.world_to_camera) @ np.diag([1.0, -1, -1, 1])
        frames.append({"file_path": f"{names[k]}.png", "transform_matrix": pose.tolist(), "fl_x": 80, "w": 36, "h": 64})
    (tmp_path / "transforms.json").write_text(json.dumps({"frames": frames}))
    read = [entry.name for entry in camera_files.read(tmp_path / "transforms.json")]
    found = in_blender(
        START
        + """
bpy.ops.gof.import_cameras(filepath=str(folder / "transforms.json"), rig=False)
bpy.ops.gof.export_cameras(filepath=str(folder / "images.txt"))
bpy.ops.gof.export_cameras(filepath=str(folder / "again.json"))
result["in"] = len(bpy.data.cameras)
""",
        tmp_path,
    )
    assert found["in"] == 5
    for file in ("images.txt", "again.json"):
        again = {entry.name: entry for entry in camera_files.read(tmp_path / file)}
        assert len(again) == 5, "as many names as cameras"
    text = (tmp_path / "images.txt").read_text().splitlines()
    written = [line.split()[-1] for line in text if line.endswith(".png")]
    assert len(set(written)) == 5
    wanted = [name.encode() for name in read[:3]]
    assert all(len(name) > 63 for name in wanted)
    assert (
        sum(
            word.startswith("Kamera-") and word.endswith(f"{side}.png")
            for word in written
            for side in ("links", "Mitte", "rechts")
        )
        == 3
    )


def test_a_blend_keeps_the_flame_and_not_its_authors_folders(folder, tmp_path):
    """Exports are of what the .blend holds; the score asks for the file, and takes no other of that name."""
    found = in_blender(
        START
        + """
import shutil
home, away = Path(sys.argv[2]) / "secret_project_of_anna", Path(sys.argv[2]) / "elsewhere"
home.mkdir()
away.mkdir()
for name in ("data", "result.npz"):
    (shutil.copytree if name == "data" else shutil.copy)(folder / name, home / name)
from gof_blender.pure.io.usd_points import at
from gof_blender.pure.io import cloud as clouds
from gof_blender.scene import point_cloud, result_file
from gof_blender.ui.export import Recording

bpy.ops.gof.import_cameras(filepath=str(home / "data" / "dataset.json"), rig=False)
bpy.ops.gof.import_result(filepath=str(home / "result.npz"), start_frame=0, fit="keep")
scene.frame_start, scene.frame_end = 0, 1
blend = str(away / "flame.blend")
bpy.ops.wm.save_as_mainfile(filepath=blend, compress=False)
result["told"] = b"secret_project_of_anna" in open(blend, "rb").read()
thing = bpy.context.object
result["found here"] = str(result_file.find(thing))
truth = at(clouds.load(home / "result.npz"), 0.01)
for moved in (home / "result.npz", home / "data"):
    moved.rename(away / f"of {moved.name}")
result_file._here.clear()  # another Blender, of somebody else
bpy.ops.wm.open_mainfile(filepath=blend)
scene = bpy.context.scene
thing = bpy.data.objects["result"]
bpy.context.view_layer.objects.active = thing
now = at(Recording.of(scene, thing).cloud, 0.01)
result["apart"] = max(
    float(np.abs(np.abs(getattr(now, name)) - np.abs(getattr(truth, name))).max()) for name in vars(truth)
)
result["points"] = list(bpy.ops.gof.export_points(filepath=str(away / "out.usda")))
result["vdb"] = list(bpy.ops.gof.export_vdb(filepath=str(away / "out.vdb"), voxel_m=0.1))
settings = scene.gof.score
settings.dataset = str(away / "of data")
result["gone"] = refused(bpy.ops.gof.score)
settings.result = str(away / "of result.npz")
result["chosen"] = str(result_file.find(thing, settings.result))
cloud = bytearray((away / "of result.npz").read_bytes())
cloud[200] ^= 255
(away / "result.npz").write_bytes(cloud)
settings.result = ""
result["other"] = refused(bpy.ops.gof.score)
""",
        folder,
        tmp_path,
    )
    assert not found["told"]
    assert found["found here"] == str(tmp_path / "secret_project_of_anna" / "result.npz")
    assert found["apart"] < 2e-6 and found["points"] == found["vdb"] == ["FINISHED"]
    assert "result.npz" in found["gone"] and "choose it as Result" in found["gone"]
    assert found["chosen"] == str(tmp_path / "elsewhere" / "of result.npz")
    assert "has changed" in found["other"] and "result.npz" in found["other"]


def test_a_thinned_import_goes_out_as_it_is_seen(folder, tmp_path):
    found = in_blender(
        START
        + """
bpy.ops.gof.import_result(filepath=str(folder / "result.npz"), start_frame=0, fit="keep", step=4)
from gof_blender.ui.export import Recording
cloud = Recording.of(scene, bpy.context.object).cloud
result["rows"] = cloud.position.tolist()
""",
        folder,
    )
    np.testing.assert_allclose(found["rows"], TransientGaussians.load(folder / "result.npz").position[::4], atol=1e-6)


def test_what_somebody_did_to_a_cloud_is_said_without_a_traceback(folder, tmp_path):
    """Edit Mode, an attribute taken away, no points left, nothing selected: a line each, and what to do."""
    found = in_blender(
        START
        + """
import contextlib, io

def edited():
    bpy.ops.object.mode_set(mode="EDIT")

def without_velocity():
    mesh = bpy.context.object.data
    mesh.attributes.remove(mesh.attributes["gs_gas_velocity"])

def without_points():
    bpy.context.object.data.clear_geometry()

def choose(name):
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        scene.gof.reconstruction.color = name
    return said.getvalue().strip()

out = sys.argv[2]
for change in (edited, without_velocity, without_points):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    bpy.ops.gof.import_result(filepath=str(folder / "result.npz"))
    scene.frame_end = scene.frame_start
    change()
    scene.gof.score.dataset = str(folder / "data")
    result[change.__name__] = [
        refused(bpy.ops.gof.export_vdb, filepath=out + "/a.vdb"),
        refused(bpy.ops.gof.export_points, filepath=out + "/a.usda"),
        choose("speed"),
    ]
bpy.context.view_layer.objects.active = None
result["nothing"] = [choose("speed")]
""",
        folder,
        tmp_path,
    )
    assert all("leave Edit Mode" in line for line in found["edited"])
    for name in ("without_velocity", "without_points"):
        assert all("import the reconstruction again" in line for line in found[name]), found[name]
    assert found["nothing"] == ["Select a reconstruction first"]
    assert not any("Traceback" in line for lines in found.values() for line in lines)
    assert list(tmp_path.iterdir()) == [], "nothing half-made stays"
