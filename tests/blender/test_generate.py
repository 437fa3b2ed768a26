"""The generator on a toy fire: real bake, real Cycles, one Blender process a stage."""

import gzip
import json
import os
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gof.core.errors import GofError
from gof.dataset import Dataset
from gof_benchmark.commands import generate
from gof_benchmark.scenes import claim, load_scene
from gof_blender.pure import spec as scene_spec
from gof_blender.pure.effects import fine_noise, moving_emitter, obstacles, smoke, vorticity, wind
from gof_blender.pure.layout import DRAWN, Layout
from gof_blender.pure.spec import SceneSpec
from tests.blender.runs import TOY, channels, in_blender

pytest.importorskip("bpy", reason="the generator needs the bpy wheel")
pytestmark = pytest.mark.blender

IMAGES = TOY.clip.frames * TOY.cameras.count


@pytest.fixture(scope="module")
def toy(tmp_path_factory) -> Layout:
    """A finished toy dataset; tests must not change it."""
    folder = tmp_path_factory.mktemp("generate")
    scene_spec.save(TOY, folder / "toy.json")
    assert (
        generate.main([str(folder / "toy.json"), "--out", str(folder / "toy"), "--json", str(folder / "costs.json")])
        == 0
    )
    costs = json.loads((folder / "costs.json").read_text())
    walls = {stage["name"]: stage["settings"]["wall_s"] for stage in costs["stages"]}
    assert sorted(walls) == ["bake", "finish", "ground-truth", "render"], (
        "and no stage for an effect that is not listed"
    )
    assert max(walls.values()) <= costs["wall_s"] < sum(stage["seconds"] for stage in costs["stages"]) + 20
    return Layout(folder / "toy")


def copy_of(toy: Layout, folder: Path, *without: str) -> Layout:
    shutil.copytree(toy.root, folder, ignore=shutil.ignore_patterns(*without))  # keeps the times of the files
    return Layout(folder)


def worker(layout: Layout, stage: str) -> list[str]:
    return [
        sys.executable,
        "-m",
        "gof_blender.worker.generate",
        "--spec",
        str(layout.spec),
        "--out",
        str(layout.root),
        "--stage",
        stage,
    ]


def kill_after(layout: Layout, stage: str, done: int) -> None:
    """Start a stage and end it with SIGKILL once it has reported that many steps."""
    with subprocess.Popen(worker(layout, stage), stdout=subprocess.PIPE, text=True) as process:
        for line in process.stdout:
            if json.loads(line)["progress"]["done"] >= done:
                process.send_signal(signal.SIGKILL)
                break
        assert process.wait() == -signal.SIGKILL


def image_times(layout: Layout) -> dict[str, int]:
    files = [*layout.root.glob("cameras/*/*/[0-9]*"), *layout.root.glob("static/*")]
    return {str(path.relative_to(layout.root)): path.stat().st_mtime_ns for path in files}


def test_dataset_opens(toy):
    dataset = Dataset.open(toy.root)
    assert dataset.description.effects == ()
    assert SceneSpec.from_dict(dataset.description.spec) == TOY
    np.testing.assert_allclose(dataset.times_s, np.arange(5) / 60.0, rtol=0, atol=1e-15)
    assert (dataset.train_frames, dataset.test_frames) == ([0, 1, 2, 3], [4])
    assert [(camera.width, camera.height) for camera in dataset.cameras] == [(43, 76)] * 3
    assert {(camera.roll_deg, camera.readout) for camera in dataset.description.cameras} == {(90, "left")}
    assert dataset.image(2, 4).shape == dataset.static(2).shape == (76, 43, 3)
    field = dataset.velocity.at(dataset.times_s[2])
    assert field.velocity.shape == (10, 10, 20, 3)
    np.testing.assert_allclose(field.index_to_world @ [0, 0, 0, 1], [*TOY.domain.min, 1], atol=1e-6)
    np.testing.assert_allclose(field.index_to_world @ [10, 10, 20, 1], [*TOY.domain.max, 1], atol=1e-5)
    above = np.array([np.add(TOY.fire.position, (0, 0, 0.3))])
    assert field.sample(above)[0, 2] > 0.3, "hot gas rises"


def test_exr_follows_the_contract(toy):
    files = toy.frame("cam_1", 2)
    frame = channels(files.exr)
    assert set(frame) == {"R", "G", "B", "A", "Z", "flame.R", "flame.G", "flame.B"}
    assert frame["Z"].dtype == np.float32 and frame["R"].dtype == np.float16
    assert all(np.isfinite(channel).all() for channel in frame.values())
    # The floor seen at the bottom of the middle camera: camera depth of the plane z = 0, from the recorded pose.
    camera = Dataset.open(toy.root).cameras[1]
    ray = np.linalg.inv(camera.K) @ [camera.width / 2, camera.height - 0.5, 1.0]
    to_world = np.linalg.inv(camera.world_to_camera)
    depth = -to_world[2, 3] / (to_world[:3, :3] @ ray)[2]
    assert frame["Z"][-1, camera.width // 2] == pytest.approx(depth, rel=0.02)
    mask = Dataset.open(toy.root).mask(1, 2)
    flame = np.stack([frame[f"flame.{channel}"] for channel in "RGB"], axis=-1)
    assert set(np.unique(mask)) == {0.0, 1.0}
    np.testing.assert_array_equal(mask > 0, flame.max(axis=-1) > 0.02)
    rows, columns = np.nonzero(mask)
    pixel, _ = camera.project(np.array([TOY.fire.position]))
    assert abs(columns.mean() - pixel[0, 0]) < 5 and rows.max() < pixel[0, 1] + 5, "the flame stands on its burner"


def test_plate_has_no_fire(toy):
    for name in TOY.cameras.names:
        plate = channels(toy.static_exr(name))
        assert not any(plate[f"flame.{channel}"].any() for channel in "RGB")
        frame = channels(toy.frame(name, 2).exr)
        lit = frame["flame.R"] > 0.1
        assert lit.any() and (frame["R"][lit] > plate["R"][lit] + 0.05).all()
        assert plate["G"].mean() > 0.005, "the lamps are on"


def test_plate_plus_fire_is_the_full_render(toy):
    """Light adds up: one render of everything has the same mean light as plate plus fire, image region by region."""
    found = in_blender(
        """
        import numpy as np, pathlib
        from gof_blender.scene import render, rig, images
        from gof_blender.pure import spec as scene_spec
        mantaflow.enable()
        bpy.ops.wm.open_mainfile(filepath=sys.argv[1])
        scene, spec, beside = bpy.context.scene, scene_spec.load(sys.argv[2]), pathlib.Path(sys.argv[3])
        scene.frame_set(spec.timeline.first_frame + 2)
        scene.cycles.samples, camera, domain = 64, rig.find(spec)[1], render.find_flame()
        def shot():
            return render._beauty(render._render(camera, beside))[..., :3]
        full = shot()
        # Display values of an array are those Blender itself saves for its render.
        images.set_format(scene.render.image_settings, "PNG")
        scene.render.image_settings.color_mode = "RGB"
        scene.render.image_settings.color_depth = "8"
        bpy.data.images["Render Result"].save_render(str(beside.with_name("blender.png")), scene=scene)
        render._write_png(beside.with_name("ours.png"), full)
        ours, blender = (images._read(beside.with_name(name))[0] for name in ("ours.png", "blender.png"))
        result["display"] = float(abs(ours - blender).max())
        domain.hide_render = True
        plate = shot()
        domain.hide_render = False
        render._leave_only_the_fire()
        fire = shot()
        def regions(image):
            return image[:76, :42].reshape(4, 19, 3, 14, 3).mean((1, 3))
        result["full"], result["sum"], result["plate"] = (regions(x).tolist() for x in (full, plate + fire, plate))
    """,
        toy.blend,
        toy.spec,
        toy.hidden / "shot.exr",
    )
    full, together, plate = (np.array(found[name]) for name in ("full", "sum", "plate"))
    assert np.abs(together - full).max() < 0.03 * full.max()
    np.testing.assert_allclose(together.mean(), full.mean(), rtol=0.02)
    assert full.mean() > 1.1 * plate.mean(), "without the fire the comparison would show nothing"
    assert found["display"] <= 1.01 / 255


@pytest.mark.parametrize("roll", [90, 0])
def test_cameras_agree_with_blender(tmp_path, roll):
    spec = replace(TOY, cameras=replace(TOY.cameras, roll_deg=roll, look_at=(0.1, -0.2, 0.7), height=1.4))
    scene_spec.save(spec, tmp_path / "spec.json")
    found = in_blender(
        """
        import numpy as np
        from bpy_extras.object_utils import world_to_camera_view
        from mathutils import Vector
        from gof_blender.pure import spec as scene_spec
        from gof_blender.scene import build, rig
        spec = scene_spec.load(sys.argv[1])
        build.scene(spec)
        bpy.context.view_layer.update()
        scene = bpy.context.scene
        points = np.random.default_rng(0).uniform(-1, 1, (200, 3)).astype(np.float32)
        result["size"] = scene.render.resolution_x, scene.render.resolution_y
        result["points"], result["cameras"] = points.tolist(), []
        for camera in rig.find(spec):
            seen = [list(world_to_camera_view(scene, camera, Vector(point))) for point in points.tolist()]
            result["cameras"].append(vars(rig.describe(camera, spec, {})) | {"seen": seen})
    """,
        tmp_path / "spec.json",
    )
    width, height = found["size"]
    assert (width < height) == (roll == 90)
    points = np.c_[np.array(found["points"]), np.ones(200)]
    for camera in found["cameras"]:
        seen = np.array(camera["seen"])  # x right and y up in the unit square, depth
        local = points @ np.array(camera["world_to_camera"]).T
        pixels = local[:, :3] @ np.array(camera["K"]).T
        pixels = pixels[:, :2] / pixels[:, 2:]
        expected = np.c_[seen[:, 0] * width, (1 - seen[:, 1]) * height]
        assert np.abs(pixels - expected).max() < 1e-4
        np.testing.assert_allclose(local[:, 2], seen[:, 2], atol=1e-5)
        centre = np.array(camera["K"]) @ (np.array(camera["world_to_camera"]) @ [0.1, -0.2, 0.7, 1])[:3]
        np.testing.assert_allclose(centre[:2] / centre[2], [width / 2, height / 2], atol=1e-3)


def test_only_what_is_missing_is_rendered(toy, tmp_path):
    layout = copy_of(toy, tmp_path / "copy")
    before = image_times(layout)
    lost, cut = layout.frame("cam_1", 3), layout.frame("cam_2", 1)
    wanted = channels(lost.exr)
    lost.rgb.unlink()
    os.truncate(cut.exr, cut.exr.stat().st_size // 2)
    subprocess.run(worker(layout, "render"), check=True, capture_output=True)
    after = image_times(layout)
    assert after.keys() == before.keys()
    changed = {Path(name) for name in before if before[name] != after[name]}
    assert changed == {path.relative_to(layout.root) for files in (lost, cut) for path in vars(files).values()}
    for name, channel in channels(lost.exr).items():
        np.testing.assert_array_equal(channel, wanted[name])


PLATES = 3  # they count among the pictures


def test_killed_render_redoes_no_finished_frame(toy, tmp_path):
    layout = copy_of(toy, tmp_path / "copy", "cameras", "static", "dataset.json")
    kill_after(layout, "render", PLATES + 4)
    before = image_times(layout)
    assert 4 * 3 <= len(before) < 3 * IMAGES
    run = subprocess.run(worker(layout, "render"), check=True, capture_output=True, text=True)
    after = image_times(layout)
    # The EXR is a frame's last file: where it exists, the frame was finished.
    finished = {path for path in before if "/exr/" in path or path.startswith("static")}
    assert len(finished) >= 4 + 2 * 3
    assert {path for path in finished if after[path] != before[path]} == set()
    assert len([name for name in after if name.startswith("cameras")]) == 3 * IMAGES
    progress, cost = (json.loads(line) for line in run.stdout.splitlines()[-2:])
    assert progress == {"progress": {"stage": "render", "done": PLATES + IMAGES, "total": PLATES + IMAGES}}
    assert cost["cost"]["cpu_s"] > 0
    assert not list(layout.root.rglob(".*.partial*")), "no draft is left"


ALL_AT_ONCE = (wind.Settings(), smoke.Settings(), obstacles.Settings(), moving_emitter.Settings())


@pytest.mark.parametrize("added", [(), (fine_noise.Settings(),), ALL_AT_ONCE], ids=["plain", "fine noise", "all"])
def test_a_killed_bake_goes_on_and_burns_the_same_to_the_bit(tmp_path, added):
    spec = replace(TOY, clip=replace(TOY.clip, frames=12), effects=TOY.effects + added)
    whole, killed = (Layout(tmp_path / name) for name in ("whole", "killed"))
    for layout in (whole, killed):
        claim(layout, spec)
    subprocess.run(worker(whole, "bake"), check=True, capture_output=True)
    kill_after(killed, "bake", 18)
    assert not killed.bake_marker.exists()
    failed = subprocess.run(worker(killed, "render"), capture_output=True, text=True)
    assert failed.returncode == 1 and "run --stage bake first" in failed.stderr
    complete = range(spec.timeline.first_frame, killed.newest_step())
    assert len(complete) >= 1, "killed amid the clip"
    times = {step: killed.cached_velocity(step).stat().st_mtime_ns for step in complete}
    subprocess.run(worker(killed, "bake"), check=True, capture_output=True)
    assert all(killed.cached_velocity(step).stat().st_mtime_ns == then for step, then in times.items())
    there, again = (cached(layout) for layout in (whole, killed))
    assert there.keys() == again.keys() and len(there) > 3 * spec.clip.frames
    assert [name for name in there if there[name] != again[name]] == []


def test_a_bake_killed_between_its_last_step_and_its_end_goes_on(toy, tmp_path):
    """What its last step needs is there until the bake is finished."""
    killed = Layout(tmp_path / "killed")
    claim(killed, TOY)
    die = """
        import os, signal
        from gof_blender.worker import generate
        end = generate.write_json
        generate.write_json = lambda path, what: os.kill(os.getpid(), 9) if "cut_off" in what else end(path, what)
        generate.main(sys.argv[1:])
    """
    with pytest.raises(AssertionError):
        in_blender(die, *worker(killed, "bake")[3:])
    assert killed.newest_step() == TOY.timeline.last_frame and not killed.bake_marker.exists()
    subprocess.run(worker(killed, "bake"), check=True, capture_output=True)
    assert cached(killed) == cached(toy) != {}


def cached(layout: Layout) -> dict[str, bytes]:
    """Return the cache's grids by file, unpacked and without their headers, which hold the time of writing."""
    files = [path for path in layout.bake.rglob("*.uni") if "config" not in path.parts]
    return {str(path.relative_to(layout.bake)): gzip.open(path).read()[292:] for path in files}


def test_the_cache_holds_what_is_drawn_and_no_more(toy):
    needed = TOY.timeline.steps_needed
    files = [path.stem.rpartition("_") for path in toy.bake.glob("data/*.uni")]
    assert {int(number) for _, _, number in files} == set(needed)
    assert {name for name, _, _ in files} <= set(DRAWN) >= {"vel", "flame", "heat"}


def test_a_bake_of_another_blender_starts_over(tmp_path):
    layout = Layout(tmp_path / "toy")
    claim(layout, TOY)
    kill_after(layout, "bake", 6)
    assert layout.go_on_after("3.4.1") == 0 and layout.newest_step() >= 6, "and nothing is removed"
    layout.bake_begun.unlink()
    assert layout.go_on_after("4.5.0") == 0


def test_a_finished_dataset_is_left_alone(toy, capfd):
    before = image_times(toy)
    description = toy.description.read_bytes()
    generate.main([str(toy.spec), "--out", str(toy.root)])
    assert image_times(toy) == before and toy.description.read_bytes() == description


def test_folder_of_another_spec_is_refused(toy, tmp_path):
    other = replace(TOY, seed=4)
    with pytest.raises(GofError, match=r"made from another spec \(seed differ"):
        claim(toy, other)
    (tmp_path / "note.txt").write_text("mine")
    with pytest.raises(GofError, match="not empty"):
        claim(Layout(tmp_path), TOY)
    with pytest.raises(GofError, match="neither a spec file nor a built-in scene"):
        load_scene("nowhere")


def test_only_listed_effects_are_built(tmp_path):
    every = replace(TOY, effects=(smoke.Settings(), vorticity.Settings(), wind.Settings(direction_deg=30.0)))
    for name, spec in (("none", TOY), ("all", every)):
        scene_spec.save(spec, tmp_path / f"{name}.json")
    found = in_blender(
        """
        from gof_blender.pure import spec as scene_spec
        from gof_blender.scene import build
        for name in ("none", "all"):
            fire = build.scene(scene_spec.load(f"{sys.argv[1]}/{name}.json"))
            settings = fire.domain_settings
            bpy.context.view_layer.update()
            wind = bpy.data.objects.get("Wind")
            result[name] = {
                "smoke": settings.flame_smoke,
                "vorticity": settings.vorticity,
                "flame_vorticity": settings.flame_vorticity,
                "reads_density": any(
                    getattr(node, "attribute_name", "") == "density" for node in fire.material.node_tree.nodes
                ),
                "fields": [o.field.type for o in bpy.data.objects if o.field and o.field.type != "NONE"],
                "wind_to": list(wind.matrix_world.to_3x3().col[2]) if wind else None,
                "noise": settings.use_noise,
                "adaptive": settings.use_adaptive_timesteps,
                "format": settings.cache_data_format}
    """,
        tmp_path,
    )
    always = {"noise": False, "adaptive": False, "format": "UNI"}
    assert (
        found["none"]
        == {"smoke": 0, "vorticity": 0, "flame_vorticity": 0, "reads_density": False, "fields": [], "wind_to": None}
        | always
    )
    assert (
        found["all"]["smoke"] == pytest.approx(0.5 * TOY.fuel.soot)
        and found["all"]["reads_density"]
        and found["all"]["fields"] == ["WIND"]
    )
    np.testing.assert_allclose(found["all"]["wind_to"], [np.cos(np.pi / 6), 0.5, 0], atol=1e-6)
    reynolds = 6.8 * 0.26**1.5 / 2e-4  # of the burner: the smaller it is, the less the flame is turbulent
    turbulent = reynolds / (reynolds + 500)
    np.testing.assert_allclose(found["all"]["vorticity"], vorticity.Settings().gas * 25 / 60 * turbulent, rtol=1e-6)


@pytest.mark.long
def test_views_from_all_around_are_there_for_their_frames_and_change_nothing_else(toy, tmp_path):
    """The same bake, and the same pictures of the given cameras, to the bit."""
    spec = replace(TOY, cameras=replace(TOY.cameras, around_frames=1))
    scene_spec.save(spec, tmp_path / "around.json")
    assert generate.main([str(tmp_path / "around.json"), "--out", str(tmp_path / "out")]) == 0
    dataset, alone = Dataset.open(tmp_path / "out"), Dataset.open(toy.root)
    for frame in range(TOY.clip.frames):
        assert np.array_equal(dataset.velocity.frame(frame).velocity, alone.velocity.frame(frame).velocity)
        for camera in range(TOY.cameras.count):
            assert np.array_equal(dataset.image(camera, frame), alone.image(camera, frame))
    around = dataset.around_view()
    assert len(around.cameras) == 9 and dataset.evaluation_view() is None
    for camera in range(9):
        assert around.frames(camera) == [4], "the clip's held-out frame"
        pictures = around.file(camera, "rgb", 4).parent
        assert [path.name for path in pictures.iterdir()] == ["000004.png"]
        assert around.image(camera, 4).shape == around.static(camera).shape == dataset.image(0, 4).shape
    assert any(around.mask(camera, 4).any() for camera in range(9)), "the flame is seen"
