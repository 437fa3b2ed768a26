"""The import command on a small scene: files, clock, errors. It needs no rendered dataset, only its description."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gof.commands.cli import main as gof
from gof.core.costs import StageCost
from gof.core.description import CameraEntry, DatasetDescription, held_out
from gof.core.files import digest
from gof.core.gaussians import TransientGaussians
from gof.look.report import Preview
from gof_benchmark.commands import import_result
from gof_blender.pure.spec import SceneSpec

ROOT = Path(__file__).resolve().parents[2]
FRAME = 2
LOOK = """
import json, sys
import bpy
from gof_blender.scene.mantaflow import leave
bpy.ops.wm.open_mainfile(filepath=sys.argv[1])
scene, thing = bpy.context.scene, bpy.data.objects["Flame Gaussians"]
def count():
    geometry = thing.evaluated_get(bpy.context.evaluated_depsgraph_get()).evaluated_geometry()
    return len(geometry.pointcloud.points) if geometry.pointcloud else 0
answer = {"frame": scene.frame_current, "count": count(), "objects": [o.name for o in scene.objects],
          "fps": scene.render.fps / scene.render.fps_base}
scene.frame_set(scene.frame_current + 40)
answer["later"] = count()
open(sys.argv[2], "w").write(json.dumps(answer))
leave()
"""


def run(*arguments) -> subprocess.CompletedProcess:
    return subprocess.run([sys.executable, *map(str, arguments)], cwd=ROOT, capture_output=True, text=True, timeout=120)


def run_import(folder: Path, **changes) -> subprocess.CompletedProcess:
    options = {
        "result": folder / "result.npz",
        "dataset": folder / "dataset",
        "blend": folder / "out" / "scene.blend",
        "preview": folder / "out" / "preview.png",
        "frame": FRAME,
        "mode": "points",
        "samples": 4,
    } | changes
    return run(
        "-m",
        "gof_blender.worker.import_result",
        *(part for key, value in options.items() for part in (f"--{key}", value)),
    )


@pytest.fixture(scope="module")
def spec() -> SceneSpec:
    return SceneSpec(name="import test", background="studio").with_preset("toy")


@pytest.fixture(scope="module")
def folder(tmp_path_factory, spec) -> Path:
    folder = tmp_path_factory.mktemp("import")
    (folder / "dataset").mkdir()
    times = tuple(frame / spec.clip.fps for frame in range(spec.clip.frames))
    pose = ((1, 0, 0, 0), (0, 0, -1, 1), (0, 1, 0, 3), (0, 0, 0, 1))
    camera = CameraEntry("cam_0", 64, 36, ((60, 0, 32), (0, 60, 18), (0, 0, 1)), pose)
    description = DatasetDescription(spec.name, times, (camera,), held_out(spec.clip.frames), spec=spec.to_dict())
    description.write(folder / "dataset")
    rng, n = np.random.default_rng(0), 400
    TransientGaussians(
        position=rng.uniform([-0.1, -0.1, 0.3], [0.1, 0.1, 0.9], (n, 3)),
        velocity=np.tile([0, 0, 1.0], (n, 1)),
        t_mu=rng.uniform(0, 4 / spec.clip.fps, n),
        t_sigma=np.full(n, 5 / spec.clip.fps),
        scale=np.full((n, 3), 0.03),
        rotation=np.tile([1.0, 0, 0, 0], (n, 1)),
        opacity=np.full(n, 0.3),
        color=np.tile([1.0, 0.6, 0.1], (n, 1)),
        dynamic=np.ones(n, bool),
    ).save(folder / "result.npz")
    return folder


@pytest.fixture(scope="module")
def done(folder) -> subprocess.CompletedProcess:
    return run_import(folder)


@pytest.mark.blender
def test_blend_and_preview(done, folder, spec):
    assert done.returncode == 0, done.stderr
    lines = [json.loads(line)["progress"] for line in done.stdout.splitlines() if line.startswith("{")]
    assert lines == [{"stage": "import", "done": k, "total": 3} for k in (1, 2, 3)]
    assert sorted(p.name for p in (folder / "out").iterdir()) == ["preview.png", "scene.blend", "scene.log"]

    picture = np.asarray(Image.open(folder / "out" / "preview.png").convert("RGB")).astype(float) / 255
    height, width = (int(side * spec.render.percentage / 100) for side in spec.cameras.sensor_px)
    assert picture.shape == (height, width, 3)
    # The flame stands in the middle of the picture, orange and brighter than what is beside it.
    middle = picture[int(0.35 * height) : int(0.6 * height), int(0.45 * width) : int(0.55 * width)].mean((0, 1))
    side = picture[int(0.35 * height) : int(0.6 * height), : int(0.2 * width)].mean((0, 1))
    assert middle[0] > 0.6 and middle[0] > middle[1] + 0.1 > middle[2] + 0.2, middle
    assert middle[0] > side[0] + 0.2, (middle, side)


@pytest.mark.blender
def test_saved_scene_opens_with_the_cloud_and_no_fire(done, folder, spec):
    looked = run("-c", LOOK, folder / "out" / "scene.blend", folder / "seen.json")
    assert looked.returncode == 0, looked.stderr
    seen = json.loads((folder / "seen.json").read_text())
    assert seen["frame"] == spec.timeline.first_frame + FRAME
    assert seen["fps"] == pytest.approx(spec.clip.fps)
    assert set(spec.cameras.names) < set(seen["objects"])
    assert not [name for name in seen["objects"] if name.startswith("Fire")]
    assert seen["count"] == 400 and seen["later"] == 0  # 40 frames on, all have faded


@pytest.mark.blender
def test_existing_files_are_kept(done, folder):
    before = (folder / "out" / "scene.blend").stat().st_mtime_ns
    again = run_import(folder)
    assert again.returncode == 2 and "exists already" in again.stderr
    assert (folder / "out" / "scene.blend").stat().st_mtime_ns == before


@pytest.mark.blender
@pytest.mark.parametrize(
    "changes, message",
    [
        ({"result": "nothing.npz"}, "nothing.npz: no such file"),
        ({"dataset": "tests"}, "tests: no dataset.json"),
        ({"frame": 6}, "has frames 0 to 5"),
        ({"camera": "cam_9"}, "has cam_0, cam_1, cam_2"),
    ],
)
def test_errors(folder, changes, message):
    result = run_import(folder, blend=folder / "new" / "scene.blend", preview=folder / "new" / "preview.png", **changes)
    assert result.returncode == 2 and message in result.stderr
    assert "Traceback" not in result.stderr
    assert not (folder / "new").exists()


@pytest.mark.blender
@pytest.mark.parametrize(
    "changes, message",
    [
        ({"schema": "gof-capture"}, "not schema 'gof-dataset' version 1"),
        ({"spec": None, "cameras": []}, "no camera with role 'train'"),
        ({"spec": {"schema": "gof-scene"}}, "spec"),
    ],
)
def test_foreign_dataset(folder, tmp_path, changes, message):
    description = json.loads((folder / "dataset" / "dataset.json").read_text()) | changes
    (tmp_path / "dataset.json").write_text(json.dumps(description))
    result = run_import(folder, dataset=tmp_path, blend=tmp_path / "scene.blend", preview=tmp_path / "preview.png")
    assert result.returncode == 2 and message in result.stderr


def test_files_of_ones_own_beside_the_blend_are_kept(folder, tmp_path, monkeypatch, capsys):
    """`--out ring.blend` beside a spec ring.json and a picture ring.png; a preview.json of another kind, too."""
    asked = ["import", str(folder / "result.npz"), "--dataset", str(folder / "dataset"), "--out"]
    monkeypatch.setattr(import_result, "run_worker", lambda *_: pytest.fail("nothing is to be made"))
    (tmp_path / "ring.png").write_bytes(b"mine")
    assert gof([*asked, str(tmp_path / "ring.blend")]) == 1
    assert "ring.png: is there already" in capsys.readouterr().err
    (tmp_path / "preview.json").write_text('{"schema": "gof-scene", "version": 3, "name": "ring"}')
    assert gof([*asked, str(tmp_path / "new.blend")]) == 1
    assert "preview.json" in capsys.readouterr().err

    def make(command: list, _) -> StageCost:
        for option in ("--blend", "--preview"):
            Path(command[command.index(option) + 1]).write_bytes(b"made")
        return StageCost("import", 1.0, 1.0)

    monkeypatch.setattr(import_result, "run_worker", make)
    (tmp_path / "preview.json").unlink()
    (tmp_path / "new.json").write_text("mine")
    assert gof([*asked, str(tmp_path / "new.blend")]) == 0
    assert (tmp_path / "new.json").read_text() == "mine"
    assert Preview.read(tmp_path / "preview.json").result == digest(folder / "result.npz")
