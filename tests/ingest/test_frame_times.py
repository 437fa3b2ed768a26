"""Frames are paired by time: by the board, by rates, by the files' own stamps; what does not fit is named."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gof.capture.board_mask import board_mask
from gof.capture.times import CounterReading, DecodingCost, FrameTime, FrameTimesFile, SyncedVideo, VideoTimes
from gof.core.errors import DataFormatError, GofError
from gof.core.records import write_record
from gof.footage.videos import VideoInfo
from gof.ingest.frame_times import Timing, read_frame_times
from gof.ingest.pairing import pair


def infos(*counts: int) -> list[VideoInfo]:
    """Folders of so many pictures: nothing is stated of their times."""
    return [VideoInfo(Path(f"view{c}"), 100, 200, None, n, frames=n) for c, n in enumerate(counts)]


def video(name: str, stamps_s, **stated) -> VideoInfo:
    """One that was read to its end."""
    stamps = np.asarray(stamps_s, float)
    stated = {"stated_fps": 30.0, "stated_frames": len(stamps)} | stated
    return VideoInfo(Path(name), 100, 200, stamps_s=stamps, frames=len(stamps), **stated)


def times_file(path, clocks_us, row_us=4.0, readout="left", warnings=()) -> FrameTimesFile:
    """A times.json as `gof capture sync` writes it, of cameras whose frames were taken at these times."""
    videos = []
    for c, clock in enumerate(clocks_us):
        interval = float(np.median(np.diff(clock)))
        times = VideoTimes(
            width=100,
            height=200,
            fps=1e6 / interval,
            frame_interval_us=interval,
            row_time_us=row_us,
            readout=readout,
            frames=tuple(FrameTime(7 + 1e-6 * t, 1.0, 7.0, True) for t in np.asarray(clock).tolist()),
            repeated_frames=(),
            dropped_before={},
            rms_us=1.0,
            max_residual_us=2.0,
            systematic_us=1.0,
            outliers=0,
            exposure_us=None,
            saturation=None,
            count=CounterReading(1, 1.0, len(clock)),
            container_fps=None,
            marker_px=60.0,
            faults=(),
            warnings=tuple(warnings),
            cost=DecodingCost(1.0, 1.0, 10.0),
            board_px=(),
        )
        videos.append(SyncedVideo(f"cam_{c}", f"cam_{c}.mp4", times))
    record = FrameTimesFile("paper_rig", 4000.0, tuple(videos), {}, ())
    write_record(path, record)
    return record


def clock(offset_us=0.0, frames=20, step_us=2500.0):
    return offset_us + step_us * np.arange(frames)


# ---- by the board ----------------------------------------------------------------------------------------------------


def test_measured_clock_pairs_nearest_frames(tmp_path):
    path = tmp_path / "times.json"
    times_file(path, [clock(), clock(-6000), clock(3200)])
    times = read_frame_times(Timing(path), infos(20, 20, 20))
    # Camera 2 starts 3.2 ms late: its first frame pairs with camera 0's frame 1.
    assert [frames.tolist() for frames in times.frames] == [list(range(first, first + 17)) for first in (1, 3, 0)]
    starts = np.array([t[0] for t in times.time_s])
    np.testing.assert_allclose(starts, [0, -1e-3, 0.7e-3], atol=1e-9)
    np.testing.assert_allclose(np.diff(times.time_s[2]), 2.5e-3, atol=1e-9)
    assert times.row_time_s == pytest.approx([4e-6] * 3) and times.readout == ["left"] * 3
    turned = {turn: times.turned((turn,) * 3).readout[0] for turn in ("clockwise", "counterclockwise", "half")}
    assert turned == {"clockwise": "up", "counterclockwise": "down", "half": "right"} and times.notes == ()


def test_the_board_that_gave_the_times_is_masked(tmp_path):
    """Drawn where `gof capture sync` saw it, in the stored picture; a copy of half the size has it at half the size."""
    path = tmp_path / "times.json"
    record = times_file(path, [clock(), clock(), clock(), clock()])
    square = ((20.0, 30.0), (80.0, 30.0), (80.0, 90.0), (20.0, 90.0))
    everything = ((0.0, 0.0), (100.0, 0.0), (100.0, 200.0), (0.0, 200.0))
    places = [(square,), (), None, (everything,)]
    cameras = tuple(
        replace(c, times=replace(c.times, board_px=place, marker_px=8.0))
        for c, place in zip(record.cameras, places, strict=True)
    )
    write_record(path, replace(record, cameras=cameras))
    times = read_frame_times(Timing(path), infos(20, 20, 20, 20))
    mask = times.boards[0]
    assert mask.shape == (200, 100) and mask.dtype == np.uint8
    assert mask[30:90, 20:80].min() == 255 and mask[100:].max() == 0 and mask[:24].max() == 0
    assert [board is None for board in times.boards] == [False, True, True, True]
    assert times.notes[0] == f"cam_0: board mask, {(mask > 127).mean():.1%} of the picture"
    assert times.notes[1].startswith("cam_2: no board mask: an older gof made times.json; 'gof capture annotate'")
    assert times.notes[2].startswith("cam_3: no board mask: what was taken for the board covers 100%")
    assert not read_frame_times(Timing(path, masks=False), infos(20, 20, 20, 20)).boards
    guessed = replace(cameras[1], times=replace(cameras[1].times, clock="flame"))
    write_record(path, replace(record, cameras=(cameras[0], guessed, *cameras[2:])))
    notes = read_frame_times(Timing(path), infos(20, 20, 20, 20)).notes
    assert any(note.startswith("cam_1: NO BOARD MASK") and "lamps count as flame" in note for note in notes)
    small = [replace(info, width=50, height=100) for info in infos(20, 20, 20, 20)]
    assert read_frame_times(Timing(path), small).boards[0].shape == (100, 50)


def test_half_the_rate_is_paired_by_time(tmp_path):
    """A camera at 200 frames a second takes every second moment of one at 400; by number they would drift apart."""
    path = tmp_path / "times.json"
    times_file(path, [clock(frames=100), clock(1300, 50, 5000)])
    times = read_frame_times(Timing(path), infos(100, 50))
    assert times.frames[1].tolist() == list(range(50)) and times.frames[0].tolist() == list(range(1, 100, 2))
    np.testing.assert_allclose(times.time_s[1] - times.time_s[0], -1.2e-3, atol=1e-9)
    assert any("differ in rate (cam_0 400, cam_1 200" in note for note in times.notes)
    other_way = tmp_path / "other.json"
    times_file(other_way, [clock(1300, 50, 5000), clock(frames=100)])
    again = read_frame_times(Timing(other_way), infos(50, 100))
    assert [f.tolist() for f in again.frames] == [f.tolist() for f in reversed(times.frames)]


def test_rates_that_are_no_multiples_stay_together(tmp_path):
    path = tmp_path / "times.json"
    times_file(path, [clock(frames=120, step_us=1e6 / 240), clock(500, 100, 1e6 / 100)])
    times = read_frame_times(Timing(path), infos(120, 100))
    assert np.abs(times.time_s[1] - times.time_s[0]).max() <= 0.5 / 240 + 1e-9
    assert all((np.diff(frames) > 0).all() for frames in times.frames) and len(times.frames[0]) == 50


def test_a_dropped_frame_is_left_out_for_all_and_said(tmp_path):
    path = tmp_path / "times.json"
    whole = clock()
    dropped = np.delete(clock(100, 21), 10)  # 20 frames; the one at 25.1 ms is missing
    times_file(path, [whole, dropped], warnings=["only 81.5% of the readings fit"])
    times = read_frame_times(Timing(path), infos(20, 20))
    assert times.frames[0].tolist() == [k for k in range(20) if k != 10] and times.frames[1].tolist() == list(range(19))
    np.testing.assert_allclose(times.time_s[1] - times.time_s[0], 1e-4, atol=1e-9)
    assert "cam_1: 1 frames are missing, first after frame 9; left out for all" in times.notes
    assert "cam_0: only 81.5% of the readings fit" in times.notes, "what sync doubted is said again"
    twice = clock(100)
    twice[10:] = twice[9:-1]  # frame 10 shows frame 9 again
    times_file(path, [whole, twice])
    times = read_frame_times(Timing(path), infos(20, 20))
    assert (
        10 not in times.frames[1]
        and "cam_1: 1 frames are shown twice, first after frame 9; left out for all" in times.notes
    )
    np.testing.assert_allclose(times.time_s[1] - times.time_s[0], 1e-4, atol=1e-9)


def test_times_that_are_full_of_holes_are_refused(tmp_path):
    path = tmp_path / "times.json"
    times_file(path, [clock(frames=100), np.delete(clock(frames=120), range(40, 60))])
    with pytest.raises(DataFormatError, match=r"times.json: at 20 of 100 moments .* first at frame 40 of cam_0"):
        read_frame_times(Timing(path), infos(100, 100))
    assert len(read_frame_times(Timing(path, limit=40), infos(100, 100)).frames[0]) == 40


def test_drift_and_jitter_do_not_swap_neighbours():
    """Half a frame apart, 50 ppm of drift, 3 % of jitter: still one frame after the other."""
    rng = np.random.default_rng(1)
    first, second = (clock(o, 400) * 1e-6 + rng.normal(0, 0.03 * 2.5e-3, 400) for o in (0, 1250))
    frames = pair(["a", "b"], [first, second * (1 + 5e-5)], 0, None).frames
    assert all((np.diff(f) == 1).all() for f in frames) and len(frames[0]) >= 399


def test_far_clocks_lose_nothing():
    """Unix time: 1.7e9 s."""
    frames = pair(["a", "b"], [1.7e9 + clock() * 1e-6, 1.7e9 + clock(2500) * 1e-6], 0, None).frames
    assert frames[0].tolist() == list(range(1, 20)) and frames[1].tolist() == list(range(19))


def test_times_that_do_not_overlap_are_named_with_their_likely_cause():
    """34.8 s apart: what another board's template made of two cameras that filmed together."""
    names, clocks = ["left", "right"], [49.51 + 0.0025 * np.arange(40), 14.70 + 0.0025 * np.arange(40)]
    with pytest.raises(GofError) as error:
        pair(names, clocks, 0, None, "times.json")
    said = str(error.value)
    assert "left 49.510 to 49.607 s, right 14.700 to 14.797 s" in said
    assert "times.json" in said and "LED board" in said and "--board" in said
    with pytest.raises(GofError, match=r"do not overlap in time .*--start"):
        pair(names, clocks, 0, None)


def test_errors_of_measured_times_say_what_to_do(tmp_path):
    path = tmp_path / "times.json"
    record = times_file(path, [clock(), clock(100)])
    with pytest.raises(GofError, match=r"one of --times.*--times RATE.*--times stamps"):
        read_frame_times(Timing(), infos(20, 20))
    with pytest.raises(GofError, match=r"one of --times"):
        read_frame_times(Timing(path, (400.0,)), infos(20, 20))
    with pytest.raises(GofError, match="first camera's only"):
        read_frame_times(Timing(path, start=(0, 3)), infos(20, 20))
    with pytest.raises(DataFormatError, match="3 videos"):
        read_frame_times(Timing(path), infos(20, 20, 20))
    with pytest.raises(DataFormatError, match="20 frames, its video 19"):
        read_frame_times(Timing(path), infos(20, 19))
    with pytest.raises(GofError, match="--start 20"):
        read_frame_times(Timing(path, start=(20,)), infos(20, 20))
    lost = SyncedVideo("cam_1", "cam_1.mp4", error="marker not found")
    write_record(path, replace(record, cameras=(record.cameras[0], lost)))
    with pytest.raises(DataFormatError, match="marker not found"):
        read_frame_times(Timing(path), infos(20, 20))
    times_file(path, [clock(), clock(1e6)])
    with pytest.raises(GofError, match="do not overlap"):
        read_frame_times(Timing(path), infos(20, 20))
    times_file(path, [clock(), clock(47500)])
    with pytest.raises(GofError, match="1 frames are left"):
        read_frame_times(Timing(path), infos(20, 20))


# ---- by rate and stamps ----------------------------------------------------------------------------------------------


def test_one_rate_gives_equal_steps_and_a_start_for_each_camera():
    times = read_frame_times(Timing(fps=(400.0,), start=(0, 7, 2)), infos(100, 100, 100))
    assert [(f[0], f[-1]) for f in times.frames] == [(0, 92), (7, 99), (2, 94)] and len(times.frames[0]) == 93
    for time_s in times.time_s:
        np.testing.assert_allclose(time_s, np.arange(93) / 400, atol=1e-12)
    assert "[0, 7, 2] taken together" in times.source
    later = read_frame_times(Timing(fps=(400.0,), start=(5,), limit=10), infos(100, 100))
    assert [f.tolist() for f in later.frames] == [list(range(5, 15))] * 2 and later.time_s[0][0] == 0
    for timing, said in (
        (Timing(fps=(100.0,), start=(20,)), "--start 20: view0 has 20 frames"),
        (Timing(fps=(100.0,), start=(0, 25, 0)), "one for each of the 2"),
        (Timing(fps=(100.0, 50.0, 50.0)), "--times: give one value for all"),
        (Timing(fps=(0.0,)), "--times 0: must be positive"),
        (Timing(fps=(100.0,), start=(19,)), "1 frames are left"),
    ):
        with pytest.raises(GofError, match=said):
            read_frame_times(timing, infos(20, 20))


def test_one_start_cuts_films_that_begin_together():
    """By time: of films of other rates, or with frames lost before it, frames of that number are of other moments."""
    fast, slow = video("a.mp4", np.arange(240) / 60, stated_fps=60.0), video("b.mp4", np.arange(120) / 30)
    for timing in (Timing(fps=(60.0, 30.0), start=(60,), limit=20), Timing(stamps=True, start=(60,), limit=20)):
        times = read_frame_times(timing, [fast, slow])
        assert [f[:3].tolist() for f in times.frames] == [[60, 62, 64], [30, 31, 32]]
        np.testing.assert_allclose(times.time_s[1], times.time_s[0], atol=1e-9)
    lost = video("b.mp4", np.delete(np.arange(240), range(20, 25)) / 60, stated_fps=60.0)
    times = read_frame_times(Timing(fps=(60.0,), start=(100,), limit=50), [fast, lost])
    assert [f[0] for f in times.frames] == [100, 95]


def test_a_smaller_copy_has_fewer_lines_and_a_turned_one_others(tmp_path):
    path = tmp_path / "times.json"
    times_file(path, [clock(), clock()], row_us=4.0, readout="down")
    whole, half = (
        read_frame_times(Timing(path), [replace(i, width=w, height=h) for i in infos(20, 20)])
        for w, h in ((100, 200), (50, 100))
    )
    assert whole.row_time_s == [4e-6] * 2 and half.row_time_s == [8e-6] * 2
    with pytest.raises(DataFormatError, match="view0: 200x100, and the film that was timed 100x200: a turned or cut"):
        read_frame_times(Timing(path), [replace(i, width=200, height=100) for i in infos(20, 20)])


def test_clips_of_different_length_need_a_word():
    with pytest.raises(GofError, match=r"view0 100, view1 60.*--frames 60.*--start 0 0"):
        read_frame_times(Timing(fps=(400.0,)), infos(100, 60))
    assert len(read_frame_times(Timing(fps=(400.0,), limit=60), infos(100, 60)).frames[1]) == 60
    known = read_frame_times(Timing(fps=(400.0,), start=(0, 0)), infos(100, 60))
    assert len(known.frames[0]) == 60 and any("view0 100, view1 60" in note for note in known.notes)


def test_files_that_differ_in_rate_need_a_rate_each():
    fast, slow = video("a.mp4", np.arange(100) / 30), video("b.mp4", np.arange(50) / 15, stated_fps=15.0)
    with pytest.raises(GofError, match=r"a.mp4 30, b.mp4 15 frames per second.*--times 400 200 400"):
        read_frame_times(Timing(fps=(400.0,)), [fast, slow])
    times = read_frame_times(Timing(fps=(400.0, 200.0)), [fast, slow])
    assert times.frames[0].tolist() == list(range(0, 100, 2)) and times.frames[1].tolist() == list(range(50))
    np.testing.assert_allclose(times.time_s[0], np.arange(50) / 200, atol=1e-12)
    both = read_frame_times(Timing(stamps=True), [fast, slow])
    np.testing.assert_allclose(both.time_s[1], np.arange(50) / 15, atol=1e-12)
    ntsc = video("b.mp4", np.arange(100) * 1001 / 30000)
    assert len(read_frame_times(Timing(fps=(400.0,)), [fast, ntsc]).frames[0]) == 100, "30 and 29.97 are one rate"


def test_gaps_in_the_stamps_are_gaps_in_time():
    """Three frames are missing; stamps are of the playback rate, rounded to ms as Matroska does."""
    numbers = np.array([k for k in range(100) if k not in (20, 21, 60)])
    lacking = video("b.mkv", np.round(numbers / 30, 3), stated_frames=100)
    times = read_frame_times(Timing(fps=(400.0,)), [video("a.mp4", np.arange(100) / 30), lacking])
    assert times.frames[0].tolist() == numbers.tolist() and times.frames[1].tolist() == list(range(97))
    for time_s in times.time_s:
        np.testing.assert_allclose(time_s, numbers / 400, atol=1e-12)
    assert "b.mkv: 97 of the 100 frames that it states can be read" in times.notes
    assert "b.mkv: 3 frames are missing, first after frame 19; left out for all" in times.notes


def test_a_variable_rate_is_taken_from_the_stamps():
    """A phone that slows from 30 to 24 frames a second as it gets dark: no one rate, but true stamps."""
    steps = np.linspace(1 / 30, 1 / 24, 100)
    phone = video("b.mp4", np.concatenate([[0], np.cumsum(steps)]))
    steady = video("a.mp4", np.arange(130) / 30)
    wild = video("c.mp4", (np.arange(60) + np.random.default_rng(2).uniform(-0.4, 0.4, 60)) / 30)
    for uneven in (wild, phone):
        with pytest.raises(GofError, match=rf"{uneven.path}: has no one rate.*--times stamps"):
            read_frame_times(Timing(fps=(30.0,)), [uneven, uneven])
    times = read_frame_times(Timing(stamps=True, limit=80), [steady, phone])
    np.testing.assert_allclose(times.time_s[1], phone.stamps_s[times.frames[1]], atol=1e-12)
    assert np.abs(times.time_s[1] - times.time_s[0]).max() < 0.6 / 24
    with pytest.raises(GofError, match="view0: pictures have no time stamps"):
        read_frame_times(Timing(stamps=True), infos(20, 20))
    with pytest.raises(GofError, match=r"b.mp4: its time stamps do not grow"):
        read_frame_times(Timing(stamps=True), [steady, video("b.mp4", [0, 1, 1, 2])])


def test_outlines_far_outside_the_picture_are_drawn_as_far_as_they_are_in_it():
    """A damaged times.json: of a triangle from a corner to far beyond, the picture's half; none of one that is away."""
    far = ((0.0, 0.0), (1e300, 1e300), (0.0, 1e300))
    mask = board_mask((far,), 0.1, (64, 64))
    assert mask[40, 10] == 255 and mask[10, 40] == 0
    assert not board_mask((((1e9, 1e9), (2e9, 1e9), (2e9, 2e9)),), 0.1, (64, 64)).any()
