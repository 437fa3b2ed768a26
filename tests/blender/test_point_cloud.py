"""The animated cloud in real Blender: what Geometry Nodes evaluates, and what Cycles shows, against closed forms."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from blender_addon.io import gaussians_file
from blender_addon.io.gaussians_file import GaussianCloud
from gof.gaussians import TransientGaussians

ROOT = Path(__file__).resolve().parents[2]
START, FPS, CUT_OFF, EXTENT = 81, 100, 1 / 255, 2.5
FRAMES = (75, 81, 81.5, 100, 121)
COMMON = """
import json, sys
from pathlib import Path
import bpy
import numpy as np
from mathutils import Euler, Matrix
from blender_addon.io import gaussians_file
from blender_addon.mantaflow import leave
from blender_addon.scene import display, point_cloud

folder = Path(sys.argv[1])
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
"""
EVALUATE = COMMON + """
scene.render.fps = 100
out = {}

def look(thing, mode, key):
    # Instances are read by transform: their derived 'position' attribute is not reliable from Python.
    graph = bpy.context.evaluated_depsgraph_get()
    geometry = thing.evaluated_get(graph).evaluated_geometry()
    points = geometry.instances_pointcloud() if mode == "ellipsoids" else geometry.pointcloud
    count = len(points.points) if points else 0

    def read(name, field, width):
        values = np.zeros(count * width, np.float32)
        if count:
            points.attributes[name].data.foreach_get(field, values)
        return values.reshape(count, width)

    out[key + "/alpha"] = read("gs_alpha", "value", 1)[:, 0]
    if mode == "ellipsoids":
        world = [np.array(i.matrix_world) for i in graph.object_instances
                 if i.is_instance and i.parent and i.parent.original == thing]
        out[key + "/matrix"] = np.array(world).reshape(-1, 4, 4)
        out[key + "/position"] = out[key + "/matrix"][:, :3, 3]
    else:
        matrix = np.array(thing.matrix_world)
        out[key + "/position"] = read("position", "vector", 3) @ matrix[:3, :3].T + matrix[:3, 3]
        out[key + "/radius"] = read("radius", "value", 1)[:, 0]

def at(frame):
    scene.frame_set(int(frame), subframe=frame - int(frame))

cloud = gaussians_file.load(folder / "result.npz")
for mode in ("ellipsoids", "points"):
    thing = point_cloud.add_point_cloud(cloud, 81, mode)
    for frame in json.loads(sys.argv[2]):
        at(frame)
        look(thing, mode, f"{mode}/{frame}")
    thing.matrix_world = Matrix.Translation((1, 2, 3)) @ Euler((0.4, 0.5, 0.6)).to_matrix().to_4x4()
    at(100)
    look(thing, mode, f"{mode}/moved")
    out["matrix"] = np.array(thing.matrix_world)
    scene.render.fps, scene.render.fps_base = 50, 1.25
    at(100)
    look(thing, mode, f"{mode}/40 fps")
    scene.render.fps, scene.render.fps_base = 100, 1.0
    bpy.data.objects.remove(thing)
try:
    point_cloud.add_point_cloud(cloud, 81, "splats")
except ValueError as error:
    out["bad mode"] = str(error)
np.savez(folder / "seen.npz", **out)
leave()
"""
RENDER = COMMON + """
scene.render.fps, scene.render.engine = 100, "CYCLES"
scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.filter_width = 16, False, 0.01
scene.render.resolution_x = scene.render.resolution_y = 48
scene.view_settings.view_transform = "Standard"
camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
scene.collection.objects.link(camera)
scene.camera, camera.location.z = camera, 5.0
camera.data.type, camera.data.ortho_scale = "ORTHO", 1.0
scene.render.image_settings.file_format = "OPEN_EXR"
scene.render.image_settings.color_depth = "32"
for mode in ("ellipsoids", "points"):
    cloud = gaussians_file.load(folder / f"{mode}.npz")
    thing = point_cloud.add_point_cloud(cloud, 1, mode)
    thing.location.x = -0.05
    scene.frame_set(1)
    scene.render.filepath = str(folder / f"{mode}.exr")
    bpy.ops.render.render(write_still=True)
    bpy.data.objects.remove(thing)
    image = bpy.data.images.load(scene.render.filepath)
    np.save(folder / f"{mode}.npy", np.array(image.pixels[:]).reshape(48, 48, 4)[..., 0])
shown = {}
colors = np.linspace(0, 1, 11)[:, None].repeat(3, 1)
for transform in ("Standard", "Filmic", "AgX"):
    scene.view_settings.view_transform = transform
    linear = display.scene_linear(colors, scene)
    shown[transform] = [linear[:, 0].tolist(), display._shown(linear[:, 0].astype(float), scene).tolist()]
(folder / "shown.json").write_text(json.dumps(shown))
leave()
"""


def run(script: str, *arguments) -> None:
    result = subprocess.run([sys.executable, "-c", script, *map(str, arguments)], cwd=ROOT, capture_output=True, text=True,
                            timeout=60)
    assert result.returncode == 0, result.stdout[-1500:] + result.stderr[-2500:]


def rotation_matrix(quaternion: np.ndarray) -> np.ndarray:
    w, x, y, z = quaternion
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                     [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                     [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]])


@pytest.fixture(scope="module")
def cloud(tmp_path_factory) -> tuple[GaussianCloud, Path]:
    folder = tmp_path_factory.mktemp("cloud")
    rng, n = np.random.default_rng(5), 300
    t_sigma = rng.uniform(0.01, 0.08, n)
    t_sigma[:20] = np.inf
    TransientGaussians(
        position=rng.uniform(-1, 1, (n, 3)), velocity=rng.normal(size=(n, 3)), t_mu=rng.uniform(-0.05, 0.4, n), t_sigma=t_sigma,
        scale=rng.uniform(0.01, 0.05, (n, 3)), rotation=rng.normal(size=(n, 4)), opacity=rng.uniform(0.05, 1, n),
        color=rng.uniform(0, 1, (n, 3)), dynamic=np.arange(n) % 10 > 0).save(folder / "result.npz")
    run(EVALUATE, folder, json.dumps(FRAMES))
    return gaussians_file.load(folder / "result.npz"), folder / "seen.npz"


def closed_form(cloud: GaussianCloud, time_s: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions and opacities of the visible Gaussians at a time, and which they are; float64."""
    age = np.where(cloud.dynamic, time_s - cloud.t_mu.astype(float), 0)
    alpha = cloud.opacity * np.exp(-0.5 * (age / cloud.t_sigma) ** 2)
    assert np.abs(alpha - CUT_OFF).min() > 1e-6  # no row on the edge of visibility
    visible = alpha >= CUT_OFF
    return (cloud.position + age[:, None] * cloud.velocity)[visible], alpha[visible], visible


@pytest.mark.parametrize("mode", ["ellipsoids", "points"])
@pytest.mark.parametrize("frame", FRAMES)
def test_positions_and_opacities_over_time(cloud, mode, frame):
    gaussians, file = cloud
    seen = np.load(file)
    position, alpha, visible = closed_form(gaussians, (frame - START) / FPS)
    assert 0 < visible.sum() < len(gaussians)
    assert len(seen[f"{mode}/{frame}/alpha"]) == visible.sum()
    assert np.abs(seen[f"{mode}/{frame}/position"] - position).max() < 1e-5
    assert np.abs(seen[f"{mode}/{frame}/alpha"] - alpha).max() < 1e-5
    # One frame off would be noticed.
    later = closed_form(gaussians, (frame + 1 - START) / FPS)
    both = visible & later[2]
    assert np.abs(later[0][both[later[2]]] - position[both[visible]]).max() > 1e-3


@pytest.mark.parametrize("frame", FRAMES)
def test_shapes(cloud, frame):
    gaussians, file = cloud
    seen = np.load(file)
    visible = closed_form(gaussians, (frame - START) / FPS)[2]
    wanted = [rotation_matrix(q.astype(float)) * s for q, s in zip(gaussians.rotation[visible], gaussians.scale[visible], strict=True)]
    assert np.abs(seen[f"ellipsoids/{frame}/matrix"][:, :3, :3] - wanted).max() < 1e-5
    radius = EXTENT * np.cbrt(gaussians.scale[visible].astype(float).prod(1))
    assert np.abs(seen[f"points/{frame}/radius"] - radius).max() < 1e-5


@pytest.mark.parametrize("mode", ["ellipsoids", "points"])
def test_moved_object_takes_everything_along(cloud, mode):
    gaussians, file = cloud
    seen = np.load(file)
    matrix = seen["matrix"]
    position, alpha, _ = closed_form(gaussians, (100 - START) / FPS)
    assert np.abs(matrix[:3, :3] - np.eye(3)).max() > 0.1
    assert np.abs(seen[f"{mode}/moved/position"] - (position @ matrix[:3, :3].T + matrix[:3, 3])).max() < 1e-5
    assert np.abs(seen[f"{mode}/moved/alpha"] - alpha).max() < 1e-5


@pytest.mark.parametrize("mode", ["ellipsoids", "points"])
def test_seconds_follow_the_scene_frame_rate(cloud, mode):
    gaussians, file = cloud
    seen = np.load(file)
    matrix = seen["matrix"]
    position, alpha, visible = closed_form(gaussians, (100 - START) / 40)  # 50 / 1.25 frames per second
    assert len(seen[f"{mode}/40 fps/alpha"]) == visible.sum()
    assert np.abs(seen[f"{mode}/40 fps/position"] - (position @ matrix[:3, :3].T + matrix[:3, 3])).max() < 1e-5
    assert np.abs(seen[f"{mode}/40 fps/alpha"] - alpha).max() < 1e-5


def test_unknown_mode(cloud):
    assert "choose 'ellipsoids' or 'points'" in str(np.load(cloud[1])["bad mode"])


@pytest.fixture(scope="module")
def rendered(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("rendered")
    for mode, scale in (("ellipsoids", [0.05, 0.12, 0.08]), ("points", [0.1, 0.1, 0.1])):
        TransientGaussians(position=[[0.1, 0.05, 0]], velocity=[[0, 0, 0]], t_mu=[0], t_sigma=[np.inf], scale=[scale],
                           rotation=[[0.9, 0.2, -0.3, 0.4]], opacity=[0.8], color=[[1, 1, 1]],
                           dynamic=[True]).save(folder / f"{mode}.npz")
    run(RENDER, folder)
    return folder


@pytest.mark.parametrize("mode", ["ellipsoids", "points"])
def test_cycles_shows_the_splat(rendered, mode):
    """A white Gaussian over black, seen orthographically: the pixel is opacity exp(-d^2 / 2) of the projected Gaussian."""
    g = gaussians_file.load(rendered / f"{mode}.npz")
    axes = rotation_matrix(g.rotation[0].astype(float)) * g.scale[0]
    covariance = (axes @ axes.T)[:2, :2]
    pixel = (np.arange(48) + 0.5) / 48 - 0.5
    offset = np.stack(np.meshgrid(pixel, pixel), -1) - [0.05, 0.05]
    distance = np.sqrt(np.einsum("...i,ij,...j", offset, np.linalg.inv(covariance), offset))
    seen = np.load(rendered / f"{mode}.npy")
    core = distance < 0.9 * EXTENT
    assert np.abs(seen - 0.8 * np.exp(-0.5 * distance**2))[core].max() < 0.004
    assert seen[distance > 1.05 * EXTENT].max() == 0


@pytest.mark.parametrize("transform", ["Standard", "Filmic", "AgX"])
def test_display_values_come_back(rendered, transform):
    linear, shown = json.loads((rendered / "shown.json").read_text())[transform]
    assert np.abs(np.array(shown) - np.linspace(0, 1, 11)).max() < 0.002
    assert linear[0] == 0 and (np.diff(linear) > 0).all() and np.isfinite(linear).all()
