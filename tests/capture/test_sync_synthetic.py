"""Decoding against rendered footage whose times are known exactly."""

import json
from dataclasses import replace

import numpy as np
import pytest

from gof.capture.annotate import mask_from_footage
from gof.capture.board_mask import board_mask
from gof.capture.decode import DecodeOptions, decode
from gof.capture.locate import BoardNotFound, Summary, locate
from gof.capture.strips import NotDecodable, robust_line
from gof.capture.template import BoardTemplate
from gof.commands.cli import main as gof
from gof.footage.pictures import write_picture
from tests.capture.rendered_clips import errors, measure, signals_of
from tests.capture.synthetic import SyntheticShot, lit_share, render, write_video

pytestmark = pytest.mark.long

BOARD = BoardTemplate.load("gof_board")
SMALL = SyntheticShot(width=400, height=560, marker_px=42, centre=(0.48, 0.72), row_time=4.0)


def shoot(shot, frames=64, template=BOARD, change=None):
    return signals_of([change(k, p) if change else p for k, p in enumerate(render(shot, template, frames))], template)


def test_overlap_integral_is_exact():
    rng = np.random.default_rng(0)
    for _ in range(50):
        start, exposure, on, length = (
            rng.uniform(0, 9000),
            rng.uniform(50, 9000),
            rng.uniform(0, 4000),
            rng.uniform(100, 3900),
        )
        t = start + exposure * (np.arange(200_000) + 0.5) / 200_000
        expected = ((t - on) % 4000 < length).mean()
        assert lit_share(np.array(start), exposure, on, length, 4000.0) == pytest.approx(expected, abs=2e-5)


@pytest.mark.parametrize("readout", ["left", "right"])
@pytest.mark.parametrize("exposure, gain", [(200.0, 3.0), (1000.0, 0.9), (1800.0, 8.0)])
def test_times_within_five_us_whatever_exposure_and_saturation(readout, exposure, gain):
    shot = replace(SMALL, readout=readout, exposure=exposure, gain=gain)
    times = decode(shoot(shot), BOARD, DecodeOptions())
    e = errors(times, shot.times(64), shot)
    assert e["fused_rms_us"] < 2 and e["single_rms_us"] < 5, e
    assert times.readout == readout and times.row_time_us == pytest.approx(4.0, abs=0.03)
    assert (
        times.count_agreement == 1 and len(times.count_candidates) == 1 and times.faults == [] and times.warnings == []
    )
    # The stated uncertainty is of the size of the error, not far below it.
    assert e["fused_rms_us"] < 4 * times.sigma_us.mean() + 0.5
    assert times.exposure_us == pytest.approx(exposure, rel=0.25)


def test_landscape_camera_beside_an_upended_board():
    """Rows down the picture, strips turned along them."""
    shot = SyntheticShot(
        width=640, height=400, marker_px=40, roll_deg=90.0, centre=(0.8, 0.5), readout="down", row_time=5.0
    )
    times = decode(shoot(shot), BOARD, DecodeOptions())
    assert times.readout == "down" and errors(times, shot.times(64), shot)["single_rms_us"] < 5


def test_compressed_video_through_the_command(tmp_path):
    shots = {
        "a": replace(SMALL, seed=1),
        "b": replace(SMALL, seed=2, fps=240.0, start=SMALL.start + 1357.9, readout="right", exposure=400.0),
    }
    for name, shot in shots.items():
        write_video(tmp_path / f"{name}.mp4", render(shot, BOARD, 64))
    code = gof(
        [
            "capture",
            "sync",
            str(tmp_path / "a.mp4"),
            str(tmp_path / "b.mp4"),
            "--out",
            str(tmp_path / "out"),
            "--board",
            "gof_board",
            "--json",
            str(tmp_path / "figures.json"),
        ]
    )
    assert code == 0
    result = json.loads((tmp_path / "out/times.json").read_text())
    for camera in result["cameras"]:
        shot, times = shots[camera["name"]], camera["times"]
        truth = shot.times(64) * 1e-6
        got = np.array([f["time_s"] for f in times["frames"]])
        assert np.sqrt(np.mean((got - truth) ** 2)) < 5e-6
        assert times["fps"] == pytest.approx(shot.fps, rel=1e-5) and times["readout"] == shot.readout
        assert (times["width"], times["height"]) == (shot.width, shot.height)
        assert (tmp_path / f"out/residuals_{camera['name']}.png").stat().st_size > 5000
        by_hand = mask_from_footage(tmp_path / f"{camera['name']}.mp4", None, "none", BOARD)
        mask = board_mask(times["board_px"], times["marker_px"], (shot.width, shot.height))
        assert np.abs(mask.astype(int) - by_hand).max() <= 3, "as `gof capture annotate` finds it"
    assert result["nearest_frames"]["b"]["offset_us"] == pytest.approx(1357.9, abs=5)
    assert result["warnings"] == [
        "the cameras ran at different rates (a 400.00, b 240.00 fps): frames of equal numbers drift apart"
    ]
    figures = json.loads((tmp_path / "figures.json").read_text())["cameras"][0]["times"]
    assert figures["rms_us"] < 5 and figures["frames"] == []


def test_row_time_from_the_sensor_table(tmp_path, capsys):
    shot = replace(SMALL, row_time=2.85 * 720 / 400)  # all 720 rows of that sensor in 400 lines
    write_video(tmp_path / "a.mp4", render(shot, BOARD, 40))
    command = [
        "capture",
        "sync",
        str(tmp_path / "a.mp4"),
        "--out",
        str(tmp_path / "out"),
        "--board",
        "gof_board",
        "--row-time",
        "gopro_hero13_720p400",
    ]
    assert gof(command) == 0
    times = json.loads((tmp_path / "out/times.json").read_text())["cameras"][0]["times"]
    assert times["row_time_us"] == pytest.approx(shot.row_time)
    np.testing.assert_allclose([f["time_s"] for f in times["frames"]], shot.times(40) * 1e-6, atol=5e-6)
    assert gof([*command, "--overwrite", "--row-time", "gopro"]) == 1
    assert "no sensor 'gopro' in the table; it has gopro_hero13_720p400" in capsys.readouterr().err


def test_finished_times_are_replaced_only_when_asked(tmp_path, capsys):
    write_video(tmp_path / "a.mp4", render(SMALL, BOARD, 40))
    target = tmp_path / "out/times.json"
    command = ["capture", "sync", str(tmp_path / "a.mp4"), "--out", str(target.parent), "--board", "gof_board"]
    assert gof(command) == 0
    # Without the table's or a given row time, it is the footage's own.
    times = json.loads(target.read_text())["cameras"][0]["times"]
    assert times["row_time_us"] == pytest.approx(SMALL.row_time, abs=0.03)
    target.write_text("mine")
    assert gof(command) == 1
    error = capsys.readouterr().err
    assert str(target) in error and "--overwrite" in error and target.read_text() == "mine"
    assert gof([*command, "--overwrite"]) == 0
    assert json.loads(target.read_text())["schema"] == "gof-times"


def test_dropped_and_repeated_frames_are_found():
    shot = replace(SMALL, lost=(20, 41, 42), repeated=(50,))
    times = decode(shoot(shot), BOARD, DecodeOptions())
    truth = shot.times(64)
    steps = np.diff(times.clock_index)
    assert (np.flatnonzero(steps == 2) + 1).tolist() == [20] and (np.flatnonzero(steps == 3) + 1).tolist() == [40]
    assert np.flatnonzero(steps == 0).tolist() == [50]
    assert np.abs(times.time_us - truth).max() < 5
    assert not times.used[51]


def test_a_wandering_camera_clock():
    shot = replace(SMALL, clock_noise=120.0)
    times = decode(shoot(shot), BOARD, DecodeOptions(clock="free"))
    assert errors(times, shot.times(64), shot)["fused_rms_us"] < 15


@pytest.mark.parametrize("tied", [(1, 2, 3), (2, 3)])
def test_tied_strips_are_named_and_do_not_hurt(tied):
    shot = replace(SMALL, tied=(tied,))
    times = decode(shoot(shot), BOARD, DecodeOptions())
    names = ", ".join(map(str, tied))
    assert times.faults == [f"strips {names} are tied together: all are lit in slots {tied[0]}..{tied[-1]}"]
    assert errors(times, shot.times(64), shot)["fused_rms_us"] < 5


def test_a_dead_strip_is_named():
    def dark(k, picture):
        x, y = first
        picture[np.ix_(range(max(0, y.min() - 3), y.max() + 4), range(max(0, x.min() - 3), x.max() + 4))] = 20
        return picture

    import cv2

    ends = cv2.perspectiveTransform(BOARD.strip_ends[4].reshape(1, -1, 2), SMALL.homography())[0]
    first = ends[:, 0].astype(int), ends[:, 1].astype(int)
    times = decode(shoot(SMALL, change=dark), BOARD, DecodeOptions())
    assert times.faults == ["strip 4 does not flicker: dead, stuck or hidden"]
    assert errors(times, SMALL.times(64), SMALL)["fused_rms_us"] < 5


def test_cut_off_leds_leave_candidates_that_differ_by_whole_periods():
    shot = replace(SMALL, centre=(0.48, 0.94))
    signals = shoot(shot)
    assert (~signals.board.led_visible).sum() >= 4
    times = decode(signals, BOARD, DecodeOptions())
    error = times.time_us - shot.times(64)
    assert np.ptp(error) < 5 and abs(error[0] / 4000 - round(error[0] / 4000)) < 0.002
    offsets = (times.count_candidates - times.count_candidates[0]) * 4000.0
    assert np.abs(error[0] + offsets).min() < 5 and len(offsets) > 1


def test_flame_in_front_of_a_strip():
    def flame(k, picture):
        level = 120 + 100 * np.sin(0.9 * k + np.arange(90)[:, None] / 9)
        picture[60:150, 180:230] = np.maximum(picture[60:150, 180:230], np.clip(level, 0, 255).astype(np.uint8))
        return picture

    times = decode(shoot(SMALL, change=flame), BOARD, DecodeOptions())
    assert errors(times, SMALL.times(64), SMALL)["fused_rms_us"] < 5


def test_what_cannot_be_decoded_is_explained(tmp_path, capsys):
    rng = np.random.default_rng(0)
    summary = Summary()
    for _ in range(4):
        summary.add(rng.integers(0, 255, (200, 200), dtype=np.uint8))
    with pytest.raises(BoardNotFound, match=r"marker 0 .inverted DICT_4X4_50. is not in the picture"):
        locate(summary, BOARD)
    stopped = next(render(SMALL, BOARD, 1))
    summary = Summary()
    for _ in range(20):
        summary.add(stopped)
    with pytest.raises(BoardNotFound, match="is the board running"):
        locate(summary, BOARD)
    # 250 frames per second meet a 4 ms board always at the same phase.
    with pytest.raises((NotDecodable, BoardNotFound), match=r"phases of its period|running|flicker"):
        decode(shoot(replace(SMALL, fps=250.0)), BOARD, DecodeOptions())
    noise = tmp_path / "noise"
    noise.mkdir()
    for k in range(4):
        write_picture(noise / f"{k}.png", rng.integers(0, 255, (200, 200, 3), dtype=np.uint8))
    assert gof(["capture", "sync", str(noise), "--out", str(tmp_path / "o")]) == 1
    assert "no camera could be decoded" in capsys.readouterr().err
    assert not (tmp_path / "o/times.json").exists()


def test_another_tick_frees_a_frozen_board():
    for fps in (50.0, 250.0):
        shot = replace(SMALL, fps=fps, period=4100.0)
        times = decode(shoot(shot), BOARD, DecodeOptions(period_us=4100.0))
        assert errors(times, shot.times(64), shot)["single_rms_us"] < 5


def test_given_row_time_and_direction_are_used_or_contradicted():
    signals = shoot(SMALL)
    times = decode(signals, BOARD, DecodeOptions(fps=400.0, row_time_us=4.0, readout="left"))
    assert times.row_time_us == 4.0 and np.abs(times.time_us - SMALL.times(64)).max() < 5
    with pytest.raises(NotDecodable, match="opposite readout direction"):
        decode(signals, BOARD, DecodeOptions(readout="right"))


def test_robust_line_survives_a_third_of_outliers():
    rng = np.random.default_rng(0)
    index = np.arange(90)
    time = 5.0 + 2500 * index + rng.normal(0, 3, 90)
    time[::3] += rng.uniform(-2000, 2000, 30)
    line, slope, weight = robust_line(index, time)
    assert slope == pytest.approx(2500, abs=0.1) and np.abs(line - 5 - 2500 * index).max() < 3
    assert weight[::3].mean() < 0.1 and weight[1::3].mean() > 0.7


@pytest.mark.parametrize("codec", ["mp4v", "jpeg 10"])
def test_compression(codec):
    e = measure(SMALL, BOARD, 64, codec)
    assert e["fused_rms_us"] < 5 and e["single_rms_us"] < 15, e
