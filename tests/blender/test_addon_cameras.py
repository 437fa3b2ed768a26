"""Cameras to other programs' files and back, against where Blender itself projects points to."""

import json

import numpy as np
import pytest

from gof_blender.core.errors import DataFormatError
from gof_blender.pure.io import camera_files
from tests.blender.runs import in_blender

RIG = """
import os
import numpy as np
from mathutils import Vector
from bpy_extras.object_utils import world_to_camera_view
import gof_blender
gof_blender.register()
folder = sys.argv[1]
scene = bpy.context.scene
for thing in list(bpy.data.objects):
    bpy.data.objects.remove(thing)
POINTS = [(3.1, -2.2, 1.4), (2.8, -1.9, 1.9), (3.0, -2.0, 1.6), (3.3, -2.1, 2.2)]

def add_rig():
    scene.cursor.location = (3, -2, 1)
    bpy.ops.gof.add_fire()
    cameras = scene.gof.fire.cameras
    cameras.count, cameras.eval_count, cameras.focal_mm, cameras.sensor_px = 3, 1, 61.5, (640, 360)
    bpy.ops.gof.add_cameras()
    from gof_blender.scene import place
    place.cameras(scene)[1].location.z += 0.4  # moved by hand
    place.cameras(scene)[2].rotation_euler.x += 0.05
    bpy.context.view_layer.update()

def seen():
    "Pixels (C, P, 2) of POINTS, x right, y down, by Blender's own projection."
    from gof_blender.scene import camera_exchange
    bpy.context.view_layer.update()
    size = np.array([scene.render.resolution_x, scene.render.resolution_y])
    found = []
    for camera in camera_exchange.chosen(scene):
        places = np.array([world_to_camera_view(scene, camera, Vector(p)) for p in POINTS])[:, :2]
        found.append((np.column_stack([places[:, 0], 1 - places[:, 1]]) * size).tolist())
    return found
"""
POINTS = np.array([(3.1, -2.2, 1.4), (2.8, -1.9, 1.9), (3.0, -2.0, 1.6), (3.3, -2.1, 2.2)])


def project(entry: camera_files.CameraEntry, points: np.ndarray) -> np.ndarray:
    """(P, 2) pixels by K and the pose."""
    pose = np.array(entry.world_to_camera)
    there = (points @ pose[:3, :3].T + pose[:3, 3]) @ np.array(entry.K).T
    return there[:, :2] / there[:, 2:]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A rig of three and one, with two moved by hand, written in every format and read again into a new scene."""
    pytest.importorskip("bpy", reason="the operators need Blender")
    folder = tmp_path_factory.mktemp("cameras")
    (folder / "colmap").mkdir()
    found = in_blender(
        RIG
        + """
add_rig()
result["truth"] = seen()
files = ("rig.json", "colmap/images.txt", "rig.usdc", "rig.abc")
for name in files:
    result[name + " said"] = list(bpy.ops.gof.export_cameras(filepath=f"{folder}/{name}"))
bpy.ops.gof.export_cameras(filepath=folder + "/fire.json", from_fire=True)
for name in files:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y = 360, 640  # USD and Alembic do not hold it
    before = len(bpy.data.objects)
    bpy.ops.gof.import_cameras(filepath=f"{folder}/{name}")
    result[name] = seen()
    result[name + " objects"] = len(bpy.data.objects) - before
scene.cursor.location = (3, -2, 1)
bpy.ops.gof.add_fire()
for name, from_fire in (("rig.usdc", False), ("fire.json", True), ("rig.json", False)):
    bpy.ops.gof.add_cameras()
    scene.render.resolution_x, scene.render.resolution_y = 360, 640
    result[name + " as rig"] = list(bpy.ops.gof.import_cameras(filepath=f"{folder}/{name}", from_fire=from_fire))
    result[name + " rig"] = seen()
    from gof_blender.ui import scene_spec
    spec = scene_spec.of_scene(scene)
    result[name + " spec"] = [spec.cameras.count, spec.cameras.eval_count, spec.cameras.focal_mm, spec.cameras.portrait,
                              len(spec.cameras.placed)]
""",
        folder,
    )
    return found, folder


@pytest.mark.blender
@pytest.mark.parametrize("name", ["rig.json", "colmap/images.txt"])
def test_a_file_projects_where_blender_does(made, name):
    found, folder = made
    cameras = camera_files.read(folder / name)
    assert [camera.name for camera in cameras] == ["cam_0", "cam_1", "cam_2", "eval_0"]
    for camera, truth in zip(cameras, found["truth"], strict=True):
        assert np.abs(project(camera, POINTS) - truth).max() < 2e-3
        assert np.ptp(truth, axis=0).min() > 20, "the points must be apart"
        assert (camera.width, camera.height) == (360, 640)


@pytest.mark.blender
def test_nerfstudio_and_colmap_read_the_files(made):
    """By their own conventions, as other people's code takes them: pycolmap opens the model."""
    pycolmap = pytest.importorskip("pycolmap")
    found, folder = made
    model = pycolmap.Reconstruction(folder / "colmap")
    pictures = sorted(model.images.values(), key=lambda picture: picture.name)
    assert [picture.name for picture in pictures] == ["cam_0.png", "cam_1.png", "cam_2.png", "eval_0.png"]
    for picture, truth in zip(pictures, found["truth"], strict=True):
        pixels = [picture.project_point(point) for point in POINTS]
        assert np.abs(np.array(pixels) - truth).max() < 2e-3


@pytest.mark.blender
@pytest.mark.parametrize("name", ["rig.json", "colmap/images.txt", "rig.usdc", "rig.abc"])
def test_in_again_a_new_scene_has_the_same_views(made, name):
    found, _ = made
    assert found[name + " said"] == ["FINISHED"]
    assert found[name + " objects"] == 4
    assert np.abs(np.array(found[name]) - found["truth"]).max() < 0.02


@pytest.mark.blender
@pytest.mark.parametrize("name", ["rig.json", "rig.usdc", "fire.json"])
def test_in_again_it_is_the_fires_rig(made, name):
    """The benchmark takes it: the spec has the panel's numbers and every camera's place."""
    found, _ = made
    assert found[name + " as rig"] == ["FINISHED"]
    count, evaluation, focal_mm, portrait, placed = found[name + " spec"]
    assert (count + evaluation, portrait, placed) == (4, True, 4)
    assert evaluation == 1, "by its name where the file has no roles"
    assert focal_mm == pytest.approx(61.5, abs=1e-3)
    assert np.abs(np.array(found[name + " rig"]) - found["truth"]).max() < 0.02


@pytest.mark.blender
def test_a_shifted_lens_and_scenes_in_centimetres(tmp_path):
    """Lens shift, a picture percentage, oblong pixels and a unit scale: still where Blender projects to; no rig."""
    pytest.importorskip("bpy", reason="the operators need Blender")
    found = in_blender(
        RIG
        + """
scene.unit_settings.scale_length = 0.01
POINTS = [tuple(100 * x for x in p) for p in POINTS]
data = bpy.data.cameras.new("Odd One")
camera = bpy.data.objects.new("Odd One", data)
scene.collection.objects.link(camera)
camera.location, camera.rotation_euler = (310, -600, 200), (1.5, 0.1, 0.05)
data.lens, data.shift_x, data.shift_y, data.sensor_fit, data.sensor_height = 40, 0.1, -0.2, "VERTICAL", 20
scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 800, 600, 50
scene.render.pixel_aspect_x, scene.render.pixel_aspect_y = 1.0, 1.25
scene.camera = camera
result["truth"] = (np.array(seen()) / 2).tolist()
bpy.ops.gof.export_cameras(filepath=folder + "/odd.json")
bpy.data.objects.remove(camera)
bpy.ops.gof.import_cameras(filepath=folder + "/odd.json")
result["again"] = seen()
result["size"] = [scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage]
scene.cursor.location = (0, 0, 0)
bpy.ops.gof.add_fire()
try:
    bpy.ops.gof.import_cameras(filepath=folder + "/odd.json")
except RuntimeError as error:
    result["rig"] = str(error)
scene.camera.data.type = "ORTHO"
try:
    bpy.ops.gof.export_cameras(filepath=folder + "/odd2.json")
except RuntimeError as error:
    result["ortho"] = str(error)
""",
        tmp_path,
    )
    (camera,) = camera_files.read(tmp_path / "odd.json")
    truth = np.array(found["truth"][0])
    assert np.abs(project(camera, POINTS) - truth).max() < 5e-3
    assert found["size"] == [400, 300, 100]
    assert np.abs(np.array(found["again"][0]) - truth).max() < 0.02
    assert "one lens" in found["rig"] and "perspective" in found["ortho"]
    assert not (tmp_path / "odd2.json").exists()


def frame(**changes) -> dict:
    pose = [[1, 0, 0, 0], [0, 0, -1, -3], [0, 1, 0, 1], [0, 0, 0, 1]]
    return {"file_path": "a.png", "transform_matrix": pose, "fl_x": 500, "w": 640, "h": 480} | changes


@pytest.mark.parametrize(
    "content, words",
    [
        ({"frames": 3}, "no list 'frames'"),
        ({"frames": []}, "no cameras"),
        ({"frames": [frame(k1=0.1)]}, "undistort"),
        ({"frames": [frame(fl_x=-1)]}, "positive"),
        ({"frames": [frame(w=640.5)]}, "pixels"),
        ({"frames": [frame(transform_matrix=[[1, 0], [0, 1]])]}, "transform_matrix"),
        ({"frames": [frame(transform_matrix=(2 * np.eye(4)).tolist())]}, "scaled"),
        ({"frames": [{"file_path": "a.png"}]}, "no 'transform_matrix'"),
    ],
)
def test_what_is_no_camera_is_refused_by_name(tmp_path, content, words):
    path = tmp_path / "transforms.json"
    path.write_text(json.dumps(content))
    with pytest.raises(DataFormatError, match=words) as error:
        camera_files.read(path)
    assert "transforms.json" in str(error.value)


def test_pictures_of_one_camera_are_one_and_global_lenses_count(tmp_path):
    """A clip's transforms.json lists each camera at every time; instant-ngp keeps one lens above the list."""
    path = tmp_path / "transforms.json"
    frames = [frame(file_path=f"{k}.png") for k in range(5)] + [frame(transform_matrix=np.eye(4).tolist())]
    path.write_text(json.dumps({"frames": frames}))
    assert len(camera_files.read(path)) == 2
    lone = {key: frame()[key] for key in ("file_path", "transform_matrix")}
    path.write_text(json.dumps({"w": 640, "h": 480, "camera_angle_x": np.pi / 2, "frames": [lone]}))
    (camera,) = camera_files.read(path)
    assert camera.K[0][0] == pytest.approx(320) and camera.K[0][2] == 320
    np.testing.assert_allclose(project(camera, np.array([[1.0, 0, 1]])), [[320 + 320 / 3, 240]])


def test_colmap_with_distortion_is_refused(tmp_path):
    (tmp_path / "cameras.txt").write_text("# comment\n1 OPENCV 640 480 500 500 320 240 0.1 0 0 0\n")
    (tmp_path / "images.txt").write_text("1 1 0 0 0 0 0 0 1 a.png\n\n")
    with pytest.raises(DataFormatError, match="image_undistorter"):
        camera_files.read(tmp_path / "images.txt")
