"""The sync board in generated pictures: drawn as the firmware lights it, and read again by `gof capture sync`."""

import ctypes
import json
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from gof.capture.decode import DecodeOptions
from gof.capture.sync import synchronise
from gof.capture.template import BoardTemplate
from gof.dataset import Dataset
from gof.evaluate.image import psnr
from gof_benchmark.commands import generate
from gof_blender.pure import effects, led_board
from gof_blender.pure import spec as scene_spec
from gof_blender.pure.effects import clock, rolling_shutter, sensor_noise, sync_board
from gof_blender.pure.layout import Layout
from gof_blender.pure.spec import SceneSpec
from tests.blender.runs import TOY, channels
from tests.conftest import look_at

FIRMWARE = Path(__file__).parents[2] / "firmware/core"
START_S = 2.5
CAMERA = (sensor_noise.Settings(), rolling_shutter.Settings(0.004, steps=1), clock.Settings(0.002, steps=1))
SPEC = replace(
    TOY,
    clip=replace(TOY.clip, frames=14, warm_up_frames=4),
    domain=replace(TOY.domain, resolution=16),
    cameras=replace(TOY.cameras, count=2),
    render=replace(TOY.render, percentage=50, plate_samples=1, max_bounces=0),
)


def test_layout_is_that_of_the_template():
    template = BoardTemplate.load("gof_board")
    np.testing.assert_allclose(led_board.LED_XY, template.led_xy)
    assert template.led_bit.tolist() == [*range(15), -1] and template.strip_slot.tolist() == [*range(5)]
    np.testing.assert_allclose([[(x, y) for x in led_board.STRIP_X] for y in led_board.STRIP_Y], template.strip_ends)
    corners = {(x, y) for x0, y0, x1, y1 in led_board.BOXES for x in (x0, x1) for y in (y0, y1)}
    assert {tuple(corner) for corner in template.outline} == corners
    drawn = cv2.aruco.generateImageMarker(
        cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50), template.marker_id, 6
    )
    np.testing.assert_array_equal(led_board.MARKER, (drawn > 0) != template.inverted)


@pytest.mark.skipif(not shutil.which("cc"), reason="needs a C compiler")
def test_lights_are_the_firmwares(tmp_path):
    library = tmp_path / "board.so"
    subprocess.run(["cc", "-shared", "-fPIC", "-o", library, FIRMWARE / "gof_board.c"], check=True)
    pattern = ctypes.CDLL(str(library)).gof_pattern
    ticks = np.r_[-25:60, 32760 * 10 : 32768 * 10 + 40, np.random.default_rng(0).integers(0, 2**20, 500)]
    outputs = [pattern(tick // 10 % 2**15, tick % 10) for tick in ticks.tolist()]
    np.testing.assert_array_equal(led_board.lit(ticks), np.array(outputs)[:, None] >> np.arange(21) & 1)


@pytest.mark.parametrize("length", [1e-4, 0.9e-3, 7.3e-3])
def test_share_of_an_exposure_is_the_mean_of_its_instants(length):
    start = np.array([-0.0113, 0.0, 0.10007, 0.1234])
    instants = start[:, None] + (np.arange(20000) + 0.5) / 20000 * length
    mean = led_board.lit(np.floor(instants.ravel() / 4.1e-4).astype(int)).reshape(4, 20000, 21).mean(1)
    np.testing.assert_allclose(led_board.lit_share(start, length, 4.1e-4), mean.T, atol=2e-3)


def seen_by(camera, settings) -> led_board.Footprint:
    pose = camera.world_to_camera
    to_camera = pose[:3, :3] @ settings.plane() + np.outer(pose[:3, 3], (0, 0, 1))
    return led_board.footprint(camera.K @ to_camera, camera.width, camera.height)


def test_board_stands_where_it_was_put():
    settings = sync_board.Settings((0.2, -0.1, 0.4), facing_deg=-60, marker_m=0.1)
    camera = look_at("front", (1.2, -2.0, 0.9), (0, 0, 0.5), width=360, height=240, focal_px=300)
    mask = seen_by(camera, settings).mask
    right = np.array([np.cos(np.pi / 6), np.sin(np.pi / 6), 0])  # of someone who looks at the board
    centre = np.array(settings.position)
    marker, left_end = centre + [0, 0, 0.09], centre - 0.33 * right - [0, 0, 0.12]
    for place, outside in ((marker, [0, 0, 0.3]), (left_end, -0.1 * right)):
        (on, beside), _ = camera.project(np.array([place, place + outside]))
        assert mask[int(on[1]), int(on[0])] == 1 and mask[int(beside[1]), int(beside[0])] == 0
    light = np.full((240, 360, 3), 0.2)
    shine = np.zeros((24, 240))
    shine[led_board.PAPER], shine[led_board.LAMPS] = 1.0, 2.0
    picture = seen_by(camera, settings).over(light, shine, np.mgrid[:240, :360][0])
    (strip,), _ = camera.project(np.array([centre - [0, 0, 0.06] + 0.1 * right]))  # strip 0: y = 2
    assert picture[int(strip[1]) - 1 : int(strip[1]) + 2, int(strip[0])].max() > 0.9
    np.testing.assert_array_equal(picture[mask == 0], light[mask == 0])
    behind = look_at("behind", (-1.2, 2.0, 0.9), (0, 0, 0.5), width=360, height=240, focal_px=300)
    assert not seen_by(behind, settings).mask.any(), "its back is not drawn"


def test_settings_are_checked_and_travel():
    spec = replace(TOY, effects=(sync_board.Settings(tick_us=410),))
    assert SceneSpec.from_dict(spec.to_dict()) == spec and spec.timeline.steps_per_frame == 1
    with pytest.raises(scene_spec.SpecError, match=r"effects\.sync_board\.tick_us must be between 50 and 100000"):
        sync_board.Settings(tick_us=20)


def test_not_listed_changes_nothing():
    light = np.full((4, 5, 3), 0.3)
    assert effects.expose(light, TOY.effects, TOY.timeline.picture(0, 0)) is light
    assert not any(map(effects.shows_board, TOY.effects))
    pytest.importorskip("bpy", reason="what is drawn over pictures needs the scene")
    from gof_blender.scene.effects import overlay

    assert overlay(light, TOY, 0, 0) is light


def run(spec, folder: Path) -> Layout:
    scene_spec.save(spec, folder / f"{spec.name}.json")
    generate.main([str(folder / f"{spec.name}.json"), "--out", str(folder / spec.name)])
    return Layout(folder / spec.name)


@pytest.fixture(scope="module")
def pair(tmp_path_factory) -> tuple[Layout, Layout]:
    """The same fire filmed with the board and, one frame of it, without."""
    pytest.importorskip("bpy", reason="the generator needs the bpy wheel")
    folder = tmp_path_factory.mktemp("board")
    board = sync_board.Settings((0.0, 0.0, 0.25), marker_m=0.12, start_s=START_S)
    return (
        run(replace(SPEC, name="board", effects=(*CAMERA, board)), folder),
        run(replace(SPEC, name="plain", effects=CAMERA, clip=replace(SPEC.clip, frames=1)), folder),
    )


@pytest.mark.slow  # a minute of rendering
@pytest.mark.blender
def test_times_read_from_the_pictures_are_the_true_ones(pair):
    layout, _ = pair
    meta = json.loads(layout.description.read_text())
    videos = [layout.frame(camera["name"], 0).rgb.parent for camera in meta["cameras"]]
    for folder, camera in zip(videos, meta["cameras"], strict=True):
        (synced,) = synchronise([folder], BoardTemplate.load("gof_board"), [DecodeOptions()]).cameras
        read = synced.times
        assert read is not None, synced.error
        # As portrait pictures are stored, the sensor's rows are columns; the picture's centre lies between two of them.
        centre = camera["row_time_s"] * (camera["width"] - 1) / 2
        error = [frame.time_s for frame in read.frames] - np.array(camera["time_s"]) - centre - START_S
        print(camera["name"], f"rms {1e6 * np.sqrt(np.mean(error**2)):.2f} us, row time {read.row_time_us:.4f} us")
        assert 1e6 * np.sqrt(np.mean(error**2)) < 5
        assert read.readout == camera["readout"] == "left" and not read.faults
        assert read.row_time_us == pytest.approx(1e6 * camera["row_time_s"], abs=0.05)
    offsets = [camera["time_s"][0] for camera in meta["cameras"]]
    assert abs(np.diff(offsets)) > 1e-4, "the clocks differ"


@pytest.mark.slow  # a minute of rendering
@pytest.mark.blender
def test_mask_covers_the_board_and_scores_skip_it(pair):
    layout, plain = pair
    dataset, without = Dataset.open(layout.root), Dataset.open(plain.root)
    for camera in range(2):
        weight = dataset.board_weight(camera)
        assert 0.02 < (weight == 0).mean() < 0.25 and ((weight > 0) & (weight < 1)).any()
        blink = (
            np.ptp([dataset.image(camera, k).min(-1) for k in range(6)], axis=0) > 0.5
        )  # white, which flames are not
        assert blink.sum() > 200 and not weight[blink].any()
        plate, same = dataset.static(camera), without.static(camera)
        np.testing.assert_array_equal(plate[weight == 1], same[weight == 1])
        assert (plate != same).any() and plate[blink].max() < 0.6, "the board is on the plate, its lamps are off"
        # Two bakes and renders of the same fire agree to rounding.
        picture, same = dataset.image(camera, 0), without.image(camera, 0)
        np.testing.assert_allclose(picture[weight == 1], same[weight == 1], atol=2 / 255)
        assert psnr(picture, same) < 30 and psnr(picture, same, weight) > 60, "to scores they are the same picture"
        light, same = (channels(folder.frame(dataset.cameras[camera].name, 0).exr) for folder in pair)
        assert max(np.abs(light[name] - same[name]).max() for name in "RGB") < 0.01, "EXR files do not have the board"
    assert without.board_weight(0) is None and not list(plain.root.rglob("board_mask*"))
