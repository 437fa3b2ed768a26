"""Boards whose marker is partly hidden or cut off, read from points that somebody marked."""

import json
from dataclasses import replace

import numpy as np
import pytest

from gof.capture.board_points import read_board_points
from gof.capture.decode import DecodeOptions, decode
from gof.capture.locate import BoardNotFound, project
from gof.capture.signals import read_signals
from gof.capture.template import BoardTemplate
from gof.commands.cli import main as gof
from gof.core.errors import DataFormatError
from gof.dataset import Dataset
from gof.footage.pictures import write_picture
from tests.capture.rendered_clips import errors
from tests.capture.synthetic import SyntheticShot, render
from tests.conftest import look_at, write_dataset

BOARD = BoardTemplate.load("gof_board")
SHOT = SyntheticShot(width=400, height=560, marker_px=42, centre=(0.48, 0.72), row_time=4.0)


def film(folder, shot, hand=True, frames=48):
    """Pictures, in which a hand covers half of the marker, or which end in its middle. Returns the folder."""
    folder.mkdir()
    corners = project(shot.homography(), np.array([[-0.1, -0.1], [1.1, -0.1], [1.1, 0.55], [-0.1, 0.55]]))
    (x0, y0), (x1, y1) = np.floor(corners.min(0)).astype(int), np.ceil(corners.max(0)).astype(int)
    for k, picture in enumerate(render(shot, BOARD, frames)):
        if hand:
            picture[max(y0, 0) : max(y1, 0), max(x0, 0) : max(x1, 0)] = 110
        else:
            picture = picture[: (y0 + y1) // 2]  # lines are read from the side: times stay as they are
        write_picture(folder / f"{k:03d}.png", picture[..., None].repeat(3, -1))
    return folder


def marks(shot, corners, bits, error_px=1.5, seed=0):
    """What a user marks, an entry of the file."""
    rng = np.random.default_rng(seed)
    led = {int(b): xy for b, xy in zip(BOARD.led_bit, BOARD.led_xy, strict=True)}
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])

    def pixel(xy):
        return (project(shot.homography(), np.array([xy]))[0] + rng.normal(0, error_px, 2)).tolist()

    return {"corners": {str(k): pixel(square[k]) for k in corners}, "leds": {str(b): pixel(led[b]) for b in bits}}


def points(folder, entry):
    (folder / "points.json").write_text(json.dumps({"cam": entry}))
    return read_board_points(folder / "points.json", BOARD, ["cam"])["cam"]


@pytest.mark.long
@pytest.mark.parametrize(
    "change, hand, corners, bits",
    [
        pytest.param({}, True, (2, 3), (0, 4, 9), id="a hand before half of the marker"),
        pytest.param({"yaw_deg": 25}, True, (2, 3), (0, 2, 12), id="and turned"),
        pytest.param({}, False, (2, 3), (0, 2, 4, 5), id="half below the picture's edge"),
        pytest.param({}, True, (), (0, 3, 6, 9, 12), id="by LEDs alone"),
    ],
)
def test_a_board_without_a_whole_marker_is_read_by_marked_points(tmp_path, change, hand, corners, bits):
    shot = replace(SHOT, **change)
    video = film(tmp_path / "cam", shot, hand)
    with pytest.raises(BoardNotFound, match="--board-points"):
        read_signals(video, BOARD)
    for seed in range(2):
        marked = points(tmp_path, marks(shot, corners, bits, seed=seed))
        times = decode(read_signals(video, BOARD, points=marked), BOARD, DecodeOptions())
        if len(times.count_candidates) > 1:  # LEDs below the edge: another camera settles which count it is
            assert not hand
            off = round((shot.times(48) - times.time_us).mean() / shot.period)
            assert off in times.count_candidates - times.count_candidates[0]
            times.shift_periods(off, shot.period)
        e = errors(times, shot.times(48), shot)
        assert e["fused_rms_us"] < 5 and times.row_time_us == pytest.approx(4.0, abs=0.05), e
        assert times.count_agreement == 1


def test_marks_that_fit_no_board_are_refused_by_name(tmp_path, capsys):
    video = film(tmp_path / "cam", SHOT, frames=3)
    good = marks(SHOT, (2, 3), (0, 4, 9))
    swapped = {
        "corners": good["corners"],
        "leds": {"0": good["leds"]["9"], "4": good["leds"]["0"], "9": good["leds"]["4"]},
    }
    with pytest.raises(DataFormatError, match=r"miss a flat board by up to \d+ px"):
        read_signals(video, BOARD, points=points(tmp_path, swapped))
    line = {"leds": {str(b): [10.0 * k, 20.0] for k, b in enumerate((0, 1, 2, 3))}}
    with pytest.raises(DataFormatError, match=r"one line|miss a flat board"):
        read_signals(video, BOARD, points=points(tmp_path, line))
    for entry, words in (
        ({"corners": {"4": [1, 2]}}, "no corner '4'"),
        ({"leds": {"99": [1, 2]}}, "no LED '99'"),
        ({"leds": {"1": [1, 2]}}, "1 points of the board are marked, 4 are needed"),
        ({"leds": {"1": [1]}}, "leds"),
        ([], "cam"),
    ):
        with pytest.raises(DataFormatError, match=words):
            points(tmp_path, entry)
    with pytest.raises(DataFormatError, match="no video is called 'cam'"):
        read_board_points(tmp_path / "points.json", BOARD, ["left"])
    (tmp_path / "points.json").write_text("[]")
    with pytest.raises(DataFormatError, match=r"must be \{camera"):
        read_board_points(tmp_path / "points.json", BOARD, ["cam"])
    ring = ["--board", "rocsync", "--board-points", str(tmp_path / "points.json")]
    assert gof(["capture", "sync", str(video), "--out", str(tmp_path / "o"), *ring]) != 0
    assert "a ring board" in capsys.readouterr().err


def test_annotate_takes_marked_points(tmp_path, capsys):
    """Whatever flickers on a board with half a marker is masked, and not much else: as on one with a whole marker."""
    whole = np.stack(list(render(SHOT, BOARD, 16)))
    videos = [film(tmp_path / "cam", SHOT, frames=16), tmp_path / "other"]
    videos[1].mkdir()
    for k, picture in enumerate(whole):
        write_picture(videos[1] / f"{k:03d}.png", picture[..., None].repeat(3, -1))
    cameras = [look_at(f"cam_{c}", (0.3 * c, -3, 1), (0, 0, 1), 400, 560, 500.0) for c in range(2)]
    dark = np.zeros((4, 2, 560, 400, 3))
    folder = write_dataset(tmp_path / "data", cameras, dark, dark[0], 0.0025 * np.arange(4))
    (tmp_path / "points.json").write_text(json.dumps({"cam": marks(SHOT, (2, 3), (0, 4, 9))}))
    command = ["capture", "annotate", str(folder), "--board", "gof_board", "--board-points"]
    command += [str(tmp_path / "points.json")]
    assert gof([*command, "--footage", *map(str, videos)]) == 0
    assert capsys.readouterr().out.count("board mask, ") == 2
    half, all_of_it = (Dataset.open(folder).board_weight(c) for c in range(2))
    assert half[np.ptp(whole.astype(np.int16), axis=0) > 30].max() < 0.05
    assert ((half < 0.5) & (all_of_it < 0.5)).sum() > 0.8 * ((half < 0.5) | (all_of_it < 0.5)).sum()
    assert gof(command) == 1 and "--footage" in capsys.readouterr().err
