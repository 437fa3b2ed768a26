"""The animated cloud in real Blender: what Geometry Nodes evaluates, and what Cycles shows, against closed forms."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from gof.core.gaussians import TransientGaussians
from gof_blender.pure.io import cloud as clouds
from gof_blender.pure.io.cloud import GaussianCloud

pytestmark = pytest.mark.blender

ROOT = Path(__file__).resolve().parents[2]
START, FPS, CUT_OFF, EXTENT = 81, 100, 1 / 255, 2.5
FRAMES = (75, 81, 81.5, 100, 121)
COMMON = """
import json, sys
from pathlib import Path
import bpy
import numpy as np
from mathutils import Euler, Matrix
from gof_blender.pure.io import cloud as clouds
from gof_blender.scene.mantaflow import leave
from gof_blender.scene import display, point_cloud

folder = Path(sys.argv[1])

forced = []

def show_as_in(thing, where):
    "Let the node group show what it does in the viewport or in renders, wherever it is evaluated."
    tree = thing.modifiers[0].node_group
    if not forced:
        for link in [link for link in tree.links if link.from_node.bl_idname == "GeometryNodeIsViewport"]:
            forced.append(link.to_socket)
            tree.links.remove(link)
    for socket in forced:
        socket.default_value = int(where == "viewport")

bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
"""
EVALUATE = (
    COMMON
    + """
scene.render.fps = 100
out = {}

def look(thing, mode, key):
    graph = bpy.context.evaluated_depsgraph_get()
    geometry = thing.evaluated_get(graph).evaluated_geometry()
    seen = geometry.mesh if mode == "ellipsoids" else geometry.pointcloud
    count = len(seen.attributes["position"].data)

    def read(name, field, width):
        values = np.zeros(count * width, np.float32)
        seen.attributes[name].data.foreach_get(field, values)
        return values.reshape(count, width)

    matrix = np.array(thing.matrix_world)
    out[key + "/position"] = read("position", "vector", 3) @ matrix[:3, :3].T + matrix[:3, 3]
    out[key + "/alpha"] = read("gs_alpha", "value", 1)[:, 0]
    if mode == "ellipsoids":
        out[key + "/local"] = read("gs_local", "vector", 3)
    else:
        out[key + "/radius"] = read("radius", "value", 1)[:, 0]

def at(frame):
    scene.frame_set(int(frame), subframe=frame - int(frame))

cloud = clouds.load(folder / "result.npz")
for mode in ("ellipsoids", "ellipsoids in points", "points"):
    thing = point_cloud.add_point_cloud(cloud, 81, mode.split()[0])
    show_as_in(thing, "render" if mode == "ellipsoids" else "viewport")
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
    point_cloud.add_point_cloud(cloud, 81, "balls")
except ValueError as error:
    out["bad mode"] = str(error)
np.savez(folder / "seen.npz", **out)
leave()
"""
)
RENDER = (
    COMMON
    + """
scene.render.fps, scene.render.engine = 100, "CYCLES"
scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.pixel_filter_type = 1024, False, "BOX"
scene.render.resolution_x = scene.render.resolution_y = 48
scene.view_settings.view_transform = "Standard"
camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
scene.collection.objects.link(camera)
scene.camera, camera.location.z = camera, 5.0
camera.data.type, camera.data.ortho_scale = "ORTHO", 1.0
scene.render.image_settings.file_format = "OPEN_EXR"
scene.render.image_settings.color_depth = "32"
for mode in ("ellipsoids", "ellipsoids in points", "points"):
    cloud = clouds.load(folder / f"{mode.split()[0]}.npz")
    thing = point_cloud.add_point_cloud(cloud, 1, mode.split()[0])
    show_as_in(thing, "render" if mode == "ellipsoids" else "viewport")
    thing.location.x = -0.05
    thing.data.attributes["gs_light"].data[0].vector = (1, 1, 1)  # so that the pixel is the opacity
    scene.frame_set(1)
    scene.render.filepath = str(folder / f"{mode}.exr")
    bpy.ops.render.render(write_still=True)
    bpy.data.objects.remove(thing)
    image = bpy.data.images.load(scene.render.filepath)
    np.save(folder / f"{mode}.npy", np.array(image.pixels[:]).reshape(48, 48, 4)[..., 0])
shown = {}
colors = np.linspace(0, 1, 11)
for transform in ("Standard", "Filmic", "AgX"):
    scene.view_settings.view_transform = transform
    linear = display.ToneCurve.measure(scene).light(colors)
    shown[transform] = [linear.tolist(), display.display_values(linear, scene).tolist()]

scene.view_settings.view_transform, scene.cycles.samples = "Filmic", 32
thing = point_cloud.add_point_cloud(clouds.load(folder / "column.npz"), 1, "points")
camera.rotation_euler, camera.location = (np.pi / 2, 0, 0), (0, -5, 0)
bpy.ops.render.render(write_still=True)
image = bpy.data.images.load(scene.render.filepath)
pixels = np.array(image.pixels[:]).reshape(48, 48, 4)[..., :3]
shown["column"] = [display.display_values(pixels[..., c].ravel(), scene).tolist() for c in range(3)]
(folder / "shown.json").write_text(json.dumps(shown))
leave()
"""
)


def run(script: str, *arguments) -> None:
    result = subprocess.run(
        [sys.executable, "-c", script, *map(str, arguments)], cwd=ROOT, capture_output=True, text=True, timeout=300
    )
    assert result.returncode == 0, result.stdout[-1500:] + result.stderr[-2500:]


def rotation_matrix(quaternion: np.ndarray) -> np.ndarray:
    w, x, y, z = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


@pytest.fixture(scope="module")
def cloud(tmp_path_factory) -> tuple[GaussianCloud, Path]:
    folder = tmp_path_factory.mktemp("cloud")
    rng, n = np.random.default_rng(5), 300
    t_sigma = rng.uniform(0.01, 0.08, n)
    t_sigma[:20] = np.inf
    TransientGaussians(
        position=rng.uniform(-1, 1, (n, 3)),
        velocity=rng.normal(size=(n, 3)),
        t_mu=rng.uniform(-0.05, 0.4, n),
        t_sigma=t_sigma,
        scale=rng.uniform(0.01, 0.05, (n, 3)),
        rotation=rng.normal(size=(n, 4)),
        opacity=rng.uniform(0.05, 1, n),
        color=rng.uniform(0, 1, (n, 3)),
        dynamic=np.arange(n) % 10 > 0,
    ).save(folder / "result.npz")
    run(EVALUATE, folder, json.dumps(FRAMES))
    return clouds.load(folder / "result.npz"), folder / "seen.npz"


def closed_form(cloud: GaussianCloud, time_s: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions and opacities of the visible Gaussians at a time, and which they are; float64."""
    age = np.where(cloud.dynamic, time_s - cloud.t_mu.astype(float), 0)
    alpha = cloud.opacity * np.exp(-0.5 * (age / cloud.t_sigma) ** 2)
    assert np.abs(alpha - CUT_OFF).min() > 1e-6  # no row on the edge of visibility
    visible = alpha >= CUT_OFF
    return (cloud.position + age[:, None] * cloud.velocity)[visible], alpha[visible], visible


def seen_gaussians(file: Path, mode: str, key: str) -> tuple[np.ndarray, np.ndarray]:
    """World positions and opacities as evaluated; an ellipsoid in renders is a ball of 42 vertices."""
    seen = np.load(file)
    position, alpha = seen[f"{mode}/{key}/position"], seen[f"{mode}/{key}/alpha"]
    if mode != "ellipsoids":
        return position, alpha
    alpha = alpha.reshape(-1, 42)
    assert (alpha == alpha[:, :1]).all()
    return position.reshape(-1, 42, 3).astype(float).mean(1), alpha[:, 0]


@pytest.mark.parametrize("mode", ["ellipsoids", "ellipsoids in points", "points"])
@pytest.mark.parametrize("frame", FRAMES)
def test_positions_and_opacities_over_time(cloud, mode, frame):
    gaussians, file = cloud
    seen, seen_alpha = seen_gaussians(file, mode, str(frame))
    position, alpha, visible = closed_form(gaussians, (frame - START) / FPS)
    assert 0 < visible.sum() < len(gaussians)
    assert len(seen) == visible.sum()
    assert np.abs(seen - position).max() < 1e-5
    assert np.abs(seen_alpha - alpha).max() < 1e-5
    # One frame off would be noticed.
    later = closed_form(gaussians, (frame + 1 - START) / FPS)
    both = visible & later[2]
    assert np.abs(later[0][both[later[2]]] - position[both[visible]]).max() > 1e-3


@pytest.mark.parametrize("frame", FRAMES)
def test_shapes(cloud, frame):
    gaussians, file = cloud
    seen = np.load(file)
    position, _, visible = closed_form(gaussians, (frame - START) / FPS)
    local = seen[f"ellipsoids/{frame}/local"].reshape(-1, 42, 3)
    assert np.allclose(np.linalg.norm(local, axis=2), EXTENT, atol=1e-5)
    axes = np.array(
        [
            rotation_matrix(q.astype(float)) * s
            for q, s in zip(gaussians.rotation[visible], gaussians.scale[visible], strict=True)
        ]
    )
    wanted = position[:, None] + np.einsum("nij,nvj->nvi", axes, local)
    assert np.abs(seen[f"ellipsoids/{frame}/position"].reshape(-1, 42, 3) - wanted).max() < 1e-5
    around = EXTENT * gaussians.scale[visible].astype(float).max(1)
    assert np.abs(seen[f"ellipsoids in points/{frame}/radius"] - around).max() < 1e-5
    radius = EXTENT * np.cbrt(gaussians.scale[visible].astype(float).prod(1))
    assert np.abs(seen[f"points/{frame}/radius"] - radius).max() < 1e-5


@pytest.mark.parametrize("mode", ["ellipsoids", "ellipsoids in points", "points"])
@pytest.mark.parametrize("key, fps", [("moved", 100), ("40 fps", 40)])  # 50 / 1.25 = 40 frames per second
def test_moved_object_and_scene_frame_rate(cloud, mode, key, fps):
    gaussians, file = cloud
    matrix = np.load(file)["matrix"]
    assert np.abs(matrix[:3, :3] - np.eye(3)).max() > 0.1
    seen, seen_alpha = seen_gaussians(file, mode, key)
    position, alpha, visible = closed_form(gaussians, (100 - START) / fps)
    assert len(seen) == visible.sum()
    assert np.abs(seen - (position @ matrix[:3, :3].T + matrix[:3, 3])).max() < 1e-5
    assert np.abs(seen_alpha - alpha).max() < 1e-5


def test_unknown_mode(cloud):
    assert "choose one of points, ellipsoids, arrows, streaks" in str(np.load(cloud[1])["bad mode"])


@pytest.fixture(scope="module")
def rendered(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("rendered")
    for mode, scale in (("ellipsoids", [0.05, 0.12, 0.08]), ("points", [0.1, 0.1, 0.1])):
        TransientGaussians(
            position=[[0.1, 0.05, 0]],
            velocity=[[0, 0, 0]],
            t_mu=[0],
            t_sigma=[np.inf],
            scale=[scale],
            rotation=[[0.9, 0.2, -0.3, 0.4]],
            opacity=[0.8],
            color=[[1, 1, 1]],
            dynamic=[True],
        ).save(folder / f"{mode}.npz")
    rng, n = np.random.default_rng(2), 600
    bright = np.arange(n) % 2 == 0
    TransientGaussians(
        position=rng.uniform([-0.3, -0.1, -0.3], [0.3, 0.1, 0.3], (n, 3)),
        velocity=np.zeros((n, 3)),
        t_mu=np.zeros(n),
        t_sigma=np.full(n, 0.1),
        scale=np.full((n, 3), 0.05),
        rotation=np.tile([1.0, 0, 0, 0], (n, 1)),
        opacity=np.full(n, 0.06),
        color=np.where(bright[:, None], [1.0, 0.7, 0.1], [0.6, 0.1, 0.1]),
        dynamic=np.ones(n, bool),
    ).save(folder / "column.npz")
    run(RENDER, folder)
    return folder


@pytest.mark.parametrize("mode", ["ellipsoids", "ellipsoids in points", "points"])
def test_cycles_shows_the_splat(rendered, mode):
    """A white Gaussian over black, seen orthographically: a pixel is opacity exp(-d^2 / 2) of its projection."""
    g = clouds.load(rendered / f"{mode.split()[0]}.npz")
    axes = rotation_matrix(g.rotation[0].astype(float)) * g.scale[0]
    covariance = (axes @ axes.T)[:2, :2]
    pixel = (np.arange(48) + 0.5) / 48 - 0.5
    offset = np.stack(np.meshgrid(pixel, pixel), -1) - [0.05, 0.05]
    distance = np.sqrt(np.einsum("...i,ij,...j", offset, np.linalg.inv(covariance), offset))
    seen = np.load(rendered / f"{mode}.npy")
    error = seen - 0.8 * np.exp(-0.5 * distance**2)
    # 1024 samples, each all or nothing: at most 0.016 standard deviation per pixel; its mean is 0.003 below the peak.
    assert np.abs(error[distance < 0.9 * EXTENT]).max() < 0.1
    for low, high in ((0, 0.7), (0.7, 1.2), (1.2, 1.7), (1.7, 2.2)):
        assert abs(error[(distance >= low) & (distance < high)].mean()) < 0.008
    assert seen[distance > 1.3 * EXTENT].max() == 0


LINES = (
    COMMON
    + """
scene.render.fps, scene.render.engine = 100, "CYCLES"
scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.pixel_filter_type = 64, False, "BOX"
scene.render.resolution_x = scene.render.resolution_y = 64
camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
scene.collection.objects.link(camera)
scene.camera, camera.location.z = camera, 9.0
camera.data.type, camera.data.ortho_scale = "ORTHO", 2.5
scene.render.image_settings.file_format = "OPEN_EXR"
thing = point_cloud.add_point_cloud(clouds.load(folder / "result.npz"), 1, "arrows")
point_cloud.color_by(thing, "speed")
settings = point_cloud.inputs(thing)
settings["Line Time"] = 0.2
scene.frame_set(20)
seen = {}
for mode in (2, 3):
    settings["Mode"] = mode
    for where in ("render", "viewport"):
        show_as_in(thing, where)
        scene.render.filepath = str(folder / f"lines{mode}{where}.exr")
        bpy.ops.render.render(write_still=True)
        image = bpy.data.images.load(scene.render.filepath)
        seen[f"{mode} {where}"] = np.array(image.pixels[:]).reshape(64, 64, 4)[..., :3]
np.savez(folder / "lines.npz", **seen)
leave()
"""
)


def test_lines_of_the_viewport_look_as_those_of_renders(cloud, tmp_path):
    """Instances have their colours themselves, a mesh has them at its corners: the same picture of both."""
    import shutil

    shutil.copy(cloud[1].with_name("result.npz"), tmp_path)
    run(LINES, tmp_path)
    seen = np.load(tmp_path / "lines.npz")
    for mode in (2, 3):
        mesh, instances = seen[f"{mode} render"], seen[f"{mode} viewport"]
        lit = mesh.max(axis=2) > 0.05
        assert 0.02 < lit.mean() < 0.9 and np.ptp(mesh[lit], axis=0).min() > 0.15, "lines of many colours"
        assert np.abs(mesh - instances).mean() < 0.01 * mesh.mean()


def test_cloud_shows_its_display_colours(rendered):
    """A block of bright and dark Gaussians, half covering the pixels, is shown as its blend of display values."""
    shown = np.transpose(json.loads((rendered / "shown.json").read_text())["column"]).reshape(48, 48, 3)
    middle = shown[16:32, 16:32].mean((0, 1))
    depth = 600 * 2 * np.pi * 0.06 * 0.05**2 / 0.6**2  # the block is seen as 0.6 m x 0.6 m
    wanted = (1 - np.exp(-depth)) * np.array([0.8, 0.4, 0.1])
    assert 0.6 < 1 - np.exp(-depth) < 0.9
    assert np.abs(middle - wanted).max() < 0.04  # 0.05 without the rounds of correction


@pytest.mark.parametrize("transform", ["Standard", "Filmic", "AgX"])
def test_display_values_come_back(rendered, transform):
    linear, shown = json.loads((rendered / "shown.json").read_text())[transform]
    assert np.abs(np.array(shown) - np.linspace(0, 1, 11)).max() < 0.002
    assert linear[0] == 0 and (np.diff(linear) > 0).all() and np.isfinite(linear).all()


ANY_MOMENT = (
    COMMON
    + """
scene.render.use_motion_blur = True
cases, seen = json.loads(sys.argv[2]), {}
cloud = clouds.load(folder / "result.npz")
thing = point_cloud.add_point_cloud(cloud, 1, "points")
settings = point_cloud.inputs(thing)
for k, case in enumerate(cases):
    scene.render.fps, scene.render.fps_base = case["fps"], case["base"]
    settings["Start Frame"], settings["Time Scale"] = case["start"], case["speed"]
    settings["Opacity Cut"] = 0.0
    thing.matrix_world = Matrix(case["matrix"])
    scene.frame_set(int(np.floor(case["frame"])), subframe=case["frame"] % 1)
    evaluated = thing.evaluated_get(bpy.context.evaluated_depsgraph_get())
    geometry = evaluated.evaluated_geometry()
    drawn = geometry.pointcloud
    place, alpha = np.zeros(3 * len(cloud), np.float32), np.zeros(len(cloud), np.float32)
    drawn.attributes["position"].data.foreach_get("vector", place)
    drawn.attributes["gs_alpha"].data.foreach_get("value", alpha)
    matrix = np.array(evaluated.matrix_world)
    seen[f"place{k}"] = place.reshape(-1, 3).astype(float) @ matrix[:3, :3].T + matrix[:3, 3]
    seen[f"alpha{k}"] = alpha
np.savez(folder / "moments.npz", **seen)
leave()
"""
)


def test_any_moment_equals_the_library(cloud, tmp_path):
    """Random times between frames, clocks, start frames and affine objects: as TransientGaussians.at."""
    import shutil

    rng, result = np.random.default_rng(8), TransientGaussians.load(cloud[1].with_name("result.npz"))
    shutil.copy(cloud[1].with_name("result.npz"), tmp_path)
    cases = []
    for k in range(24):
        matrix = np.eye(4)
        if k % 3:
            matrix[:3] = np.column_stack(
                [np.linalg.qr(rng.normal(size=(3, 3)))[0] * rng.uniform(0.3, 1.5, 3), rng.uniform(-1, 1, 3)]
            )
        fps, base = [(24, 1.0), (30, 1.001), (100, 1.0), (50, 1.25)][k % 4]
        frame = (
            float(rng.uniform(-30, 250)) if k % 2 else float(rng.integers(1, 200) + rng.choice([-0.25, 0.25]))
        )  # 180 degree shutter
        speed = [1.0, 0.1, -0.5][k % 3]
        cases.append(
            {
                "fps": fps,
                "base": base,
                "frame": frame,
                "speed": speed,
                "matrix": matrix.tolist(),
                "start": frame - rng.uniform(-0.1, 0.5) / speed * fps / base,
            }
        )
    run(ANY_MOMENT, tmp_path, json.dumps(cases))
    seen = np.load(tmp_path / "moments.npz")
    for k, case in enumerate(cases):
        time_s = (case["frame"] - case["start"]) / (case["fps"] / case["base"]) * case["speed"]
        assert -0.11 < time_s < 0.51
        position, opacity = result.at(time_s)
        matrix = np.array(case["matrix"])
        assert np.abs(seen[f"place{k}"] - (position @ matrix[:3, :3].T + matrix[:3, 3])).max() < 1e-5
        assert np.abs(seen[f"alpha{k}"] - opacity).max() < 1e-5


MOTION_BLUR = (
    COMMON
    + """
scene.render.fps, scene.render.engine = 100, "CYCLES"
scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.pixel_filter_type = 256, False, "BOX"
scene.render.resolution_x, scene.render.resolution_y = 64, 16
scene.view_settings.view_transform = "Standard"
camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
scene.collection.objects.link(camera)
scene.camera, camera.location.z = camera, 5.0
camera.data.type, camera.data.ortho_scale = "ORTHO", 1.0
scene.render.image_settings.file_format = "OPEN_EXR"
scene.render.use_motion_blur, scene.render.motion_blur_shutter = True, 0.5
answer = {}
for mode in ("points", "ellipsoids"):
    thing = point_cloud.add_point_cloud(clouds.load(folder / "moving.npz"), 1, mode)
    for speed in (1.0, 0.5):
        point_cloud.inputs(thing)["Time Scale"] = speed
        scene.frame_set(1 + round(10 / speed))
        scene.render.filepath = str(folder / "blur.exr")
        bpy.ops.render.render(write_still=True)
        image = bpy.data.images.load(scene.render.filepath)
        row = np.array(image.pixels[:]).reshape(16, 64, 4)[4:12, :, 0].sum(0)
        bpy.data.images.remove(image)
        x = (np.arange(64) + 0.5) / 64 - 0.5
        middle = (row * x).sum() / row.sum()
        answer[f"{mode} {speed}"] = [middle, np.sqrt((row * (x - middle) ** 2).sum() / row.sum())]
    bpy.data.objects.remove(thing)
(folder / "blur.json").write_text(json.dumps(answer))
leave()
"""
)


def test_motion_blur(tmp_path):
    """60 m/s past a shutter of 5 ms: a trail of 0.3 m around the place at the frame, though another Gaussian appears
    and vanishes while the shutter is open, so that its ends show other numbers of points."""
    TransientGaussians(
        position=[[0, 0, 0], [0, 0.3, 0]],
        velocity=[[60, 0, 0], [0, 0, 0]],
        t_mu=[0.1, 0.1],
        t_sigma=[9, 0.0005],
        scale=np.full((2, 3), 0.02),
        rotation=np.tile([1.0, 0, 0, 0], (2, 1)),
        opacity=[1, 1],
        color=np.ones((2, 3)),
        dynamic=[True, True],
    ).save(tmp_path / "moving.npz")
    run(MOTION_BLUR, tmp_path)
    answer = json.loads((tmp_path / "blur.json").read_text())
    for mode in ("points", "ellipsoids"):
        for speed in (1.0, 0.5):
            middle, width = answer[f"{mode} {speed}"]
            trail = 60 * 0.005 * speed
            assert abs(middle) < 0.004
            assert width == pytest.approx(np.sqrt(trail**2 / 12 + 0.017**2), rel=0.04)
