"""Footage that is mixed up: given twice, in another order than it was timed in, or two clips of one camera."""

import os
import shlex
import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest

from gof.capture.annotate import annotate
from gof.capture.decode import DecodeOptions
from gof.capture.sync import synchronise
from gof.capture.template import BoardTemplate
from gof.commands import capture_sync, cli
from gof.commands.ingest import IngestConfig, ingest
from gof.core.errors import DataFormatError, GofError
from gof.core.records import read_record, write_record
from gof.dataset import Dataset
from gof.footage.videos import fingerprint, require_different, stated_info
from gof.ingest.frame_times import Timing, read_frame_times
from gof.ingest.place import _together
from tests.ingest.test_frame_times import FrameTimesFile, clock, times_file
from tests.videos import numbered, write_video


def folders(root, count=3, frames=20):
    """Footage of `count` cameras, as folders of small pictures."""
    r = np.random.default_rng(0)
    paths = [root / f"cam_{c}" for c in range(count)]
    for path in paths:
        path.mkdir(parents=True)
        for k in range(frames):
            cv2.imwrite(str(path / f"{k:02d}.png"), r.integers(0, 255, (6, 8, 3), np.uint8))
    return paths


# ---- given twice -----------------------------------------------------------------------------------------------------


def test_footage_is_known_by_its_contents_not_by_its_name(tmp_path):
    a, b = tmp_path / "a.bin", tmp_path / "b.bin"
    contents = bytearray(np.random.default_rng(1).bytes(3 << 20))
    a.write_bytes(contents)
    shutil.copy(a, b)
    assert fingerprint(a) == fingerprint(b)
    for place in (0, len(contents) - 1):
        changed = bytearray(contents)
        changed[place] ^= 1
        b.write_bytes(changed)
        assert fingerprint(a) != fingerprint(b)
    b.write_bytes(contents + b"\0")
    assert fingerprint(a) != fingerprint(b)
    first, second = folders(tmp_path / "rig", 2)
    assert fingerprint(first) != fingerprint(second)
    shutil.copytree(first, tmp_path / "copy")
    assert fingerprint(first) == fingerprint(tmp_path / "copy")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes here")
def test_a_pipe_or_a_lost_picture_is_named_and_never_waited_for(tmp_path):
    one, two = folders(tmp_path, 2)
    (two / "07.png").unlink()
    (two / "07.png").symlink_to(tmp_path / "lost.png")
    with pytest.raises(DataFormatError, match=r"07.png: no such picture"):
        require_different([one, two])
    os.mkfifo(tmp_path / "pipe.mp4")
    with pytest.raises(DataFormatError, match=r"pipe.mp4: no such video"):
        require_different([one, tmp_path / "pipe.mp4"])


def test_the_same_footage_twice_is_refused_before_anything_is_read(tmp_path):
    one, two, three = folders(tmp_path)
    shutil.copytree(one, tmp_path / "again")
    require_different([one, two, three])
    for videos, said in (
        ([one, two, one], "cam_0: is given twice"),
        ([one, two, tmp_path / "again"], "again: is the same footage as .*cam_0"),
    ):
        config = IngestConfig(videos, tmp_path / "set", fov=40.0, times=("100",), board="none")
        with pytest.raises(DataFormatError, match=said):
            ingest(config)
        with pytest.raises(DataFormatError, match=said):
            synchronise(videos, BoardTemplate.load("paper_rig"), [DecodeOptions()] * 3)
    assert not (tmp_path / "set").exists()


def test_empty_files_are_not_called_the_same_footage(tmp_path):
    for name in ("a.mp4", "b.mp4"):
        (tmp_path / name).touch()
    with pytest.raises(DataFormatError, match=r"a\.mp4: holds nothing"):
        require_different([tmp_path / "a.mp4", tmp_path / "b.mp4"])


def test_sync_refuses_a_video_that_is_not_there_and_writes_nothing(tmp_path):
    videos = [str(path) for path in folders(tmp_path, 2)]
    with pytest.raises(DataFormatError, match="lost.mp4: no such video"):
        capture_sync.main([*videos, str(tmp_path / "lost.mp4"), "--out", str(tmp_path / "sync")])
    assert not (tmp_path / "sync").exists()


def test_what_needs_no_footage_is_said_before_it_is_read(tmp_path):
    config = IngestConfig([tmp_path / "none.mp4"] * 2, tmp_path / "set", fov=40.0)
    with pytest.raises(GofError, match="--times times.json .* --times RATE"):
        ingest(config)
    (tmp_path / "set").mkdir()
    (tmp_path / "set" / "dataset.json").write_text("{}")
    with pytest.raises(GofError, match="already holds a dataset"):
        ingest(replace(config, times=("100",)))


def test_all_that_no_file_says_is_asked_for_at_once_with_a_whole_command(tmp_path, capsys):
    """The command that it prints gets past both questions, as it stands."""
    videos = [str(write_video(tmp_path / f"my {c}.mp4", list(numbered(8))[c:], 25.0)) for c in range(2)]
    given = ["ingest", *videos, "--out", str(tmp_path / "set"), "--board", "none"]
    said = []
    for more in ([], ["--times", "stamps"], ["--fov", "50"]):
        assert cli.main([*given, *more]) == 1
        said.append(" ".join(capsys.readouterr().err.split()))
    assert "when the frames were taken" in said[0] and "through which lenses" in said[0]
    assert "when the frames" not in said[1] and "through which lenses" not in said[2]
    for text, wanted in zip(
        said,
        (["--times", "25", "--fov", "70"], ["--times", "stamps", "--fov", "70"], ["--times", "25"]),
        strict=True,
    ):
        command = shlex.split(text.split("With your own numbers: ")[1].split(" more: docs/")[0])
        assert command[:2] == ["gof", "ingest"] and command[-len(wanted) :] == wanted
        assert cli.main([*command[1:], "--frames", "6"]) == 1  # grey pictures: no camera can be placed
        asked = " ".join(capsys.readouterr().err.split())
        assert "no file says" not in asked and "points by hand with --points" in asked


# ---- times of other footage ------------------------------------------------------------------------------------------


def timed(tmp_path, videos, marked=True):
    """A times.json of these videos, each 0.1 s later than the one before; with or without their fingerprints."""
    path = tmp_path / "times.json"
    times_file(path, [clock(100.0 * c) for c in range(len(videos))])
    record = read_record(FrameTimesFile, path)
    cameras = []
    for entry, video in zip(record.cameras, videos, strict=True):
        info = stated_info(video)
        known = {"name": video.name, "video": str(video), "fingerprint": info.fingerprint if marked else None}
        known["times"] = replace(entry.times, width=info.width, height=info.height)
        cameras.append(replace(entry, **known))
    write_record(path, replace(record, cameras=tuple(cameras)))
    return path


def offsets_us(path, videos):
    """How much later each video's first frame was taken than the earliest of them, and the notes."""
    times = read_frame_times(Timing(path), [stated_info(video) for video in videos])
    begins = np.array([begin[0] for begin in times.time_s])
    return np.rint(1e6 * (begins - begins.min())).tolist(), times.notes


def test_every_video_gets_its_own_times_in_whatever_order_it_is_given(tmp_path):
    one, two, three = videos = folders(tmp_path)
    path = timed(tmp_path, videos)
    assert offsets_us(path, videos) == ([0, 100, 200], ())
    assert offsets_us(path, [three, one, two]) == ([200, 0, 100], ())
    moved = [shutil.move(video, tmp_path / name) for video, name in zip(videos, ("left", "mid", "right"), strict=True)]
    assert offsets_us(path, [moved[1], moved[0], moved[2]]) == ([100, 0, 200], ())


def test_copies_in_another_format_take_the_times_of_their_place_and_it_is_said(tmp_path):
    one, two, three = videos = folders(tmp_path)
    path = timed(tmp_path, videos)
    cv2.imwrite(str(two / "00.png"), np.zeros((6, 8, 3), np.uint8))
    offsets, notes = offsets_us(path, [three, two, one])
    assert offsets == [200, 100, 0]
    assert len(notes) == 1 and "cam_1: not the file that times.json was made of (cam_1)" in notes[0]
    assert str(tmp_path) not in notes[0], "notes go into dataset.json, which is given away"


@pytest.mark.parametrize("marked", [True, False])
def test_names_in_another_order_are_refused_where_contents_say_nothing(tmp_path, marked):
    one, two, three = videos = folders(tmp_path)
    path = timed(tmp_path, videos, marked)
    for k, video in enumerate(videos):
        cv2.imwrite(str(video / "00.png"), np.full((6, 8, 3), k, np.uint8))
    assert offsets_us(path, videos)[0] == [0, 100, 200]
    with pytest.raises(GofError, match="was made of cam_0, cam_1, cam_2, in this order"):
        offsets_us(path, [two, one, three])


def test_annotate_refuses_footage_in_another_order(tmp_path):
    one, two = videos = folders(tmp_path, 2)
    path = tmp_path / "cameras.json"
    pose = np.eye(4)
    pose[0, 3] = 1.0
    K = [[9.0, 0, 4], [0, 9.0, 3], [0, 0, 1]]
    entries = [{"width": 8, "height": 6, "K": K, "world_to_camera": w.tolist()} for w in (np.eye(4), pose)]
    path.write_text(str({"cameras": entries}).replace("'", '"'))
    made = ingest(IngestConfig(videos, tmp_path / "set", cameras=path, times=("100",), board="none"))
    dataset, board = Dataset.open(made.folder), BoardTemplate.load("paper_rig")
    with pytest.raises(GofError, match="was made of cam_0, cam_1, in this order"):
        annotate(dataset, board, [two, one])
    assert all(note.startswith("no board mask") for note in annotate(dataset, board, [one, two]).values())


# ---- two clips of one camera -----------------------------------------------------------------------------------------


def test_cameras_in_one_place_are_named():
    turned = np.diag([-1.0, 1, -1])  # the same place, looking the other way
    poses = np.tile(np.eye(4), (4, 1, 1))
    centres = np.array([[0, 0, 2.0], [3, 0, 2], [0.029, 0, 2], [3, 0.031, 2]])
    for pose, centre, rotation in zip(poses, centres, (np.eye(3), np.eye(3), turned, turned), strict=True):
        pose[:3, :3], pose[:3, 3] = rotation, -rotation @ centre
    assert _together(poses, list("abcd")) == ["a and c"]
    assert _together(poses[:2], list("ab")) == []
