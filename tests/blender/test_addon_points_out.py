"""A reconstruction out again as points, read by Blender's own importers, against x0 + (t - t_mu) v."""

import numpy as np
import pytest

from gof.core.gaussians import TransientGaussians
from gof_blender.pure.io import usd_points
from gof_blender.pure.io.cloud import GaussianCloud, load
from tests.blender.runs import in_blender

N, RATE, FIRST, LAST, TIME_SCALE, START = 60, 50, 3, 7, 0.5, 2
WRITE = """
import os
import numpy as np
import gof_blender
gof_blender.register()
folder = sys.argv[1]
scene = bpy.context.scene
scene.render.fps, scene.frame_start, scene.frame_end = 50, 3, 7
bpy.ops.gof.import_result(filepath=folder + "/result.npz", fit="keep", start_frame=2)
thing = bpy.context.object
from gof_blender.scene import point_cloud
settings = point_cloud.inputs(thing)
settings["Time Scale"], settings["Share"], settings["Mode"] = 0.5, 0.5, 2
thing.location = (1.0, 2.0, 3.0)
bpy.context.view_layer.update()
"""
READ = """
def read(importer, path):
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.render.fps = 50
    importer(filepath=path)
    found = {}
    for frame in range(3, 8):
        bpy.context.scene.frame_set(frame)
        graph = bpy.context.evaluated_depsgraph_get()
        shown = [o for o in bpy.data.objects if o.type in ("MESH", "POINTCLOUD")]
        assert len(shown) == 1, shown
        thing = shown[0].evaluated_get(graph)
        matrix = np.array(thing.matrix_world)
        found[frame] = {}
        for attribute in thing.data.attributes:
            width = {"FLOAT": 1, "FLOAT_VECTOR": 3, "FLOAT_COLOR": 4, "QUATERNION": 4}.get(attribute.data_type)
            if width is None or attribute.domain != "POINT":
                continue
            values = np.zeros(len(attribute.data) * width, np.float32)
            field = {"FLOAT": "value", "FLOAT_VECTOR": "vector", "FLOAT_COLOR": "color", "QUATERNION": "value"}
            attribute.data.foreach_get(field[attribute.data_type], values)
            values = values.reshape(-1, width)
            if attribute.name == "position":
                values = values @ matrix[:3, :3].T + matrix[:3, 3]
            if attribute.name == "velocity":
                values = values @ matrix[:3, :3].T
            found[frame][attribute.name] = values.tolist()
    return found
"""


@pytest.fixture(scope="module")
def flame() -> dict[str, np.ndarray]:
    """Moving, fading Gaussians; the last ten stand still and are always on."""
    rng = np.random.default_rng(5)
    dynamic = np.arange(N) < N - 10
    return {
        "position": rng.normal(0, 0.2, (N, 3)),
        "velocity": rng.normal((0, 0, 2), 0.5, (N, 3)),
        "t_mu": rng.uniform(0, 0.06, N),
        "t_sigma": np.where(dynamic, rng.uniform(0.004, 0.02, N), np.inf),
        "scale": rng.uniform(0.005, 0.02, (N, 3)),
        "rotation": rng.normal(size=(N, 4)),
        "opacity": rng.uniform(0.1, 0.9, N),
        "color": rng.uniform(0.1, 1, (N, 3)),
        "dynamic": dynamic,
    }


def truth(flame: dict[str, np.ndarray], frame: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(M,) rows that are seen, their places and velocities on the scene's clock, from the formulas."""
    time_s = (frame - START) / RATE * TIME_SCALE
    age = np.where(flame["dynamic"], time_s - flame["t_mu"], 0.0)
    opacity = flame["opacity"] * np.exp(-0.5 * (age / flame["t_sigma"]) ** 2)
    seen = np.flatnonzero(opacity >= 1 / 255)
    velocity = flame["velocity"] * flame["dynamic"][:, None]
    place = flame["position"] + age[:, None] * velocity + [1.0, 2.0, 3.0]
    return seen, place[seen], velocity[seen] * TIME_SCALE


@pytest.fixture(scope="module")
def folder(tmp_path_factory, flame):
    pytest.importorskip("bpy", reason="the operators need Blender")
    folder = tmp_path_factory.mktemp("points")
    TransientGaussians(**flame).save(folder / "result.npz")
    TransientGaussians(**flame, emissive=True).save(folder / "light.npz")
    return folder


@pytest.fixture(scope="module")
def back(folder):
    """What Blender's own importers read of the two files, and what the operators said."""
    return in_blender(
        WRITE
        + READ
        + """
for name in ("out.usdc", "out.abc", "out.npz", "out.ply"):
    result[name + " said"] = list(bpy.ops.gof.export_points(filepath=f"{folder}/{name}"))
try:
    bpy.ops.gof.export_points(filepath=folder + "/out.obj")
except RuntimeError as error:
    result["other"] = str(error)
thing.rotation_euler[2], thing.scale = np.pi / 2, (2.0, 2.0, 2.0)
bpy.context.view_layer.update()
bpy.ops.gof.export_points(filepath=folder + "/turned.npz")
thing.keyframe_insert(settings.path("Time Scale"), frame=3)
thing.keyframe_insert("location", frame=3)
for name in ("keyed.npz", "keyed.usdc"):
    try:
        bpy.ops.gof.export_points(filepath=f"{folder}/{name}")
    except RuntimeError as error:
        result[name] = str(error)
thing.animation_data_clear()
above = bpy.data.objects.new("Dolly", None)
scene.collection.objects.link(above)
bound = thing.constraints.new("COPY_LOCATION")
bound.target = thing.parent = above
above.driver_add("location", 2).driver.expression = "frame / 10"
thing.driver_add(settings.path("Start Frame")).driver.expression = "frame"
try:
    bpy.ops.gof.export_points(filepath=folder + "/bound.npz")
except RuntimeError as error:
    result["bound"] = str(error)
thing.constraints.remove(bound)
thing.animation_data_clear()
bpy.data.objects.remove(above)
settings["Time Scale"] = 0.0
try:
    bpy.ops.gof.export_points(filepath=folder + "/still.npz")
except RuntimeError as error:
    result["still"] = str(error)
result["after"] = [settings["Mode"], settings["Share"], len(bpy.data.objects), bpy.context.object == thing]
bpy.ops.gof.import_result(filepath=folder + "/light.npz", fit="keep")
light = bpy.context.object
bpy.ops.gof.export_points(filepath=folder + "/shining.npz")
other = thing.copy()
other.data = thing.data.copy()
scene.collection.objects.link(other)
other.select_set(True)
bpy.ops.object.join()
try:
    bpy.ops.gof.export_points(filepath=folder + "/joined.npz")
except RuntimeError as error:
    result["joined"] = str(error)
from pxr import Usd, UsdGeom
stage = Usd.Stage.Open(folder + "/out.usdc")
prim = UsdGeom.Points(stage.GetPrimAtPath("/reconstruction/points"))
result["ids"] = {frame: list(prim.GetIdsAttr().Get(frame)) for frame in range(3, 8)}
api = UsdGeom.PrimvarsAPI(prim)
turned = api.GetPrimvar("rotation").Get(3)
result["rotation"] = [[q.real, *q.imaginary] for q in turned]
result["scale"] = [list(value) for value in api.GetPrimvar("scale").Get(3)]
result["radiance"] = [list(value) for value in api.GetPrimvar("radiance:base").Get(3)]
result["rate"] = [stage.GetTimeCodesPerSecond(), stage.GetStartTimeCode(), stage.GetEndTimeCode()]
result["usd"] = read(bpy.ops.wm.usd_import, folder + "/out.usdc")
result["abc"] = read(bpy.ops.wm.alembic_import, folder + "/out.abc")
result["left"] = sorted(os.listdir(folder))
""",
        folder,
    )


@pytest.mark.blender
@pytest.mark.parametrize("kind", ["usd", "abc"])
def test_places_and_velocities_are_those_of_the_formulas(back, flame, kind):
    for frame in range(FIRST, LAST + 1):
        seen, place, velocity = truth(flame, frame)
        found = back[kind][str(frame)]
        assert 15 < len(seen) < N, "some must be seen and some not"
        np.testing.assert_allclose(found["position"], place, atol=2e-6)
        np.testing.assert_allclose(found["velocity"], velocity, atol=2e-6)


@pytest.mark.blender
@pytest.mark.parametrize("name", ["out.npz", "out.ply"])
def test_moving_gaussians_go_as_in_the_scene(back, folder, flame, name):
    """Read by gof: at the time of a frame, counted from the scene's first, they are where the formulas say."""
    moved = TransientGaussians.load(folder / name)
    assert len(moved) == N and moved.gas_velocity is None, "the result says nothing of the gas"
    for frame in range(FIRST, LAST + 1):
        seen, place, velocity = truth(flame, frame)
        position, opacity = moved.at((frame - FIRST) / RATE)
        np.testing.assert_array_equal(np.flatnonzero(opacity >= 1 / 255), seen)
        np.testing.assert_allclose(position[seen], place, atol=2e-6)
        np.testing.assert_allclose(moved.moving_gas[seen], velocity, atol=2e-6)


@pytest.mark.blender
def test_a_turned_and_scaled_cloud_is_written_where_it_stands(back, folder, flame):
    """A quarter turn about z and twice the size: (x, y, z) goes to 2 (-y, x, z) from the object's place."""
    turned, place = TransientGaussians.load(folder / "turned.npz"), flame["position"]
    x, y, z = place.T
    np.testing.assert_allclose(turned.position, 2 * np.stack([-y, x, z], 1) + [1, 2, 3], atol=2e-6)
    np.testing.assert_allclose(turned.scale, 2 * flame["scale"], rtol=1e-5)
    u, v, w = (TIME_SCALE * flame["velocity"] * flame["dynamic"][:, None]).T
    np.testing.assert_allclose(turned.moving_gas, 2 * np.stack([-v, u, w], 1), atol=2e-6)


@pytest.mark.blender
def test_a_point_keeps_its_number_and_goes_where_its_velocity_says(back):
    """The files alone: the way between two frames is the velocity times the time between them."""
    for frame in range(FIRST, LAST):
        here, there = back["ids"][str(frame)], back["ids"][str(frame + 1)]
        both = sorted(set(here) & set(there))
        assert len(both) > 15
        one, two = (
            np.array(back["usd"][str(k)]["position"])[[ids.index(row) for row in both]]
            for k, ids in ((frame, here), (frame + 1, there))
        )
        velocity = np.array(back["usd"][str(frame)]["velocity"])[[here.index(row) for row in both]]
        np.testing.assert_allclose((two - one) * RATE, velocity, atol=2e-4)
    assert back["rate"] == [RATE, FIRST, LAST]


def same_sign(quaternions, others: np.ndarray) -> np.ndarray:
    """q and -q are the same rotation."""
    quaternions = np.array(quaternions)
    return quaternions * np.sign((quaternions * others).sum(axis=1, keepdims=True))


@pytest.mark.blender
def test_values_of_the_gaussians_go_along(back, flame):
    """Widths are of balls of their volume. What has the names of Blender 5.3's splats is read by USD's own module:
    4.5's importer leaves it out."""
    seen, _, _ = truth(flame, FIRST)
    found = back["usd"][str(FIRST)]
    np.testing.assert_allclose(back["scale"], flame["scale"][seen], rtol=1e-5)
    radius = np.exp(np.log(flame["scale"][seen]).mean(axis=1))
    np.testing.assert_allclose(np.ravel(found["radius"]), radius, rtol=1e-5)
    rotation = flame["rotation"][seen] / np.linalg.norm(flame["rotation"][seen], axis=1, keepdims=True)
    np.testing.assert_allclose(same_sign(back["rotation"], rotation), rotation, atol=1e-6)
    np.testing.assert_allclose(0.5 + 0.28209479 * np.array(back["radiance"])[:, :3], flame["color"][seen], atol=1e-6)
    display = flame["color"][seen]
    light = np.where(display <= 0.04045, display / 12.92, ((display + 0.055) / 1.055) ** 2.4)
    np.testing.assert_allclose(np.array(found["displayColor"])[:, :3], light, rtol=1e-5)
    np.testing.assert_allclose(np.ravel(found["displayOpacity"]), np.array(back["radiance"])[:, 3], rtol=1e-6)


@pytest.mark.blender
def test_light_stays_light(back, folder):
    assert TransientGaussians.load(folder / "shining.npz").emissive


@pytest.mark.blender
def test_the_scene_is_left_as_it_was(back):
    for name in ("out.usdc", "out.abc", "out.npz", "out.ply"):
        assert back[f"{name} said"] == ["FINISHED"]
    assert back["after"] == [2, 0.5, 8, True], "the cloud with four lamps, and the three objects of a new file"
    assert back["left"] == [
        "light.npz",
        "out.abc",
        "out.npz",
        "out.ply",
        "out.usdc",
        "result.npz",
        "shining.npz",
        "turned.npz",
    ], "nothing half-made stays"
    assert ".usdc, .usda or .abc" in back["other"]
    assert "Time Scale is 0" in back["still"]
    for name in ("keyed.npz", "keyed.usdc"):
        assert "Time Scale, location may change over time" in back[name] and "or write .abc" in back[name]
    assert f"{N} of its {2 * N} Gaussians are a flame's light" in back["joined"]
    assert "Start Frame, constraint Copy Location, location of Dolly may change over time" in back["bound"]


@pytest.mark.blender
def test_motion_blur_of_another_scene_is_as_long_as_the_way(tmp_path):
    """One Gaussian at 4 m/s, read from the file into an empty scene: Cycles smears it over its way in the shutter."""
    pytest.importorskip("bpy", reason="Cycles renders")
    one = dict(position=np.zeros((1, 3)), velocity=np.array([[4.0, 0, 0]]), t_mu=np.zeros(1), t_sigma=np.full(1, 0.1))
    one |= dict(scale=np.full((1, 3), 0.01), rotation=np.array([[1.0, 0, 0, 0]]), opacity=np.full(1, 0.9))
    TransientGaussians(**one, color=np.ones((1, 3)), dynamic=np.ones(1, bool)).save(tmp_path / "result.npz")
    found = in_blender(
        WRITE
        + """
thing.location, settings["Time Scale"] = (0, 0, 0), 1.0
bpy.context.view_layer.update()
bpy.ops.gof.export_points(filepath=folder + "/one.usdc")
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.render.fps = 50
bpy.ops.wm.usd_import(filepath=folder + "/one.usdc")
camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
scene.collection.objects.link(camera)
scene.camera = camera
camera.data.type, camera.data.ortho_scale = "ORTHO", 0.5
camera.location = (0.16, 0, 1)
cloud = next(o for o in bpy.data.objects if o.type == "POINTCLOUD")
glow = bpy.data.materials.new("glow")
glow.use_nodes = True
glow.node_tree.nodes.clear()
shine, end = (glow.node_tree.nodes.new(kind) for kind in ("ShaderNodeEmission", "ShaderNodeOutputMaterial"))
glow.node_tree.links.new(shine.outputs[0], end.inputs[0])
cloud.data.materials.append(glow)
scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 64, False
scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 200, 40, 100
scene.view_settings.view_transform = "Raw"
scene.render.image_settings.file_format = "OPEN_EXR"
scene.render.use_motion_blur, scene.render.motion_blur_shutter = True, 0.5
scene.frame_set(4)
for name in ("blurred", "sharp"):
    scene.render.use_motion_blur = name == "blurred"
    scene.render.filepath = f"{folder}/{name}.exr"
    bpy.ops.render.render(write_still=True)
    picture = bpy.data.images.load(scene.render.filepath)
    pixels = np.array(picture.pixels[:]).reshape(40, 200, -1)[..., 0]
    x = np.arange(200) + 0.5
    light = pixels.sum(0)
    mean = (x * light).sum() / light.sum()
    result[name] = [mean * 0.5 / 200 - 0.25 + 0.16, np.sqrt(((x - mean) ** 2 * light).sum() / light.sum()) * 0.5 / 200]
""",
        tmp_path,
    )
    place = 4.0 * (4 - START) / RATE
    assert found["sharp"][0] == pytest.approx(place, abs=0.002)
    assert found["blurred"][0] == pytest.approx(place, abs=0.004)
    way = 4.0 / RATE * 0.5
    spread = np.sqrt(found["blurred"][1] ** 2 - found["sharp"][1] ** 2)
    assert spread == pytest.approx(way / np.sqrt(12), rel=0.1), "that of a box as long as the way"


def test_points_without_blender(tmp_path, flame):
    """Rows, opacities and what a splat's attributes mean: opacity and display colour come back from "radiance"."""
    TransientGaussians(**flame).save(tmp_path / "result.npz")
    cloud: GaussianCloud = load(tmp_path / "result.npz")
    found = usd_points.at(cloud, (FIRST - START) / RATE * TIME_SCALE, 1 / 255, TIME_SCALE)
    seen, place, velocity = truth(flame, FIRST)
    assert found.row.tolist() == seen.tolist()
    np.testing.assert_allclose(found.position + [1.0, 2.0, 3.0], place, atol=1e-6)
    np.testing.assert_allclose(found.velocity, velocity, atol=1e-6)
    np.testing.assert_allclose(0.5 + 0.28209479 * found.radiance[:, :3], flame["color"][seen], atol=1e-6)
    np.testing.assert_array_equal(found.radiance[:, 3], found.opacity)
    assert len(usd_points.at(cloud, 0.0, 1.1)) == 0


@pytest.mark.blender
@pytest.mark.parametrize("emissive", [True, False])
def test_what_goes_out_knows_whether_it_is_emissive(tmp_path, flame, emissive):
    pytest.importorskip("bpy", reason="the operators need Blender")
    TransientGaussians(**flame, emissive=emissive).save(tmp_path / "result.npz")
    found = in_blender(WRITE + "result['emissive'] = point_cloud.cloud_of(thing).emissive", tmp_path)
    assert found["emissive"] is emissive
