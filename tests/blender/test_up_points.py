"""Which way is up, from marked points and from accelerometers, of a tilted rig whose vertical Blender itself says."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from gof.commands.ingest import IngestConfig, ingest
from gof.core.errors import GofError
from gof.dataset import Dataset
from gof.ingest import accelerometer
from gof_blender.pure import spec as scene_spec
from tests.blender.runs import TOY, in_blender
from tests.ingest.gopro import track, with_track

pytest.importorskip("bpy", reason="renders with the bpy wheel")
pytest.importorskip("pycolmap")
pytestmark = [pytest.mark.blender, pytest.mark.long]

ROLL_DEG = 11.0
FOV_DEG = float(np.rad2deg(2 * np.arctan(36 * 720 / 1280 / 2 / 35)))  # 35 mm, the 36 mm of the sensor upright
RENDERED = """
import math, shutil
from dataclasses import replace
from pathlib import Path
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Matrix, Vector
from gof_blender.pure import spec as scene_spec
from gof_blender.pure.rig import Pose
from gof_blender.scene import rig

bpy.ops.wm.read_factory_settings(use_empty=True)
spec = scene_spec.load(sys.argv[1])
tilted = [pose @ Matrix.Rotation(math.radians(float(sys.argv[3])), 4, "Z") for pose in rig.poses(spec.cameras)]
placed = tuple(Pose(tuple(pose.translation), tuple(pose.to_quaternion())) for pose in tilted)
cameras = rig.build(replace(spec, cameras=replace(spec.cameras, placed=placed)), bpy.context.scene.collection)

material = bpy.data.materials.new("speckled")
material.use_nodes = True
nodes, links = material.node_tree.nodes, material.node_tree.links
nodes.clear()
noise, light, out = (nodes.new(f"ShaderNode{n}") for n in ("TexNoise", "Emission", "OutputMaterial"))
noise.inputs["Scale"].default_value, noise.inputs["Detail"].default_value = 9.0, 6.0
at = nodes.new("ShaderNodeTexCoord")
links.new(at.outputs["Object"], noise.inputs["Vector"])
links.new(noise.outputs["Color"], light.inputs["Color"])
links.new(light.outputs[0], out.inputs[0])
for place, turn in (((0, 2, 0), (1.3, 0.2, 0.3)), ((0, 0, 0), (0, 0, 0)), ((0, 0.6, 0.6), (0.7, 0.5, 0.4))):
    bpy.ops.mesh.primitive_plane_add(size=14 if place[2] == 0 else 0.8, location=place, rotation=turn)
    bpy.context.object.data.materials.append(material)

scene = bpy.context.scene
scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 6, False
scene.view_settings.view_transform = "Standard"
THINGS = {
    "post": ("upright", [(-0.4, 0.1, 0.0), (-0.4, 0.1, 0.9)]),
    "tree": ("upright", [(0.5, 0.4, 0.05), (0.5, 0.4, 0.5), (0.5, 0.4, 1.1)]),
    "floor": ("level", [(-0.6, -0.4, 0.0), (0.6, -0.3, 0.0), (0.1, 0.9, 0.0)]),
}
result["points"], result["up"] = [], []
bpy.context.view_layer.update()
width, height = scene.render.resolution_x, scene.render.resolution_y
for name, (kind, places) in THINGS.items():
    for place in places:
        seen = {c.name: world_to_camera_view(scene, c, Vector(place)) for c in cameras}
        pixels = {c: [width * v.x, height * (1 - v.y)] for c, v in seen.items()}
        result["points"].append({"pixels": pixels, kind: name})
for camera in cameras:
    result["up"].append(list(camera.matrix_world.to_3x3().inverted() @ Vector((0, 0, 1))))
    scene.camera = camera
    folder = Path(sys.argv[2]) / camera.name
    scene.render.filepath = str(folder / "0.png")
    bpy.ops.render.render(write_still=True)
    for k in (1, 2):
        shutil.copy(folder / "0.png", folder / f"{k}.png")
"""


@pytest.fixture(scope="module")
def filmed(tmp_path_factory):
    """Folder of the pictures; points of a points.json; (3, 3) the vertical in Blender's axes of each camera."""
    folder = tmp_path_factory.mktemp("tilted")
    rig = replace(TOY.cameras, arc_deg=30.0, height=1.5, look_at=(0.0, 0.0, 0.45), focal_mm=35.0)
    scene_spec.save(replace(TOY, cameras=rig, render=replace(TOY.render, percentage=40)), folder / "spec.json")
    found = in_blender(RENDERED, folder / "spec.json", folder, ROLL_DEG)
    return folder, found["points"], np.array(found["up"])


def made(filmed, out: Path, up: str, points: list | None = None) -> Dataset:
    folder, marked, _ = filmed
    (out / "points.json").write_text(json.dumps({"points": marked if points is None else points}))
    videos = [folder / f"cam_{c}" for c in range(3)]
    known = {"fov": FOV_DEG, "times": ("100",), "board": "none", "baseline_m": 1.0}
    config = IngestConfig(videos, out / "set", points=out / "points.json", up=up, **known)
    return Dataset.open(ingest(config).folder)


def off_deg(dataset: Dataset, up: np.ndarray) -> float:
    """How far the dataset's Z lies from Blender's, at most, in the cameras' own axes (Blender's: y up, z back)."""
    found = np.array([camera.world_to_camera[:3, 2] for camera in dataset.cameras]) * [1, -1, -1]
    return float(np.rad2deg(np.arccos(np.clip((found * up).sum(1), -1, 1))).max())


def test_marked_points_give_the_vertical_that_blender_has(filmed, tmp_path):
    (tmp_path / "points").mkdir()
    (tmp_path / "cameras").mkdir()
    auto = made(filmed, tmp_path / "points", "auto")  # points that say what is upright are believed unasked
    poses = json.loads((tmp_path / "points/set/poses.json").read_text())
    assert poses["report"]["up"]["source"] == "points" and poses["report"]["up"]["spread_deg"] < 1
    assert off_deg(auto, filmed[2]) < 0.3
    level = made(filmed, tmp_path / "cameras", "cameras")
    assert off_deg(level, filmed[2]) > ROLL_DEG
    assert poses["report"]["up"]["lean_deg"] == pytest.approx(off_deg(level, filmed[2]), abs=0.5)


def test_a_floor_that_is_none_is_named(filmed, tmp_path):
    wrong = [dict(point) for point in filmed[1]]
    for point in wrong:
        if point.get("upright") == "post":
            point["level"] = point.pop("upright")
    with pytest.raises(GofError, match="'post' is .* degrees from level"):
        made(filmed, tmp_path, "points", wrong)


def test_the_command_believes_two_cameras_that_agree(filmed, tmp_path):
    folder, _, ups = filmed
    videos = []
    for c, up in enumerate(ups):
        picture = cv2.imread(str(folder / f"cam_{c}/0.png"))
        videos.append(tmp_path / f"cam_{c}.mp4")
        writer = cv2.VideoWriter(str(videos[-1]), cv2.VideoWriter_fourcc(*"mp4v"), 30, picture.shape[1::-1])
        for _ in range(3):
            writer.write(picture)
        writer.release()
        if c < 2:
            with_track(videos[-1], track(up, "zxY"))
    config = IngestConfig(videos, tmp_path / "set", fov=FOV_DEG, times=("100",), board="none", baseline_m=1.0)
    dataset = Dataset.open(ingest(config).folder)
    up = json.loads((tmp_path / "set/poses.json").read_text())["report"]["up"]
    assert up["source"] == "accelerometer" and up["spread_deg"] < 0.5
    assert off_deg(dataset, ups) < 0.5


@pytest.mark.parametrize("order", ["ZXY", "YxZ", "XzY", "zxY"])  # HERO5, HERO7, MAX, HERO8
def test_accelerometers_axes_are_blenders(filmed, order):
    for up in filmed[2]:
        found = accelerometer._stored_up(list(accelerometer._streams(track(up, order))))
        np.testing.assert_allclose(found * [1, -1, -1], up, atol=2e-3)
