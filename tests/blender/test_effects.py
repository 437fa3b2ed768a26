"""Effects on real bakes and renders, all in two toy runs; what a sensor does, without Blender."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gof.core.errors import GofError
from gof.dataset import Dataset
from gof_benchmark.commands import generate
from gof_blender.pure import effects
from gof_blender.pure import spec as scene_spec
from gof_blender.pure.effects import (
    auto_exposure,
    bloom,
    clock,
    exposure,
    fine_noise,
    floor,
    motion_blur,
    moving_emitter,
    obstacles,
    rolling_shutter,
    sensor_noise,
    video_compression,
)
from gof_blender.pure.layout import Layout
from tests.blender.runs import TOY, channels, in_blender

pytest.importorskip("bpy", reason="the generator needs the bpy wheel")
CLIP = replace(TOY.clip, frames=3, fps=50.0, warm_up_frames=6)


def run(spec, folder: Path) -> Layout:
    scene_spec.save(spec, folder / "spec.json")
    generate.main([str(folder / "spec.json"), "--out", str(folder / "data")])
    return Layout(folder / "data")


@pytest.fixture(scope="module")
def camera_run(tmp_path_factory) -> Layout:
    """Everything that happens in a camera, at once."""
    listed = (
        motion_blur.Settings(0.5),
        rolling_shutter.Settings(0.01),
        clock.Settings(0.003),
        auto_exposure.Settings(bright=4.0),
        bloom.Settings(),
        exposure.Settings(0.5),
        sensor_noise.Settings(),
        video_compression.Settings("lossless"),
    )
    spec = replace(TOY, clip=CLIP, effects=listed, cameras=replace(TOY.cameras, count=2, eval_count=1))
    return run(spec, tmp_path_factory.mktemp("camera"))


@pytest.fixture(scope="module")
def gas_run(tmp_path_factory) -> Layout:
    """Everything that happens in the gas: noise, an obstacle, a swinging burner, a floor; a fire as of version 1."""
    ball = obstacles.Obstacle("box", (0.0, 0.0, 0.7), (0.48, 0.48, 0.3))
    listed = (fine_noise.Settings(), obstacles.Settings((ball,)), moving_emitter.Settings(0.1, 0.4), floor.Settings())
    spec = replace(
        TOY,
        clip=replace(CLIP, warm_up_frames=22),
        domain=replace(TOY.domain, resolution=24),
        fire=replace(TOY.fire, light="reaction", speeds="solver"),
        effects=listed,
        ground_truth=("grids", "flow", "vdb"),
    )
    return run(spec, tmp_path_factory.mktemp("gas"))


@pytest.mark.blender
def test_grids_flow_and_vdb_are_written_when_listed(gas_run, camera_run):
    zarr = pytest.importorskip("zarr")
    flame = zarr.open_array(str(gas_run.grid("flame")), mode="r")
    assert flame.attrs["light_exponent"] == 1.3  # as the fire's material has it (docs/formats.md)
    field = Dataset.open(gas_run.root).velocity.at(0.04)
    assert flame.shape == (3, *field.velocity.shape[:3]) and 0.2 < flame[2].max() <= 1.01
    z = (flame[2].sum((0, 1)) * np.arange(flame.shape[3])).sum() / flame[2].sum() * field.index_to_world[2, 2]
    assert 0.05 < z < 0.6, "the flame burns between burner and obstacle"
    assert zarr.open_array(str(gas_run.grid("heat")), mode="r")[2].max() > 0.1
    flow = channels(gas_run.flow("cam_1", 2))
    mask = Dataset.open(gas_run.root).mask(1, 2) > 0
    assert set(flow) == {"flow.X", "flow.Y", "weight"} and not flow["weight"][~mask].any()
    assert flow["flow.Y"][mask].mean() < -0.2, "flames rise"
    found = in_blender(
        """
        import numpy as np
        from gof_blender.scene import images  # puts Blender's own Python packages on the path
        import openvdb
        grids, _ = openvdb.readAll(sys.argv[1])
        for grid in grids:
            value = np.zeros((19, 19, 24) + ((3,) if "Vec3" in type(grid).__name__ else ()), np.float32)
            result[grid.name] = [list(grid.transform.indexToWorld(index)) for index in ((0, 0, 0), (1, 2, 3))]
            if grid.name == "velocity":
                inside = np.zeros((6, 6, 12, 3), np.float32)
                grid.copyToArray(inside, ijk=(3, 3, 0))
                result["values"] = inside.tolist()
        bpy.ops.object.volume_import(filepath=sys.argv[1])
        volume = bpy.context.object.data
        volume.grids.load()
        result["blender"] = sorted(grid.name for grid in volume.grids)
    """,
        gas_run.vdb(2),
    )
    cell = field.index_to_world[0, 0]
    np.testing.assert_allclose(
        found["velocity"],
        field.index_to_world[:3, 3] + [[cell / 2] * 3, [1.5 * cell, 2.5 * cell, 3.5 * cell]],
        atol=1e-5,
    )
    np.testing.assert_allclose(found["values"], field.velocity[3:9, 3:9, :12].astype(float), atol=5e-3)
    assert {"flame", "heat", "velocity"} <= set(found["blender"])
    assert not (camera_run.root / "grids").exists() and not (camera_run.root / "vdb").exists(), "only where listed"


@pytest.mark.blender
def test_gas_comes_through_the_bottom_unless_there_is_a_floor(gas_run, camera_run):
    def lowest(layout):
        velocity = Dataset.open(layout.root).velocity
        return max(float(np.abs(velocity.frame(k).velocity[:, :, 0, 2]).max()) for k in range(len(velocity)))

    assert lowest(gas_run) == 0.0
    assert lowest(camera_run) > 0.1


@pytest.mark.blender
def test_cameras_record_when_they_saw(camera_run):
    meta = json.loads(camera_run.description.read_text())
    assert [camera["role"] for camera in meta["cameras"]] == ["train", "train", "eval"]
    lines = meta["cameras"][0]["width"]  # portrait: sensor rows are columns
    for camera in meta["cameras"]:
        assert camera["row_time_s"] == pytest.approx(0.01 / lines)
        offset = np.subtract(camera["time_s"], meta["time_s"])
        np.testing.assert_allclose(offset, offset[0], atol=1e-12)
        assert 0 < abs(offset[0]) < 0.01
    assert len(Dataset.open(camera_run.root).cameras) == 2, "evaluation cameras are not trained on"


@pytest.mark.blender
def test_lines_are_the_weighted_sum_of_the_steps_they_see(camera_run):
    found = in_blender(
        """
        import numpy as np
        from pathlib import Path
        from gof_blender.pure import spec as scene_spec
        from gof_blender.pure.layout import Layout
        from gof_blender.scene import render
        mantaflow.enable()
        layout = Layout(Path(sys.argv[1]))
        spec = scene_spec.load(layout.spec)
        bpy.ops.wm.open_mainfile(filepath=str(layout.blend))
        renderer = render.FrameRenderer(spec, layout)
        frame, camera = 1, 0
        beauty, flame, cover = renderer._light(frame, camera)
        first, weights = spec.timeline.weights(camera, frame)
        bpy.context.scene.render.use_border = False
        total = 0.0
        for step, weight in enumerate(weights):
            render._go_to(spec.timeline.blender_frame(frame) + first + step)
            whole = render._flame(render._render(renderer._cameras[camera], layout.hidden / "shot.exr"))
            total = total + whole * weight[None, ::-1, None]  # rolled by 90 degrees, it reads columns right to left
            result[f"step {step}"] = float(whole.mean())
        result["error"], result["largest"] = float(abs(total - flame).max()), float(flame.max())
        result["steps"] = len(weights)
    """,
        camera_run.root,
    )
    assert found["steps"] >= 4 and found["largest"] > 0.5
    assert len({found[f"step {step}"] for step in range(found["steps"])}) == found["steps"], (
        "every step is another instant"
    )
    assert found["error"] < 0.02 * found["largest"]


@pytest.mark.blender
def test_pictures_went_through_a_codec_and_light_did_not(camera_run):
    stages = {stage["name"] for stage in json.loads(camera_run.costs.read_text())["stages"]}
    assert stages == {"bake", "render", "video", "ground-truth", "finish"}
    import cv2

    for name in ("cam_0", "eval_0"):
        assert camera_run.video(name).stat().st_size > 500
        # Even a "lossless" video halves the resolution of colour; grey values stay.
        decoded = [cv2.imread(str(camera_run.frame(name, k).rgb), cv2.IMREAD_GRAYSCALE).astype(float) for k in range(3)]
        before = [
            cv2.imread(str(camera_run.uncompressed(name, k)), cv2.IMREAD_GRAYSCALE).astype(float) for k in range(3)
        ]
        errors = np.array([[np.abs(a - b).mean() for b in before] for a in decoded])
        assert 0 < np.diag(errors).max() < 3, "changed, and by little"
        assert (errors.argmin(1) == range(3)).all(), "frames keep their place"
        assert np.isfinite(channels(camera_run.frame(name, 1).exr)["R"]).all()


def test_exposure_and_noise_follow_their_laws():
    spec = replace(TOY, effects=(exposure.Settings(spread_ev=0.5),))
    light = np.full((40, 50, 3), 0.3, np.float32)
    stops = [exposure.stops(spec.effects[0], spec.timeline.picture(camera, 0)) for camera in range(3)]
    assert len(set(stops)) == 3
    np.testing.assert_allclose(
        effects.expose(light, spec.effects, spec.timeline.picture(1, 0)), light * 2 ** stops[1], rtol=1e-6
    )
    noisy = replace(TOY, effects=(sensor_noise.Settings(electrons=1000, read_noise=5),))
    first, second = noisy.timeline.picture(0, 0), noisy.timeline.picture(0, 1)
    seen = effects.expose(light, noisy.effects, first)
    assert seen.mean() == pytest.approx(0.3, rel=0.01)
    assert seen.std() == pytest.approx(np.sqrt(300 + 25) / 1000, rel=0.05)
    np.testing.assert_array_equal(seen, effects.expose(light, noisy.effects, first))
    assert (seen != effects.expose(light, noisy.effects, second)).any()
    dark = effects.expose(np.array([[[-1.0, 0.0, 0.0]]]), noisy.effects, first)
    assert np.isfinite(dark).all() and (dark >= 0).all()


def test_bloom_keeps_the_light_and_spreads_it_evenly():
    point = np.zeros((60, 80, 3))
    point[30, 40] = 1000.0
    settings = bloom.Settings(amount=0.2, core=0.02)
    picture = TOY.timeline.picture(0, 0)
    seen = bloom.expose(point, settings, picture)
    assert seen[30, 40, 0] > 800 and 900 < seen[..., 0].sum() <= 1000 + 1e-6, "the rest leaves the picture"
    ring = seen[30, 40 + 3, 0] / seen[30, 40 + 9, 0]
    core = 0.02 * 80
    assert ring == pytest.approx(((9**2 / core**2 + 1) / (3**2 / core**2 + 1)) ** 1.5, rel=1e-6)
    assert seen[30, 40 + 5, 0] == pytest.approx(seen[30 - 5, 40, 0])
    assert bloom.expose(point, bloom.Settings(amount=0.0), picture) == pytest.approx(point, abs=1e-9)
    assert seen[0, 0, 0] < seen[59, 40, 0], "nothing comes round from the other side"


def test_auto_exposure_brings_the_bright_parts_where_they_shall_be():
    settings = auto_exposure.Settings(bright=8.0, share=0.1)
    flame = np.linspace(0, 100, 1001)[:, None] * [1.0, 0.5, 0.1]
    assert effects.gain((settings,), flame) == pytest.approx(8 / 90)
    assert effects.gain((settings,), 1e-12 * flame) == 2.0**6 and effects.gain((settings,), flame[:0]) == 1.0


@pytest.mark.blender
def test_gas_flows_around_an_obstacle(gas_run):
    field = Dataset.open(gas_run.root).velocity.at(0.04)
    speed = np.linalg.norm(field.velocity.astype(float), axis=-1)
    centres = np.stack(np.meshgrid(*(np.arange(n) + 0.5 for n in speed.shape), indexing="ij"), -1)
    world = centres @ field.index_to_world[:3, :3].T + field.index_to_world[:3, 3]
    cell = field.index_to_world[2, 2]
    inside = (np.abs(world - [0, 0, 0.7]) < np.array([0.24, 0.24, 0.15]) - 1.5 * cell).all(-1)
    assert inside.any()
    moving = speed.max()
    assert moving > 0.3
    assert speed[inside].max() < 0.02 * moving, "nothing flows in the solid"
    below = (np.abs(world[..., :2]) < 0.15).all(-1) & (np.abs(world[..., 2] - 0.55 - 0.5 * cell) < 0.51 * cell)
    beside = (np.abs(world[..., :2]) < 0.15).all(-1) & (np.abs(world[..., 2] - 0.35) < 0.51 * cell)
    upwards = np.abs(field.velocity[..., 2].astype(float))
    assert upwards[below].mean() < 0.35 * upwards[beside].mean(), "no flow through its lower face"


@pytest.mark.blender
def test_noise_and_motion_reach_the_bake_and_nothing_else_does(gas_run, camera_run):
    assert list((gas_run.bake / "noise").glob("*")), "the detail is simulated"
    tile = "waveletNoiseTile.bin"
    assert (gas_run.hidden / tile).exists() and not Path(tile).exists(), "Mantaflow leaves files in the cache only"
    found = in_blender(
        """
        import numpy as np
        from gof_blender.scene.fire_objects import find_flame
        mantaflow.enable()
        bpy.ops.wm.open_mainfile(filepath=sys.argv[1])
        for frame in (1, 6):
            bpy.context.scene.frame_set(frame)
            result[str(frame)] = list(bpy.data.objects["Fire Burner"].matrix_world.translation)
        result["noise"] = find_flame().modifiers["Fluid"].domain_settings.use_noise
    """,
        gas_run.blend,
    )
    assert found["noise"]
    said = [Dataset.open(made.root).description.provenance.get("not_in_velocity") for made in (gas_run, camera_run)]
    assert said == ["fine_noise", None], "its own motion is not in the truth, and the dataset says so"
    np.testing.assert_allclose(np.subtract(found["6"], found["1"]), [0.1, 0, 0], atol=1e-4)  # a quarter of the period


FOREIGN = """
import sys, bpy, math
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
scene.unit_settings.scale_length = 0.01  # drawn in centimetres
marker = bpy.data.objects.new("Hearth", None)
marker.location, marker.rotation_euler = (200.0, 100.0, 50.0), (0, 0, math.pi / 2)
scene.collection.objects.link(marker)
def box(name, location, size, parent=None):
    bpy.ops.mesh.primitive_cube_add(size=1, location=location)
    thing = bpy.context.object
    thing.name, thing.scale, thing.parent = name, size, parent
    return thing
box("Wall", (0, 100, 100), (10, 600, 400))
box("Floor", (200, 100, 45), (900, 900, 10))
lamp_post = box("Post", (0, 0, 0), (5, 5, 5))
child = box("Child", (0, 20, 0), (2, 2, 2), lamp_post)
lamp_post.location = (250, 100, 60)
screen = box("Screen", (10, 25, 90), (2, 40, 40))
glow = bpy.data.materials.new("Glow")
glow.use_nodes = True
glow.node_tree.nodes["Principled BSDF"].inputs["Emission Strength"].default_value = 3.0
screen.data.materials.append(glow)
lamp = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "POINT"))
lamp.data.energy, lamp.location = 3e6, (400, 0, 300)
scene.collection.objects.link(lamp)
scene.collection.objects.link(bpy.data.objects.new("Their Camera", bpy.data.cameras.new("c")))
bpy.context.view_layer.update()
bpy.ops.wm.save_as_mainfile(filepath=sys.argv[1])
"""


@pytest.mark.blender
def test_a_users_blend_file_is_the_background(tmp_path):
    from gof_blender.pure.spec import BlendFile

    subprocess.run([sys.executable, "-c", FOREIGN, str(tmp_path / "room.blend")], check=True, capture_output=True)
    spec = replace(TOY, clip=CLIP, background="blend_file", blend_file=BlendFile("room.blend", "Hearth"))
    layout = run(spec, tmp_path)
    found = in_blender(
        """
        bpy.ops.wm.open_mainfile(filepath=sys.argv[1])
        for name in ("Wall", "Post", "Child"):
            result[name] = [list(row) for row in bpy.data.objects[name].matrix_world]
        result["lamp"] = bpy.data.objects["Lamp"].data.energy
        result["cameras"] = sorted(o.name for o in bpy.data.objects if o.type == "CAMERA")
        result["scenes"] = len(bpy.data.scenes)
    """,
        layout.blend,
    )
    # The empty is the origin, its X axis (their +Y) is ours, and centimetres are metres.
    np.testing.assert_allclose(np.array(found["Wall"])[:3, 3], [0.0, 2.0, 0.5], atol=1e-5)
    np.testing.assert_allclose(np.array(found["Post"])[:3, 3], [0.0, -0.5, 0.1], atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(np.array(found["Wall"])[:3, :3], axis=0), [0.1, 6.0, 4.0], rtol=1e-5)
    assert np.linalg.norm(np.array(found["Child"])[:3, 3] - np.array(found["Post"])[:3, 3]) == pytest.approx(
        1.0, rel=0.01
    )
    assert (
        found["lamp"] == pytest.approx(300.0)
        and found["cameras"] == ["cam_0", "cam_1", "cam_2"]
        and found["scenes"] == 1
    )
    frame, plate = channels(layout.frame("cam_1", 2).exr), channels(layout.static_exr("cam_1"))
    depth = frame["Z"][frame["Z"].shape[0] // 2, frame["Z"].shape[1] // 2]
    assert depth == pytest.approx(2.8 + 1.95 / np.cos(np.arctan2(0.15, 2.8)), rel=0.03), (
        "the wall is where it should be"
    )
    # The screen shines in the picture once, from the plate, and is not flame.
    lit = plate["R"] > 2.0
    assert lit.any() and frame["flame.R"][lit].max() < 0.05
    assert np.median(frame["R"][lit] / plate["R"][lit]) < 1.05
    broken = replace(spec, blend_file=BlendFile(str(tmp_path / "room.blend"), "Nowhere"))
    with pytest.raises(GofError, match="its empties: Hearth"):
        (tmp_path / "broken").mkdir()
        run(broken, tmp_path / "broken")
