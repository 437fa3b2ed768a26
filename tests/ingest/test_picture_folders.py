"""Folders of pictures as cameras, programs and file systems leave them, through `gof ingest`."""

import json

import cv2
import numpy as np
import pytest

from gof.commands import cli
from gof.footage.videos import stored_frames
from tests.videos import write_video

WIDTH, HEIGHT, STEP = 128, 96, 5
APPLE = bytes.fromhex("00051607000200004d6163204f5320582020202020202020") + bytes(60)


def picture(camera: int, moment: int) -> np.ndarray:
    """A still scene, and a spot 5 pixels further right at every moment."""
    scene = np.random.default_rng(0).integers(20, 90, (HEIGHT, WIDTH, 3), np.uint8)
    shown = np.roll(scene, STEP * camera, 1).copy()
    cv2.circle(shown, (20 + STEP * moment, 50), 6, (60, 170, 255), -1)
    return shown


def rig(root, names, moments, suffix=".png"):
    """Folders c0 and c1 with these pictures' names, and cameras.json. Returns the arguments of `gof ingest`."""
    for c in range(2):
        (root / f"c{c}").mkdir(parents=True)
        for name, moment in zip(names, moments, strict=True):
            assert cv2.imwrite(str(root / f"c{c}" / f"{name}{suffix}"), picture(c, moment))
    return arguments(root)


def arguments(root):
    """Two cameras a metre apart that look along Y."""
    cameras = []
    for x in (-0.5, 0.5):
        pose = np.eye(4)
        pose[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
        pose[:3, 3] = -pose[:3, :3] @ [x, -3, 0]
        K = [[150, 0, 64], [0, 150, 48], [0, 0, 1]]
        cameras.append({"width": WIDTH, "height": HEIGHT, "K": K, "world_to_camera": pose.tolist()})
    (root / "cameras.json").write_text(json.dumps({"cameras": cameras}))
    folders = [str(root / "c0"), str(root / "c1")]
    return ["ingest", *folders, "--out", str(root / "ds"), "--times", "100", "--cameras", str(root / "cameras.json"),
            "--board", "none"]  # fmt: skip


def moments(root):
    """(time in steps, moment by the spot's place) of the dataset's frames of camera 0."""
    said = json.loads((root / "ds/dataset.json").read_text())
    found = []
    for k, time_s in enumerate(said["cameras"][0]["time_s"]):
        shown = cv2.imread(str(root / f"ds/cameras/cam_0/rgb/{k:06d}.png")).astype(int)
        at = np.argwhere((shown[..., 2] > 200) & (shown[..., 0] < 110))[:, 1].mean()
        found.append((round(100 * time_s), round((at - 20) / STEP)))
    return found


def words(capsys) -> str:
    said = capsys.readouterr()
    return " ".join((said.out + said.err).split())


@pytest.mark.parametrize(
    "names",
    [
        [str(k) for k in range(1, 13)],
        [f"f_{k:04d}" for k in range(9994, 10006)],
        [f"v2_{k}_128x96" for k in range(1, 13)],
    ],
    ids=["not padded", "beyond four digits", "a size behind"],
)
def test_frames_are_in_the_order_of_their_numbers(tmp_path, names):
    assert cli.main(rig(tmp_path, names, range(12))) == 0
    assert moments(tmp_path) == [(k, k) for k in range(12)]


def test_what_systems_leave_beside_pictures_is_not_read(tmp_path):
    given = rig(tmp_path, [f"{k:04d}" for k in range(8)], range(8), ".jpg")
    for c in range(2):
        for k in range(8):
            (tmp_path / f"c{c}/._{k:04d}.jpg").write_bytes(APPLE)
            (tmp_path / f"c{c}/{k:04d}.xmp").write_text("sidecar")
            (tmp_path / f"c{c}/{k:04d}.DNG").write_bytes(b"the same frame, raw")
        (tmp_path / f"c{c}/.DS_Store").write_bytes(b"\0\0\0\1Bud1")
        (tmp_path / f"c{c}/Thumbs.db").write_bytes(b"db")
        (tmp_path / f"c{c}/0009.png").mkdir()
    assert cli.main(given) == 0
    assert moments(tmp_path) == [(k, k) for k in range(8)]


def test_a_lost_picture_is_a_gap_in_time_and_it_is_said(tmp_path, capsys):
    kept = [k for k in range(12) if k != 5]
    assert cli.main(rig(tmp_path, [f"{1000 + k}" for k in kept], kept)) == 0
    assert "c0: 1 pictures are missing (1005)" in words(capsys)
    assert moments(tmp_path) == [(k, k) for k in kept]


@pytest.mark.parametrize("shown", [[k - (k == 7) for k in range(14)], [k + (k == 6) for k in range(14)]])
def test_pictures_that_are_shown_twice_are_left_out(tmp_path, capsys, shown):
    """A gap filled by the picture before it, and by the one after it: in either case one of the two is not of its
    time."""
    assert cli.main(rig(tmp_path, [f"{k:04d}" for k in range(14)], shown)) == 0
    assert "c0: 2 frames are shown twice, first after frame 5; left out for all" in words(capsys)
    assert moments(tmp_path) == [(k, k) for k in range(14) if k not in (6, 7)]


def test_a_folder_of_repeats_is_refused(tmp_path, capsys):
    assert cli.main(rig(tmp_path, [f"{k:04d}" for k in range(16)], [k // 2 for k in range(16)])) != 0
    assert "c0: 8 of its 16 frames show the one before them again (first frame 1)" in words(capsys)
    assert not (tmp_path / "ds/dataset.json").exists()


def test_every_second_picture_is_an_even_clock(tmp_path, capsys):
    assert cli.main(rig(tmp_path, [str(2 * k) for k in range(8)], range(8))) == 0
    assert "c0: the pictures' numbers go in steps of 2" in words(capsys)
    assert moments(tmp_path) == [(k, k) for k in range(8)]


def add(name, like=None):
    """A change of a rig: one more file in the second folder, a copy of another one's content."""

    def change(root):
        content = (root / "c1" / like).read_bytes() if like else b"not looked into"
        (root / "c1" / name).write_bytes(content)

    return change


def rename(old, new):
    return lambda root: (root / "c1" / old).rename(root / "c1" / new)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (add("0003.jpg", "0003.png"), "0003.png: has the number 3, and so has 0003.jpg"),
        (add("3.png", "0003.png"), "has the number 3, and so has 0003.png"),
        (add("v2_0003.png", "0003.png"), "v2_0003.png: has the number 3, and so has 0003.png"),
        (add("still.png", "0003.png"), "still.png: its name has no frame number"),
        (add("other_0008.png", "0003.png"), "other_0008.png"),
        (rename("0004.png", "0004.HEIC"), "0004.HEIC: 1 of the folder's pictures are in formats that are not read"),
        (add("IMG_0100.dng"), "IMG_0100.dng: 1 of the folder's pictures are in formats"),
        (rename("0007.png", "0007.png.part"), "0007.png.part: by its name a frame"),
        (rename("0007.png", "0000.5.png"), "0000.5.png"),
        (rename("0007.png", "5000.png"), "4993 are missing (7 to 4999)"),
        (rename("0000.png", "0008.png"), "begin apart"),
    ],
)
def test_what_is_no_one_sequence_is_refused_by_name(tmp_path, capsys, change, said):
    given = rig(tmp_path, [f"{k:04d}" for k in range(8)], range(8))
    change(tmp_path)
    assert cli.main(given) == 1
    assert said in words(capsys)
    assert not (tmp_path / "ds/dataset.json").exists()


def test_beginnings_that_somebody_names_are_taken(tmp_path):
    given = rig(tmp_path, [f"{k:04d}" for k in range(8)], range(8))
    (tmp_path / "c1/0000.png").rename(tmp_path / "c1/0008.png")
    cv2.imwrite(str(tmp_path / "c1/0008.png"), picture(1, 8))
    assert cli.main([*given, "--start", "1", "0", "--frames", "7"]) == 0
    assert moments(tmp_path) == [(k - 1, k) for k in range(1, 8)]


def test_pictures_that_need_no_order_are_read_in_any(tmp_path):
    """Those of a calibration target are of different days, and some were thrown away."""
    for name in ("IMG_2001.png", "board.png", "left3.png"):
        cv2.imwrite(str(tmp_path / name), picture(0, 1))
    assert len(list(stored_frames(tmp_path, in_time=False))) == 3


def test_plates_are_a_picture_or_a_film_of_each_camera(tmp_path, capsys):
    """The film's frame is the scene, to what Motion JPEG loses; a folder of other names is said before any reading."""
    given = [*rig(tmp_path, [f"{k:04d}" for k in range(8)], range(8)), "--plates", str(tmp_path / "still")]
    (tmp_path / "still").mkdir()
    write_video(tmp_path / "still/GX010003.avi", [picture(0, 30)[..., ::-1]] * 3)
    assert cli.main(given) == 1
    said = words(capsys)
    assert (
        "no picture cam_0.png there, but GX010003.avi; --plates wants of each camera" in said and "read c0" not in said
    )
    (tmp_path / "still/GX010003.avi").rename(tmp_path / "still/cam_0.avi")
    cv2.imwrite(str(tmp_path / "still/cam_1.png"), picture(1, 30))
    assert cli.main(given) == 0
    for c, near in ((0, 5), (1, 0)):
        plate, wanted = (
            cv2.cvtColor(p, cv2.COLOR_BGR2GRAY).astype(int)
            for p in (cv2.imread(str(tmp_path / f"ds/static/cam_{c}.png")), picture(c, 30))
        )
        assert np.abs(plate - wanted).mean() <= near
