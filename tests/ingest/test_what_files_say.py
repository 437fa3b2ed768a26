"""What a file says of itself and players obey: tracks, the shape of pixels, fields, orientation, parts, clocks."""

import base64
import itertools
import json
import math
import shutil
import subprocess
import zlib
from datetime import datetime, timezone

import cv2
import numpy as np
import pytest
from PIL import Image

from gof.commands import cli
from gof.core.errors import DataFormatError
from gof.footage.codecs import CodedStream
from gof.footage.colour import UNKNOWN, Colour
from gof.footage.containers import video_tracks
from gof.footage.defects import find_combs
from gof.footage.videos import colour_of, read_info, stated_info, stored_frames
from gof.ingest.footage import Footage
from tests.videos import (
    join_tracks,
    number_of,
    numbered,
    set_date,
    tag_edits,
    tag_fields,
    tag_pixels,
    tag_rotation,
    write_video,
)


def ask(capsys, *videos, more=("--fov", "60")):
    """`gof ingest` of these, which is refused. Returns its words."""
    folder = videos[0].parent
    given = [*map(str, videos), "--out", str(folder / "ds"), "--times", "30", *more, "--board", "none"]
    assert cli.main(["ingest", *given]) == 1
    assert not (folder / "ds/dataset.json").exists()
    said = capsys.readouterr()
    return " ".join((said.out + said.err).split())


def rig(folder):
    """Two films that differ."""
    return [write_video(folder / f"cam_{c}.mp4", list(numbered(12))[c:]) for c in range(2)]


# ---- tracks ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("size", "frames"), [((48, 32), 10), ((48, 32), 1), ((96, 64), 10)])
def test_a_track_before_the_film_is_named_and_never_read(tmp_path, capsys, size, frames):
    """A preview, a thumbnail, and a second film of the same size."""
    one, two = rig(tmp_path)
    small = write_video(tmp_path / "small.mp4", numbered(frames, size))
    both = join_tracks(tmp_path / "both.mp4", small, two, (False, size == (96, 64)))
    if size == (96, 64):
        both = join_tracks(tmp_path / "both.mp4", small, two, (True, True))
    said = ask(capsys, one, both)
    assert (
        f"both.mp4: has 2 video tracks (1: {size[0]}x{size[1]} with {frames} frames; 2: 96x64 with 11 frames)" in said
    )
    assert f"ffmpeg -i {both} -map 0:v:{0 if size == (96, 64) else 1} -c copy" in said
    with pytest.raises(DataFormatError, match="2 video tracks"):
        next(iter(stored_frames(both)))


@pytest.mark.parametrize("frames", [1, 12])
def test_a_small_track_behind_the_film_does_no_harm(tmp_path, frames):
    one, _ = rig(tmp_path)
    small = write_video(tmp_path / "small.mp4", numbered(frames, (48, 32)))
    info = read_info(join_tracks(tmp_path / "both.mp4", one, small, (True, False)))
    assert (info.width, info.height, info.frames) == (96, 64, 12)
    assert [number_of(frame) for frame in stored_frames(info.path)] == list(range(12))


def test_tracks_of_matroska_and_avi(tmp_path):
    """Matroska by its specification: a segment of unknown size, two tracks, the second one the default."""

    def element(identity: str, content: bytes) -> bytes:
        return bytes.fromhex(identity) + (0x80 | len(content)).to_bytes(1, "big") + content

    def track(number, size, default):
        video = element("B0", size[0].to_bytes(2, "big")) + element("BA", size[1].to_bytes(2, "big"))
        video += element("9A", bytes([1]))
        fields = element("D7", bytes([number])) + element("83", bytes([1])) + element("88", bytes([default]))
        return element("AE", fields + element("E0", video))

    tracks = element("1654AE6B", track(1, (64, 48), 0) + element("AE", element("83", b"\2")) + track(2, (320, 240), 1))
    file = tmp_path / "a.mkv"
    file.write_bytes(element("1A45DFA3", b"") + bytes.fromhex("1853806701FFFFFFFFFFFFFF") + tracks)
    found = video_tracks(file)
    assert [(t.width, t.height, t.usual, t.interlaced) for t in found] == [
        (64, 48, False, True),
        (320, 240, True, True),
    ]
    avi = video_tracks(write_video(tmp_path / "b.avi", numbered(9)))
    assert [(t.width, t.height, t.frames) for t in avi] == [(96, 64, 9)]
    for k in range(0, 60, 3):  # a file that is damaged here has no tracks, and OpenCV says so
        (tmp_path / "c.mkv").write_bytes(file.read_bytes()[:k])
        video_tracks(tmp_path / "c.mkv")


# ---- pixels ----------------------------------------------------------------------------------------------------------


def test_pixels_that_are_not_square_are_refused_with_fov_and_said_with_cameras(tmp_path, capsys):
    one, two = rig(tmp_path)
    assert read_info(tag_pixels(two, 4, 3)).pixel_aspect == pytest.approx(4 / 3)
    said = ask(capsys, one, two)
    assert "cam_1.mp4: its pixels are not square (1.333 times as wide as high)" in said
    assert f"ffmpeg -i {two} -vf scale=iw*sar:ih,setsar=1" in said
    cameras = tmp_path / "cameras.json"
    K = [[80, 0, 48], [0, 107, 32], [0, 0, 1]]
    cameras.write_text(json.dumps({"cameras": [{"width": 96, "height": 64, "K": K}]}))
    notes = Footage.open([one, two], "auto", cameras, None).notes
    assert any("cam_1.mp4: its pixels are 1.333 times as wide as high" in note for note in notes)


# ---- fields ----------------------------------------------------------------------------------------------------------


def flame(moment: float) -> np.ndarray:
    """A bright blob over a textured wall that flickers sideways."""
    scene = cv2.GaussianBlur(np.random.default_rng(0).uniform(0, 200, (120, 160, 3)), (0, 0), 2)
    y, x = np.mgrid[:120, :160]
    glow = np.exp(-0.5 * (((x - 60 - 6 * moment) / 9) ** 2 + ((y - 60) / 18) ** 2))[..., None]
    return np.uint8(np.clip(scene + glow * [190, 120, 30], 0, 255))


def interlaced(k: int) -> np.ndarray:
    """Even lines at one moment, odd lines at the next."""
    picture = flame(2 * k)
    picture[1::2] = flame(2 * k + 1)[1::2]
    return picture


@pytest.mark.parametrize("kind", ["mp4", "avi", "folder"])
def test_interlaced_footage_is_refused_with_the_way_out(tmp_path, capsys, kind):
    paths = []
    for c in range(2):
        pictures = [interlaced(k + 2 * c) for k in range(6)]
        if kind == "folder":
            paths.append(tmp_path / f"cam_{c}")
            paths[-1].mkdir()
            for k, picture in enumerate(pictures):
                cv2.imwrite(str(paths[-1] / f"{k}.png"), picture[..., ::-1])
        else:
            paths.append(write_video(tmp_path / f"cam_{c}.{kind}", pictures, 25.0))
    said = ask(capsys, *paths)
    assert f"{paths[0]}: is interlaced, as its pictures show" in said and "-vf bwdif" in said


def test_whole_frames_are_not_taken_for_interlaced_ones(tmp_path):
    rng = np.random.default_rng(0)
    quick = [flame(3 * k) for k in range(6)]
    noisy = [np.uint8(np.clip(p + rng.normal(0, 25, p.shape), 0, 255)) for p in quick]
    for pictures in (quick, noisy):
        assert not find_combs(itertools.pairwise(pictures)).shown
    assert find_combs(itertools.pairwise(quick)).ruled_out
    assert read_info(write_video(tmp_path / "a.mp4", quick)).frames == 6


def test_a_file_that_says_fields_is_believed_unless_its_pictures_are_whole(tmp_path, capsys):
    still = [np.full((64, 96, 3), 80, np.uint8)] * 4
    one, two = (tag_fields(write_video(tmp_path / f"cam_{c}.mp4", still[c:])) for c in range(2))
    assert "cam_0.mp4: is interlaced, its file says" in ask(capsys, one, two)
    whole = tag_fields(write_video(tmp_path / "whole.mp4", [flame(3 * k) for k in range(6)]))
    assert read_info(whole).two_fields


@pytest.mark.parametrize(
    ("codec", "description", "fields"),
    [  # as x264 and FFmpeg's MPEG-2 encoder wrote them, with and without -flags +ildct+ilme
        (b"h264", "017a0015ffe10018677a0015bce4096d808800000300080000030190f8a1524001000668fb83cb22c0fef8f800", True),
        (b"h264", "00000167640015acd9425b6022000003000200000300643e28532c0000000168fba3cb22c0", True),
        (b"h264", "0164000affe100186764000aacd9424db011000003000100000300320f12259601000668ebe3cb22c0fdf8f800", False),
        (b"h264", "0000016764000aacd9424db011000003000100000300320f1225960000000168ebe3cb22c0", False),
        (b"mpg2", "000001b309006013ffffe018000001b5148200010000", True),
        (b"mpg2", "000001b309006013ffffe018000001b5148a00010000", False),
        (b"dvsd", "", True),
        (b"FMP4", "000001b001000001b589130000010000", False),
        (b"h264", "", False),
        (b"h264", "01", False),
    ],
)
def test_codecs_say_whether_they_code_fields(codec, description, fields):
    assert CodedStream.of(codec, bytes.fromhex(description)).two_fields is fields


@pytest.mark.parametrize(
    ("codec", "description", "colour"),
    [  # as x264, x265 and FFmpeg's MPEG-2 encoder wrote them, told Rec. 709, or nothing
        (b"h264", "0164000cffe1001c6764000cacd943056c05a808080a000003000200000300781e28532c01", Colour(1, 1, 1)),
        (b"h264", "0000016764000cacd943056c05a808080a000003000200000300781e28532c", Colour(1, 1, 1)),
        (b"h264", "00000167640015acd9430ad80b50101014000003000400000300f07c50a658", Colour(1, 1, 1)),  # two fields
        (b"h264", "0000016764000cacd943056c0440000003004000000f03c50a658", UNKNOWN),
        (b"mpg2", "000001b30c00a015ffffe018000001b5148a00010000000001b52b02020103020500", Colour(2, 2, 1)),
        (b"h264", "000001676400", UNKNOWN),
        # x265: as MP4 keeps it, in full range, with temporal layers; cut off
        (
            b"hevc",
            "0101600000009000000000003cf000fcfdf8f800000f04a00001001840010c01ffff01600000030090000003000003003c959809a1000100"
            "2d42010101600000030090000003000003003ca0182028596566924caf016a02020208000003000800000300f040a2000100074401c172b4"
            "6240",
            Colour(1, 1, 1),
        ),
        (
            b"hevc",
            "0000000142010102200000030090000003000003003ca01820284d96566924caf016e020202080000003008000000f040",
            Colour(1, 1, 1, full_range=True),
        ),
        (
            b"hevc",
            "0000000142010201600000030090000003000003003c0000a01820285965662b349265780b501010104000000300400000078200",
            Colour(1, 1, 1),
        ),
        (b"hevc", "0000000142010201600000030090000003000003003c0000a01820", UNKNOWN),
    ],
)
def test_streams_say_their_colours(codec, description, colour):
    assert CodedStream.of(codec, bytes.fromhex(description + "0" * (len(description) % 2))).colour == colour


# x264's film of one picture, 32x32, 10 bits in full range: packed by zlib and base64.
FULL_RANGE = (
    b"eNqNUr1PwkAUfweJIQaiAzHGMBSCI0EI6oIJ0YXBVSeXwl2loUeb9mjUCRMHXf0j3J1MnDTixF+gG3ExcWQxJFrfFUgLfsSXvvu9u/d7d++j"
    b"AKBo4tjSHZMDREAialF16wVulQoAENNsxhAVTlWBmGTnZwnvsx99Tz69nD4OyvnnRB5jB9w0XfQb3G1QmJLoKy4ZICC/QMg0a3ZfgT8lgt+2"
    b"sNUm2gei6b8Z/eG2zLfI/7yrjBUgy6hwEFPMcEQoIhPEkltOdXXUo9nay36qe11/k2tQw554XJ2yMHMf92ZVbVGDSQ5hXG9psuEu9y8Np5ml"
    b"I1+K2kwLJRVv24YyssmqI2oG2veOcGiIcy2H+0srZNEKVBGrE0Z8F/mKodeOihulnwax7Hm4biJrh7Rg3uvDyiHiVS+d69wQQipyLrgsRLsX"
    b"lwTmGm8Pvczdx3Aogxct1bHGiUhN1oQ97vJSZ/KAI/wJQMCLSDuFhdWnz4N70HcyiQ/O6maIv4a61aZCTm6dMx+lpMNTwsnaqmUZ4YpjOv4K"
    b"X34Jcho="
)


def test_films_of_ten_bits_in_full_range_are_refused(tmp_path):
    """OpenCV would show its 246 as 255, and 10 as 0; of eight bits it knows the range."""
    path = tmp_path / "a.mp4"
    path.write_bytes(zlib.decompress(base64.b64decode(FULL_RANGE)))
    assert cv2.VideoCapture(str(path)).read()[1].min() == 255
    assert colour_of(path) == Colour(1, 1, 1, full_range=True)
    with pytest.raises(DataFormatError, match="10 bits a channel in full range.*scale=out_range=tv"):
        stated_info(path)


# ---- orientation -----------------------------------------------------------------------------------------------------


def lying(folder, orientation, count=3, suffix=".jpg"):
    """Pictures stored 160 x 90 with a red bar on the left, tagged."""
    folder.mkdir()
    for k in range(count):
        picture = np.zeros((90, 160, 3), np.uint8)
        picture[:, :40] = (200, 40 * k, ord(folder.name[-1]))
        tag = Image.Exif()
        tag[0x0112] = orientation
        Image.fromarray(picture).save(folder / f"{k}{suffix}", exif=tag)
    return folder


@pytest.mark.parametrize(("orientation", "degrees", "turn"), [
    (1, 0, "none"), (3, 180, "half"), (6, 90, "clockwise"), (8, 270, "counterclockwise"),
])  # fmt: skip
@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_pictures_are_read_as_stored_and_turned_by_their_tags(tmp_path, orientation, degrees, turn, suffix):
    """--fov is along the 160 stored pixels, whatever the tag; upright pictures are as Pillow turns them."""
    folders = [lying(tmp_path / f"c{c}", orientation, suffix=suffix) for c in range(2)]
    info = read_info(folders[0])
    assert (info.width, info.height, info.rotation_deg) == (160, 90, degrees)
    stored = next(iter(stored_frames(folders[0])))
    assert stored.shape == (90, 160, 3) and stored[:, :30, 0].min() > 150 > stored[:, 60:].max()
    footage = Footage.open(folders, "auto", None, 70.0)
    assert footage.turns == (turn, turn) and footage.lenses[0].K[0, 0] == pytest.approx(80 / math.tan(math.radians(35)))
    from PIL import ImageOps

    upright = np.asarray(ImageOps.exif_transpose(Image.open(folders[0] / f"0{suffix}"))).astype(int)
    shown = footage.preparation(0)(stored)
    assert shown.shape == upright.shape and np.abs(shown - upright).mean() < 3


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            lambda root: Image.open(root / "c1/2.jpg").save(root / "c1/2.jpg"),
            "2.jpg: by its orientation tag it is turned",
        ),
        (lambda root: lying(root / "d1", 5, 1), "mirrored"),
        (lambda root: lying(root / "d1", 6, 1, ".tif"), "tag says turned"),
        (
            lambda root: lying(root / "d1", 3, 3),
            "the files' rotation tags differ, and so do their pictures (c0: tag 90",
        ),
    ],
    ids=["one without", "mirrored", "tiff", "cameras differ"],
)
def test_orientations_that_differ_or_cannot_be_kept_are_named(tmp_path, capsys, change, said):
    lying(tmp_path / "c0", 6)
    lying(tmp_path / "c1", 6)
    change(tmp_path)
    other = tmp_path / ("d1" if (tmp_path / "d1").exists() else "c1")
    assert said in ask(capsys, tmp_path / "c0", other)


def test_another_clip_of_the_rig_lies_as_this_one(tmp_path):
    """--with-clip: its films are turned and undistorted as this clip's are, so their tags must be the same."""
    one, two = rig(tmp_path)
    footage = Footage.open([one, two], "auto", None, 60.0)
    (tmp_path / "more").mkdir()
    more = rig(tmp_path / "more")
    assert footage.other(more).videos == tuple(more)
    tag_rotation(more[1], 180)
    with pytest.raises(DataFormatError, match=r"more/cam_1\.mp4: is tagged as turned by 180 degrees"):
        footage.other(more)


# ---- one frame, parts, clocks ----------------------------------------------------------------------------------------


def test_single_pictures_and_single_frames_are_named(tmp_path, capsys):
    one, _ = rig(tmp_path)
    single = write_video(tmp_path / "single.mp4", list(numbered(7, (96, 64)))[6:])
    assert "single.mp4: has 1 frame" in ask(capsys, one, single, more=("--fov", "60", "--frames", "1"))
    for c in range(2):
        (tmp_path / f"s{c}").mkdir()
        cv2.imwrite(str(tmp_path / f"s{c}/0.png"), np.full((64, 96, 3), 50 + c, np.uint8))
    assert "s0: has 1 frame" in ask(capsys, tmp_path / "s0", tmp_path / "s1")
    assert "0.png: is a single picture; give a video" in ask(capsys, tmp_path / "s0/0.png", tmp_path / "s1/0.png")


def test_files_of_different_days_are_said(tmp_path):
    one, two = rig(tmp_path)
    zero = datetime(1904, 1, 1, tzinfo=timezone.utc)
    for path, day in ((one, 1), (two, 3)):
        set_date(path, round((datetime(2026, 5, day, tzinfo=timezone.utc) - zero).total_seconds()))
    assert read_info(one).made_s == round(datetime(2026, 5, 1, tzinfo=timezone.utc).timestamp())
    assert any("made 172800 s apart" in note for note in Footage.open([one, two], "auto", None, 60.0).notes)


@pytest.mark.parametrize(
    ("edits", "first", "frames", "begins_s"),
    [
        ([(20 / 30, 5.25 / 30)], 6, 20, 0.75 / 30),
        ([(0.11, None), (0.4, 14 / 30)], 14, 12, 0.11),
        ([(0.011, None), (1.0, 0.0)], 0, 30, 0.011),
    ],
    ids=["between two frames", "empty first", "late"],
)
def test_a_film_that_was_trimmed_without_coding_is_whole(tmp_path, edits, first, frames, begins_s):
    """Its file holds frames that no player shows, and its first one may come a part of a frame after the sound's."""
    path = tag_edits(write_video(tmp_path / "a.mp4", numbered(30)), edits)
    info = read_info(path)
    assert info.frames == info.stated_frames == frames and not info.breaks_off
    assert number_of(next(stored_frames(path))) == first
    assert info.start_s == pytest.approx(begins_s, abs=1e-3)


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="ffmpeg is not installed")
def test_a_file_that_begins_late_is_whole_and_its_beginning_is_said(tmp_path):
    """Matroska states a duration from zero on, which is no count of the frames."""
    pictures = write_video(tmp_path / "a.mp4", numbered(30))
    for name, late in (("late.mkv", "0.5"), ("soon.mkv", "0")):
        given = ["ffmpeg", "-v", "error", "-i", pictures, "-c", "copy", "-output_ts_offset", late, tmp_path / name]
        subprocess.run(given, check=True)
    info = read_info(tmp_path / "late.mkv")
    assert info.frames == info.stated_frames == 30 and not info.breaks_off
    assert info.start_s == pytest.approx(0.5, abs=0.05)
    write_video(tmp_path / "b.mp4", list(numbered(31))[1:])
    notes = Footage.open([tmp_path / "late.mkv", tmp_path / "b.mp4"], "auto", None, 60.0).notes
    assert any("late.mkv 0.5" in note and "b.mp4 0.000 s" in note for note in notes)
