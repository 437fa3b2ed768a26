"""One video becomes a dataset: the flame's own extent says where its camera stands."""

import cv2
import numpy as np
import pytest

from gof.capture.times import FrameTimesFile, SyncedVideo
from gof.commands import cli
from gof.commands import ingest as ingest_command
from gof.core.records import write_record
from gof.dataset import Dataset
from gof.footage.lens import Lens
from gof.ingest.accelerometer import Tilt
from gof.ingest.place import flame_ends, place_alone
from gof.ingest.pose_clues import PoseClues, PoseOptions

WIDTH, HEIGHT, FOV_DEG, FRAMES = 160, 240, 40.0, 12
TIP, FOOT, COLUMN = 60, 180, 90  # rows in which the flame ends, and the column of its middle


def pictures(flame=True):
    """A still scene, and before it a flame whose tip reaches its highest row in half of the frames."""
    still = np.random.default_rng(0).integers(20, 60, (HEIGHT, WIDTH, 3), np.uint8)
    shown = []
    for k in range(FRAMES):
        picture = still.copy()
        if flame:
            cv2.rectangle(picture, (COLUMN - 8 + k % 3, TIP + 30 * (k % 2)), (COLUMN + 7, FOOT - 1), (240, 150, 40), -1)
        shown.append(picture)
    return still, shown


def write_pictures(folder, shown):
    folder.mkdir()
    for k, picture in enumerate(shown):
        cv2.imwrite(str(folder / f"{k:03}.png"), picture[..., ::-1])


def ingest(tmp_path, *more, flame=True):
    """`gof ingest` of a folder of pictures, with the still scene as its plate."""
    still, shown = pictures(flame)
    (tmp_path / "plates").mkdir()
    cv2.imwrite(str(tmp_path / "plates" / "cam_0.png"), still[..., ::-1])
    write_pictures(tmp_path / "one", shown)
    command = ["ingest", str(tmp_path / "one"), "--times", "100", "--fov", str(FOV_DEG), *more]
    return cli.main([*command, "--plates", str(tmp_path / "plates"), "--out", str(tmp_path / "ds")])


def test_the_camera_stands_as_far_away_as_the_flame_is_high(tmp_path, capsys):
    assert ingest(tmp_path, "--flame-height-m", "0.4") == 0
    assert "depth is a guess" in capsys.readouterr().out
    dataset = Dataset.open(tmp_path / "ds")
    assert dataset.description.in_metres
    (camera,) = dataset.cameras
    focal = WIDTH / 2 / np.tan(np.deg2rad(FOV_DEG / 2))
    # The height is known to the pixel at either end that a mask may be off by.
    assert -camera.position[1] == pytest.approx(0.4 * focal / (FOOT - TIP), rel=2 / (FOOT - TIP))
    ends = np.array([[0, 0, 0], [0, 0, 0.4]])
    pixel, depth = camera.project(ends)
    assert (depth > 0).all()
    assert pixel == pytest.approx(np.array([[COLUMN, FOOT], [COLUMN, TIP]]), abs=1.5)


def test_without_a_height_the_unit_is_the_flame(tmp_path, capsys):
    assert ingest(tmp_path) == 0
    assert "give --flame-height-m" in capsys.readouterr().out
    dataset = Dataset.open(tmp_path / "ds")
    assert not dataset.description.in_metres
    tip = dataset.cameras[0].project(np.array([[0, 0, 1.0]]))[0][0]
    assert tip[1] == pytest.approx(TIP, abs=1.5)


@pytest.mark.parametrize("option", [("--baseline-m", "0.5"), ("--marker-mm", "60"), ("--poses", "features")])
def test_one_camera_has_no_use_for_options_of_several(tmp_path, capsys, option):
    assert ingest(tmp_path, *option) == 1
    assert f"{option[0]}: for two cameras or more" in capsys.readouterr().err


def test_several_cameras_have_no_use_for_the_height_of_a_flame(tmp_path, capsys):
    _, shown = pictures()
    for name in ("a", "b"):
        write_pictures(tmp_path / name, shown if name == "a" else [np.roll(p, 9, 1) for p in shown])
    videos = [str(tmp_path / "a"), str(tmp_path / "b")]
    assert cli.main(["ingest", *videos, "--times", "100", "--fov", "40", "--flame-height-m", "1"]) == 1
    assert "--flame-height-m: only for a single camera" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("cameras", "more", "said"),
    [
        (3, ["--times", "100", "50"], "--times: give one value for all videos, or one for each of the 3"),
        (3, ["--times", "100", "--start", "0", "7"], "--start: give one value"),
        (3, ["--times", "sync", "--start", "0", "7", "0"], "--start: with --times give the first camera's only"),
        (3, ["--times", "none.json"], "none.json"),
        (3, ["--times", "synced"], "synced: a folder; give synced/times.json"),
        (2, ["--times", "empty"], "empty: a folder, with no times.json in it"),
        (3, ["--times", "synced/times.json"], "has 2 cameras; it must be made of the same 3 videos"),
        (3, ["--times", "100", "--rig", "nope"], "nope"),
        (3, ["--times", "100", "--with-clip", "nope"], "nope: no 0.mp4 there"),
        (3, ["--times", "100", "--flame-height-m", "1"], "--flame-height-m: only for a single camera"),
        (1, ["--times", "100", "--baseline-m", "1"], "--baseline-m: for two cameras or more"),
    ],
)
def test_what_can_be_told_before_a_video_is_read_is(tmp_path, monkeypatch, capsys, cameras, more, said):
    monkeypatch.setattr(ingest_command, "open_footage", lambda config: pytest.fail("it may take minutes"))
    monkeypatch.chdir(tmp_path)
    for name in ("synced", "empty"):
        (tmp_path / name).mkdir()
    views = tuple(SyncedVideo(f"cam_{k}", f"{k}.mp4", error="dark") for k in range(2))
    write_record(tmp_path / "synced/times.json", FrameTimesFile("paper_rig", 4000.0, views, {}, ()))
    videos = [f"{k}.mp4" for k in range(cameras)]
    for video in videos:
        (tmp_path / video).touch()
    assert cli.main(["ingest", *videos, "--fov", "40", "--out", str(tmp_path / "ds"), *more]) == 1
    assert said in capsys.readouterr().err


def test_a_clip_without_flame_is_named(tmp_path, capsys):
    assert ingest(tmp_path, flame=False) == 1
    assert "shows no flame" in capsys.readouterr().err


def test_parts_of_a_flame_that_nearly_touch_are_one():
    still, shown = pictures()
    for picture in shown:
        picture[100:103] = still[100:103]
        picture[10:14, 10:14] = (250, 160, 40)  # a spark
    tip, foot = flame_ends(shown, still)
    assert (tip[1], foot[1]) == (TIP, FOOT)


def test_a_tilted_camera_sees_the_same_height():
    """Its accelerometer says how far it looks down; the foot is where it was, the tip is as high as was said."""
    still, shown = pictures()
    lens = Lens.from_fov(WIDTH, HEIGHT, FOV_DEG)
    tilt = np.deg2rad(20)
    options = PoseOptions(
        flame_height_m=0.4, up="accelerometer", tilts=(Tilt(np.array([0.0, -np.cos(tilt), np.sin(-tilt)])),)
    )
    clues = PoseClues("clip", [still], [np.ones((HEIGHT, WIDTH), bool)], [], [])
    placed = place_alone(shown, still, lens, clues, options)
    pose = placed.world_to_camera[0]
    assert pose[:3, :3] @ pose[:3, :3].T == pytest.approx(np.eye(3), abs=1e-12)
    for point, row in ((np.array([0, 0, 0, 1.0]), FOOT), (np.array([0, 0, 0.4, 1.0]), TIP)):
        _, y, z = lens.K @ (pose @ point)[:3]
        assert z > 0
        assert y / z == pytest.approx(row, abs=0.01)
    looks_down = np.rad2deg(np.arcsin(-pose[2, 2]))
    assert abs(looks_down) == pytest.approx(20)
