"""A result of a real capture in Blender: no scene is known, but its cameras, clock and pictures without fire are."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from gof.core.cameras import Camera
from gof.core.gaussians import TransientGaussians
from gof.dataset import CameraEntry, DatasetDescription, Splits
from tests.blender.test_import_result import run, run_import
from tests.conftest import look_at

WIDTH, HEIGHT = 120, 160
POINTS = np.array([[0.1, 0.0, 0.3], [-0.2, 0.1, 0.9]])  # where two small bright Gaussians are at time 0
VELOCITY = np.array([0.0, 0.0, 2.0])
TIMES = (0.0, 0.0025, 0.005, 0.01)  # one frame is missing

LOOK = """
import json, sys
import bpy
from gof_blender.scene.mantaflow import leave
bpy.ops.wm.open_mainfile(filepath=sys.argv[1])
scene = bpy.context.scene
cameras = [o for o in scene.objects if o.type == "CAMERA"]
behind = [c.data.background_images[0].image for c in cameras]
answer = {"frame": scene.frame_current_final, "last": scene.frame_end, "fps": scene.render.fps / scene.render.fps_base,
          "cameras": [c.name for c in cameras], "packed": [bool(i.packed_file) for i in behind],
          "camera": scene.camera.name}
open(sys.argv[2], "w").write(json.dumps(answer))
leave()
"""


@pytest.fixture(scope="module")
def cameras() -> list[Camera]:
    """Off-centre lenses with pixels that are not square, as undistorted pictures of calibrated cameras have."""
    result = []
    for c, x in enumerate((-1.0, 1.0)):
        camera = look_at(f"cam_{c}", (x, -3.0, 0.9), (0, 0, 0.6), WIDTH, HEIGHT, 170.0)
        K = np.array([[170.0, 0, 66], [0, 176, 71], [0, 0, 1]])
        result.append(Camera(camera.name, WIDTH, HEIGHT, K, camera.world_to_camera))
    return result


@pytest.fixture(scope="module")
def folder(tmp_path_factory, cameras) -> Path:
    folder = tmp_path_factory.mktemp("capture")
    (folder / "dataset" / "static").mkdir(parents=True)
    entries = []
    for c, camera in enumerate(cameras):
        plate = np.full((HEIGHT, WIDTH, 3), 40, np.uint8)
        plate[:40, :30, c] = 150  # a corner that tells up from down and left from right
        cv2.imwrite(str(folder / "dataset" / "static" / f"{camera.name}.png"), plate)
        own = tuple(t + 0.001 * c for t in TIMES)
        entries.append(CameraEntry.of(camera, role="train", static=f"static/{camera.name}.png", time_s=own))
    splits = Splits(tuple(range(len(TIMES))), ())
    DatasetDescription("capture", TIMES, tuple(entries), splits).write(folder / "dataset")
    n = len(POINTS)
    TransientGaussians(
        position=POINTS,
        velocity=np.tile(VELOCITY, (n, 1)),
        t_mu=np.zeros(n),
        t_sigma=np.full(n, 1.0),
        scale=np.full((n, 3), 0.02),
        rotation=np.tile([1.0, 0, 0, 0], (n, 1)),
        opacity=np.full(n, 0.95),
        color=np.ones((n, 3)),
        dynamic=np.ones(n, bool),
    ).save(folder / "result.npz")
    return folder


@pytest.mark.blender
def test_gaussians_are_seen_where_the_camera_has_them(folder, cameras):
    """Blender's own picture against the pinhole of dataset.json, at the moment the camera took the frame."""
    done = run_import(folder, frame=3, camera="cam_1", samples=32, mode="ellipsoids")
    assert done.returncode == 0, done.stderr
    picture = cv2.imread(str(folder / "out" / "preview.png")).astype(float)
    plate = cv2.imread(str(folder / "dataset" / "static" / "cam_1.png")).astype(float)
    assert picture.shape == plate.shape
    added = (picture - plate).mean(-1)
    expected, _ = cameras[1].project(POINTS + (TIMES[3] + 0.001) * VELOCITY)
    for x, y in expected:
        left, top = int(x) - 8, int(y) - 8
        part = np.clip(added[top : top + 16, left : left + 16], 0, None)
        rows, columns = np.mgrid[top : top + 16, left : left + 16] + 0.5
        assert part.max() > 60
        assert abs((part * columns).sum() / part.sum() - x) < 0.25 and abs((part * rows).sum() / part.sum() - y) < 0.25
        added[top : top + 16, left : left + 16] = 0
    assert np.abs(added).max() <= 2, "everything else is the plate, to rounding"


@pytest.mark.blender
def test_the_saved_scene_has_the_captures_cameras_and_clock(folder):
    if not (folder / "out" / "scene.blend").exists():
        assert run_import(folder, frame=3, camera="cam_1").returncode == 0
    looked = run("-c", LOOK, folder / "out" / "scene.blend", folder / "seen.json")
    assert looked.returncode == 0, looked.stderr
    seen = json.loads((folder / "seen.json").read_text())
    assert seen["fps"] == pytest.approx(400) and seen["last"] == 5 and seen["camera"] == "cam_1"
    assert seen["frame"] == pytest.approx(1 + 0.011 * 400)
    assert seen["cameras"] == ["cam_0", "cam_1"] and all(seen["packed"])


@pytest.mark.blender
def test_a_plate_that_is_gone_is_named(folder, tmp_path):
    copy = tmp_path / "dataset"
    copy.mkdir()
    (copy / "dataset.json").write_bytes((folder / "dataset" / "dataset.json").read_bytes())
    done = run_import(folder, dataset=copy, blend=tmp_path / "a.blend", preview=tmp_path / "a.png")
    assert done.returncode == 2 and "static/cam_0.png: no such file" in done.stderr and "Traceback" not in done.stderr
