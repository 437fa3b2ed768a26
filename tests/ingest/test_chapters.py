"""A recording in several files, as action cameras write it, is read as the film it was before it was cut."""

import shutil
import subprocess

import numpy as np
import pytest

from gof.capture.boardless import RATE, NoSound, read_sound
from gof.commands import cli
from gof.core.errors import DataFormatError
from gof.footage.chapters import Chapter, chapter_named, chapters_before, chapters_from, following, without_later
from gof.footage.folders import videos_of_take
from gof.footage.videos import (
    chapter_lines,
    chosen_frames,
    fingerprint,
    read_info,
    require_different,
    stated_frames,
    stored_frames,
)
from gof.ingest.footage import Footage
from gof.ingest.frame_times import Timing
from tests.videos import cut_off, number_of, numbered, tag_rotation, write_video

NEEDS_FFMPEG = pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="needs ffmpeg")
NAMES = ("GX010042.AVI", "GX020042.AVI", "GX030042.AVI")


def ask(capsys, *words):
    """What the command says."""
    cli.main([*map(str, words)])
    said = capsys.readouterr()
    return " ".join((said.out + said.err).split())


def pictures(first, last):
    return list(numbered(31))[first:last]


def recording(folder, names=NAMES, cuts=(0, 5, 12, 20), fps=25.0):
    """Pictures 0 to 19 in chapters. Motion JPEG, whose frames are each on its own, so that a cut changes none."""
    folder.mkdir(exist_ok=True, parents=True)
    for name, first, last in zip(names, cuts, cuts[1:], strict=False):
        write_video(folder / "x.avi", pictures(first, last), fps).rename(folder / name)
    return folder / names[0]


# ---- names -----------------------------------------------------------------------------------------------------------


def test_names_are_those_of_the_makers_convention():
    """Its table: https://community.gopro.com/s/article/GoPro-Camera-File-Naming-Convention."""
    assert chapter_named("GH011234.mp4") == Chapter("GH1234.mp4", 1)
    assert chapter_named("GH021234.MP4") == Chapter("GH1234.mp4", 2)
    assert chapter_named("gx121234.mp4") == Chapter("GX1234.mp4", 12)
    assert [chapter_named(f"{name}1234.MP4").number for name in ("GOPR", "GP01", "GP02")] == [1, 2, 3]
    assert len({chapter_named(f"{name}1234.MP4").recording for name in ("GOPR", "GP01", "GP02")}) == 1
    others = (
        "GHAA0001.MP4 GX01004.MP4 GX0100421.MP4 GX010042_cut.MP4 ._GX010042.MP4 GP000001.MP4 cam_0.mp4 GX000042.mp4"
    )
    assert [chapter_named(name) for name in others.split()] == [None] * 8
    different = ["GX010042.MP4", "GH010042.MP4", "GX010043.MP4", "GOPR0042.MP4", "GX010042.LRV"]
    assert len({chapter_named(name).recording for name in different}) == 5


def test_chapters_follow_by_number_and_a_gap_is_named():
    beside = ["GX030042.MP4", "GX010043.MP4", "gx020042.mp4", "GX010042.MP4", "GX020043.MP4", "GX040042.LRV"]
    assert following("GX010042.MP4", beside) == ["gx020042.mp4", "GX030042.MP4"]
    assert following("gx020042.mp4", beside) == ["GX030042.MP4"]
    assert following("GX030042.MP4", beside) == following("cam_0.mp4", beside) == []
    old = [f"GP{k:02d}0042.MP4" for k in range(10, 0, -1)]
    assert following("GOPR0042.MP4", old) == sorted(old)
    with pytest.raises(DataFormatError, match=r"GX010042\.MP4: .* in GX040042\.MP4, but GX030042\.MP4 before that"):
        following("GX010042.MP4", ["GX020042.MP4", "GX040042.MP4"])
    with pytest.raises(DataFormatError, match=r"in GP020042\.MP4, but GP010042\.MP4 before that"):
        following("GOPR0042.MP4", ["GP020042.MP4"])
    with pytest.raises(DataFormatError, match=r"GX020042\.MP4 and gx020042\.mp4 are both chapter 2"):
        following("GX010042.MP4", ["GX020042.MP4", "gx020042.mp4"])


# ---- pictures and times ----------------------------------------------------------------------------------------------


def test_chapters_are_the_film_before_it_was_cut(tmp_path):
    whole = write_video(tmp_path / "whole.avi", pictures(0, 20), 25.0)
    first = recording(tmp_path / 'it\'s a 100% [odd] "näme"; $x,\\b')
    info, known = read_info(first), read_info(whole)
    assert info.frames == info.stated_frames == stated_frames(first) == known.frames == 20
    np.testing.assert_allclose(info.stamps_s, known.stamps_s, atol=0.1 / 25)
    np.testing.assert_array_equal(list(stored_frames(first)), list(stored_frames(whole)))
    assert info.chapters == NAMES and known.chapters == () and info.path == first
    assert chapter_lines([first, whole]) == [f"GX010042: 3 chapters, {NAMES[0]}, {NAMES[1]} and {NAMES[2]}, 1 s"]
    for numbers in ([4, 5], [11, 12, 13], [5, 19], [0, 12]):  # on both sides of a cut, and far behind it
        assert [number_of(picture) for picture in chosen_frames(first, numbers)] == numbers
    with pytest.raises(DataFormatError, match="has 20 frames, 21 are wanted"):
        list(chosen_frames(first, [20]))


def test_a_part_across_a_cut_is_what_the_options_say(tmp_path):
    """Two cameras, one in chapters: --start and --frames count the recording's frames."""
    first = recording(tmp_path / "a")
    other = write_video(tmp_path / "other.avi", pictures(2, 22), 25.0)
    footage = Footage.open([first, other], "auto", None, 60.0)
    assert any(note.startswith("GX010042: 3 chapters, ") for note in footage.notes)
    assert footage.provenance["videos"][0]["chapters"] == NAMES
    times = footage.frame_times(Timing(fps=(25.0,), start=(4, 2), limit=10))
    assert times.frames[0].tolist() == list(range(4, 14)) and times.frames[1].tolist() == list(range(2, 12))
    np.testing.assert_allclose(times.time_s[0], np.arange(10) / 25, atol=1e-9)
    assert footage.frame_times(Timing(stamps=True, limit=20)).frames[0].tolist() == list(range(20))
    assert [number_of(picture) for picture in stored_frames(first)] == list(range(20))


def test_a_later_chapter_is_read_on_from_there_and_says_so(tmp_path):
    recording(tmp_path)
    assert [number_of(picture) for picture in stored_frames(tmp_path / NAMES[1])] == list(range(5, 20))
    words = "GX020042: 2 chapters, GX020042.AVI and GX030042.AVI, 1 s; begins with chapter 2 of its recording"
    assert chapter_lines([tmp_path / NAMES[1]]) == [f"{words}; GX010042.AVI before it is not read"]
    said = f"begins with chapter 3 of its recording; {NAMES[0]} and {NAMES[1]} before it are not read"
    assert chapter_lines([tmp_path / NAMES[2]]) == [f"GX030042: {said}"]
    (tmp_path / NAMES[0]).unlink()
    assert chapter_lines([tmp_path / NAMES[1]]) == [f"{words}; what came before is not read"]


def test_links_are_followed_to_the_chapters(tmp_path):
    first = recording(tmp_path / "card")
    (tmp_path / "take").mkdir()
    for name in ("cam_0.avi", NAMES[0]):  # the chapters lie beside what the link means
        link = tmp_path / "take" / name
        link.symlink_to(first)
        assert read_info(link).frames == 20 and read_info(link).path == link
        assert chapter_lines([link])[0].startswith(f"{link.stem}: 3 chapters, {name}, {NAMES[1]} and")
        assert fingerprint(link) == fingerprint(first)
    (tmp_path / "linked").mkdir()
    for k, name in enumerate(NAMES):  # they are links themselves, to files of any name
        kept = first.with_name(name).rename(tmp_path / f"part{k}.avi")
        (tmp_path / "linked" / name).symlink_to(kept)
    assert read_info(tmp_path / "linked" / NAMES[0]).frames == 20
    late = tmp_path / "late.avi"
    late.symlink_to(tmp_path / "linked" / NAMES[1])
    assert chapters_from(tmp_path / "linked" / NAMES[1])[1:] == [tmp_path / "linked" / NAMES[2]]
    (tmp_path / "part2.avi").unlink()
    with pytest.raises(DataFormatError, match=r"GX030042\.AVI: no such"):
        read_info(tmp_path / "linked" / NAMES[0])


# ---- which footage it is ---------------------------------------------------------------------------------------------


def test_every_chapter_tells_the_footage(tmp_path):
    first = recording(tmp_path / "a")
    known = fingerprint(first)
    shutil.copytree(tmp_path / "a", tmp_path / "b")
    assert fingerprint(tmp_path / "b" / NAMES[0]) == known
    with pytest.raises(DataFormatError, match="is the same footage as"):
        require_different([first, tmp_path / "b" / NAMES[0]])
    (tmp_path / "b" / NAMES[2]).unlink()
    assert fingerprint(tmp_path / "b" / NAMES[0]) != known


@pytest.mark.parametrize("command", [("ingest",), ("capture", "sync"), ("capture", "check-footage")])
def test_two_chapters_are_no_two_cameras(tmp_path, capsys, command):
    for names in (NAMES[:2], ("GOPR0042.AVI", "GP010042.AVI")):
        first = recording(tmp_path, names)
        second = tmp_path / names[1]
        more = ("--fov", "60", "--times", "25", "--out", tmp_path / "set") if command == ("ingest",) else ()
        for given in ((first, second), (second, first)):
            said = ask(capsys, *command, *given, *more)
            assert f"is of one recording with {given[0]}" in said and f"Give only {first.name} for this" in said


def test_a_folder_with_a_take_has_one_camera_for_each_recording(tmp_path):
    recording(tmp_path)
    recording(tmp_path, ("GX010043.AVI", "GX020043.AVI"))
    assert [video.name for video in videos_of_take(tmp_path)] == ["GX010042.AVI", "GX010043.AVI"]
    assert [video.name for video in without_later([tmp_path / name for name in NAMES[1:]])] == [NAMES[1]]
    assert chapters_before(tmp_path / NAMES[2]) == (3, list(NAMES[:2]))


# ---- what is wrong ---------------------------------------------------------------------------------------------------


def test_a_missing_chapter_is_an_error(tmp_path, capsys):
    first = recording(tmp_path)
    (tmp_path / NAMES[1]).unlink()
    for command in (("ingest", first, first), ("capture", "sync", first), ("capture", "check-footage", first)):
        said = ask(capsys, *command, *(("--fov", "60", "--times", "25") if command[0] == "ingest" else ()))
        assert "GX010042.AVI: its recording goes on in GX030042.AVI, but GX020042.AVI before that is not" in said


def test_chapters_that_differ_are_an_error(tmp_path, capsys):
    first = recording(tmp_path)
    second = tmp_path / NAMES[1]
    small = [picture[::2, ::2] for picture in pictures(0, 5)]
    for name, more, fps, said in (
        ("x.avi", small, 25.0, r"is 48x32, 25 .*MJPG, and that is 96x64, 25 .*MJPG"),
        ("x.avi", pictures(0, 5), 30.0, r"is 96x64, 30 frames .* and that is 96x64, 25 frames"),
        ("x.mp4", pictures(0, 5), 25.0, r"25 frames per second, \w+, and that is .* MJPG"),
    ):
        write_video(tmp_path / name, more, fps).rename(second)
        with pytest.raises(DataFormatError, match=rf"GX020042\.AVI: goes on with GX010042\.AVI .*{said}"):
            read_info(first)
    assert "GX020042.AVI: goes on with GX010042.AVI" in ask(capsys, "capture", "sync", first)
    second.write_bytes(b"no film")
    with pytest.raises(DataFormatError, match=r"GX020042\.AVI: goes on with GX010042\.AVI .* cannot be read"):
        next(stored_frames(first))
    second.write_bytes(b"")
    with pytest.raises(DataFormatError, match=r"GX020042\.AVI: holds nothing"):
        require_different([first])
    turned = recording(tmp_path / "mp4", ("GX010001.AVI",))
    for number, degrees in ((1, 0), (2, 90)):
        path = write_video(tmp_path / "x.mp4", pictures(0, 5), 25.0)
        turned = tag_rotation(path, degrees).rename(tmp_path / f"mp4/GX0{number}0009.MP4")
    with pytest.raises(DataFormatError, match="turned by 90 degrees, and that is"):
        read_info(turned.with_name("GX010009.MP4"))


def test_a_chapter_that_breaks_off_before_the_last_is_an_error(tmp_path):
    first, second = tmp_path / "GX010042.MP4", tmp_path / "GX020042.MP4"
    for path, more in ((first, pictures(0, 12)), (second, pictures(12, 20))):
        write_video(tmp_path / "x.mp4", more, 25.0).rename(path)
    assert read_info(first).frames == 20
    cut_off(first, 0.6)
    with pytest.raises(DataFormatError, match=r"GX010042\.MP4: breaks off: \d+ of the 12 .* goes on in GX020042\.MP4"):
        read_info(first)
    assert [number_of(picture) for picture in chosen_frames(first, [0, 1])] == [0, 1]  # what comes before it is there


# ---- sound -----------------------------------------------------------------------------------------------------------


def split_film(folder, fps="30000/1001"):
    """A film with sound, and the same packets in two chapters, cut at a key frame; which frame that is."""
    program = ["ffmpeg", "-v", "error", "-y"]
    whole = folder / "whole.mp4"
    sources = ["-f", "lavfi", "-i", f"testsrc2=size=96x64:rate={fps}:duration=6"]
    sources += ["-f", "lavfi", "-i", "anoisesrc=d=6:c=pink:r=48000:a=0.5:seed=7"]
    subprocess.run([*program, *sources, "-c:v", "libx264", "-g", "30", "-c:a", "aac", whole], check=True)
    cut = ["-i", whole, "-map", "0", "-c", "copy", "-f", "segment", "-segment_time", "3", "-reset_timestamps", "1"]
    subprocess.run([*program, *cut, folder / "part%d.mp4"], check=True)
    parts = sorted(folder.glob("part*.mp4"))
    assert len(parts) == 2
    count = len(list(stored_frames(parts[0])))
    for number, part in enumerate(parts, 1):
        part.rename(folder / f"GX0{number}0042.MP4")
    return whole, folder / "GX010042.MP4", count


@NEEDS_FFMPEG
def test_pictures_times_and_sound_go_on_over_the_cut(tmp_path):
    folder = tmp_path / "it's [a] 'take'; #1 = $x\\"
    folder.mkdir()
    whole, first, cut = split_film(folder)
    info, known = read_info(first), read_info(whole)
    step_s = 1001 / 30000
    assert known.frames == info.frames == 180 and 0 < cut < 180
    np.testing.assert_array_equal(list(stored_frames(first)), list(stored_frames(whole)))
    np.testing.assert_allclose(info.stamps_s, known.stamps_s, atol=0.01 * step_s)
    sound, heard = read_sound(info), read_sound(known)
    assert abs(len(sound) - len(heard)) < 0.05 * RATE
    at = round(cut * step_s * RATE)
    for begins in (1000, at - 20000, at + 2000, len(heard) - 22000):  # a second before, at and after the cut
        part = heard[begins : begins + 16000]
        lags = np.arange(-400, 401)
        together = [float(part @ sound[begins + lag : begins + lag + 16000]) for lag in lags]
        assert abs(lags[int(np.argmax(together))]) <= 0.1 * step_s * RATE
        assert max(together) > 0.95 * float(part @ part)
    for begins in range(0, len(heard) - 1600, 800):
        part, same = heard[begins : begins + 800], sound[begins : begins + 800]
        if abs(begins + 400 - at) > 0.1 * RATE:  # where ffmpeg cuts, it leaves out some packets of sound
            assert float(part @ same) > 0.9 * float(np.linalg.norm(part) * np.linalg.norm(same)) > 0, begins


@NEEDS_FFMPEG
def test_sound_of_a_file_that_begins_late_is_where_its_pictures_are(tmp_path):
    """Both later by the same time are the same film: before, only the pictures were."""
    whole, _, _ = split_film(tmp_path)
    late = tmp_path / "late.mkv"
    shifted = ["ffmpeg", "-v", "error", "-y", "-i", whole, "-c", "copy", "-output_ts_offset", "1", late]
    subprocess.run(shifted, check=True)
    info = read_info(late)
    assert info.start_s == pytest.approx(1, abs=0.05) and info.begins_s[0][0] == 0
    heard, sound = read_sound(read_info(whole)), read_sound(info)
    part, lags = heard[8000:24000], np.arange(-1600, 1601)
    together = [float(part @ sound[8000 + lag : 24000 + lag]) for lag in lags]
    assert abs(lags[int(np.argmax(together))]) <= 0.04 * RATE  # the start is known to a frame
    assert len(sound) == pytest.approx(len(heard), abs=0.05 * RATE)


@NEEDS_FFMPEG
def test_a_chapter_without_sound_is_named(tmp_path):
    _, first, _ = split_film(tmp_path)
    second = tmp_path / "GX020042.MP4"
    silent = ["ffmpeg", "-v", "error", "-y", "-i", second, "-an", "-c", "copy", tmp_path / "x.mp4"]
    subprocess.run(silent, check=True)
    (tmp_path / "x.mp4").rename(second)
    with pytest.raises(NoSound, match=r"GX020042\.MP4: has no sound"):
        read_sound(read_info(first))
