"""Undistorting and turning against pictures whose content says where each pixel came from; cameras.json."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from gof.core.errors import DataFormatError
from gof.core.files import write_json
from gof.core.records import write_record
from gof.footage.lens import CalibratedCamera, CamerasFile, Lens, prepare, read_cameras

LENS = Lens(
    320, 180, np.array([[280.0, 0, 163], [0, 280.5, 88], [0, 0, 1]]), np.array([-0.25, 0.06, 0.0005, -0.0005, 0.0])
)
TURNS = [
    ("none", None),
    ("clockwise", cv2.ROTATE_90_CLOCKWISE),
    ("counterclockwise", cv2.ROTATE_90_COUNTERCLOCKWISE),
]


@pytest.mark.parametrize("turn, code", TURNS)
def test_without_distortion_pictures_are_only_turned(turn, code):
    plain = Lens(320, 180, LENS.K)
    picture = np.random.default_rng(0).integers(0, 255, (180, 320), dtype=np.uint8)
    np.testing.assert_array_equal(prepare(picture, plain, turn), picture if code is None else cv2.rotate(picture, code))


@pytest.mark.parametrize("turn, code", TURNS)
def test_a_prepared_picture_shows_what_the_turned_pinhole_sees(turn, code):
    """A spot that the distorted lens makes of a ray lies where the turned pinhole projects the turned ray."""
    ray = np.array([0.32, -0.21, 1.0])
    corner = LENS.K - [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]  # OpenCV puts pixel centres at integers
    x, y = cv2.projectPoints(ray[None], np.zeros(3), np.zeros(3), corner, LENS.distortion)[0][0, 0]
    rows, columns = np.mgrid[:180, :320]
    spot = np.exp(-0.5 * ((columns - x) ** 2 + (rows - y) ** 2) / 4).astype(np.float32)
    picture, pinhole = prepare(spot, LENS, turn), LENS.turned(turn)
    assert picture.shape == (pinhole.height, pinhole.width) and not pinhole.distortion.any()
    turned = {"none": (ray[0], ray[1]), "clockwise": (-ray[1], ray[0]), "counterclockwise": (ray[1], -ray[0])}[turn]
    expected = (pinhole.K @ [*turned, 1])[:2]
    rows, columns = np.mgrid[: picture.shape[0], : picture.shape[1]] + 0.5
    found = [(picture * columns).sum() / picture.sum(), (picture * rows).sum() / picture.sum()]
    np.testing.assert_allclose(found, expected, atol=0.05)


VIDEOS = [Path(f"cam_{k}.mp4") for k in range(3)]


def test_cameras_file(tmp_path):
    path = tmp_path / "c.json"
    camera = CalibratedCamera(320, 180, tuple(map(tuple, LENS.K.tolist())), tuple(LENS.distortion.tolist()), "wide")
    write_record(path, CamerasFile((camera,)))
    cameras = read_cameras(path, VIDEOS)
    assert cameras == [camera] * 3, "one camera stands for all"
    np.testing.assert_array_equal(cameras[2].lens.K, LENS.K)
    np.testing.assert_array_equal(cameras[2].lens.distortion, LENS.distortion)
    write_record(path, CamerasFile((camera, camera)))
    with pytest.raises(DataFormatError, match=r"c\.json: 'cameras' must list one entry, or one per video \(3\)"):
        read_cameras(path, VIDEOS)
    with pytest.raises(DataFormatError, match=r"none\.json: no such file"):
        read_cameras(tmp_path / "none.json", VIDEOS)


BY_HAND = {"width": 320, "height": 180, "K": [[280, 0, 163], [0, 280.5, 88], [0, 0, 1]]}


def test_a_cameras_file_by_hand_needs_no_schema(tmp_path):
    write_json(tmp_path / "c.json", {"cameras": [BY_HAND]})
    (camera,) = read_cameras(tmp_path / "c.json", VIDEOS[:1])
    np.testing.assert_array_equal(camera.lens.K, LENS.K)
    assert camera.lens.distortion.shape == (0,) and camera.world_to_camera is None


@pytest.mark.parametrize(
    "called, right",
    [
        (("left", "right"), True),  # the videos'
        (("right", "left"), False),
        (("c0", "c1"), True),  # of the films of a target: nothing to compare
        (("c0", "left"), False),
        (("left", None), True),
        ((None, None), True),
    ],
)
def test_cameras_that_are_named_as_the_videos_have_their_order(tmp_path, called, right):
    """Else each video would get another's lens and pose, silently."""
    videos = [tmp_path / "left.mp4", tmp_path / "right"]
    videos[0].touch()
    videos[1].mkdir()  # of pictures
    entries = [BY_HAND | ({} if name is None else {"name": name}) for name in called]
    write_json(tmp_path / "c.json", {"cameras": entries})
    if right:
        assert len(read_cameras(tmp_path / "c.json", videos)) == 2
    else:
        with pytest.raises(DataFormatError, match=r"c\.json: names the cameras .*left\.mp4 is video 1: give"):
            read_cameras(tmp_path / "c.json", videos)


@pytest.mark.parametrize(
    "data, message",
    [
        ({"schema": "gof-times"}, "not schema 'gof-cameras' version 1"),
        ({"version": 2}, "not schema 'gof-cameras' version 1"),
        ({"cameras": [{"width": 320, "height": 180}]}, "K is missing"),
        ({"cameras": [BY_HAND, BY_HAND | {"width": "wide"}]}, r"cameras\[1\]\.width"),
        ({"cameras": [BY_HAND | {"name": "a", "K": [[1, 0], [0, 1]]}]}, "'a': K must be 3x3"),
        ({"cameras": [BY_HAND | {"K": [[0, 0, 1], [0, 1, 1], [0, 0, 1]]}]}, "positive focal lengths"),
        ({"cameras": [BY_HAND | {"distortion": [0.1, 0.2]}]}, "distortion must be none, or"),
        ({}, "cameras is missing"),
        ([], "not schema"),
    ],
)
def test_malformed_cameras_files_name_the_field(tmp_path, data, message):
    write_json(tmp_path / "c.json", data)
    with pytest.raises(DataFormatError, match=rf"c\.json.*{message}"):
        read_cameras(tmp_path / "c.json", VIDEOS[:1])
