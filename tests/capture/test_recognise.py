"""Which board the footage shows: recognised, or refused. Truth: what was rendered, with known times; the published
clips, which show the board of the paper."""

import json
from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest

from gof.capture.recognise import recognise
from gof.capture.ring_board import RingBoard
from gof.capture.template import BoardTemplate
from gof.commands.cli import main as gof
from gof.footage.videos import stored_frames
from tests.capture.synthetic import RingShot, SyntheticShot, render, render_ring, write_video

pytestmark = pytest.mark.long

FRAMES, LATER_US = 72, 703.0
STRIP_BOARDS = ("gof_board", "paper_rig")
SHOTS = (
    SyntheticShot(width=330, height=440, marker_px=38, centre=(0.5, 0.7), row_time=6.0, fps=240, seed=1),
    SyntheticShot(
        width=330, height=440, marker_px=30, centre=(0.46, 0.72), roll_deg=175, row_time=6.0, fps=240, seed=2
    ),
)


def film(folder, board, start_us, shots=SHOTS, template=None):
    """Two cameras' videos of a board, the second LATER_US after the first; their names start with the board's."""
    template = template or BoardTemplate.load(board)
    videos = []
    for k, shot in enumerate(shots):
        path = folder / f"{board}_{k}.mp4"
        if not path.exists():
            write_video(path, render(replace(shot, start=start_us + k * LATER_US), template, FRAMES))
        videos.append(str(path))
    return videos


def start_times_us(out):
    cameras = json.loads((out / "times.json").read_text())["cameras"]
    return [1e6 * camera["times"]["frames"][0]["time_s"] for camera in cameras]


@pytest.fixture(scope="module", params=[1_200_000.0, 80_234_567.0], ids=["1 s", "80 s"])
def filmed(request, tmp_path_factory):
    """(start in us, videos by board): both boards, that long after they were switched on."""
    folder = tmp_path_factory.mktemp("film")
    return request.param, {board: film(folder, board, request.param) for board in STRIP_BOARDS}


@pytest.mark.parametrize("board", STRIP_BOARDS)
def test_the_board_is_recognised_and_the_times_are_true(filmed, board, tmp_path, capsys):
    start, videos = filmed
    assert gof(["capture", "sync", *videos[board], "--out", str(tmp_path), "--no-report"]) == 0
    np.testing.assert_allclose(start_times_us(tmp_path), [start, start + LATER_US], atol=8)
    assert f"board: {board}, recognised" in capsys.readouterr().out
    assert json.loads((tmp_path / "times.json").read_text())["template"] == board


@pytest.mark.parametrize("board", STRIP_BOARDS)
@pytest.mark.parametrize("forced", [*STRIP_BOARDS, "rocsync"])
def test_a_wrong_board_is_refused(filmed, board, forced, tmp_path, capsys):
    _, videos = filmed
    status = gof(["capture", "sync", *videos[board], "--out", str(tmp_path), "--no-report", "--board", forced])
    said = capsys.readouterr().err
    assert status == (0 if forced == board else 1)
    assert (tmp_path / "times.json").exists() == (forced == board)
    assert forced == board or (f"the footage shows board '{board}'" in said and "marker sides beside" in said)


def test_every_command_recognises_and_refuses(filmed, tiny_dataset, tmp_path, capsys):
    _, videos = filmed
    ingest = ["ingest", *videos["gof_board"], "--times", "240", "--fov", "60", "--out", str(tmp_path / "data")]
    assert gof([*ingest, "--board", "paper_rig"]) == 1
    assert "the footage shows board 'gof_board'" in capsys.readouterr().err
    annotate = ["capture", "annotate", str(tiny_dataset), "--footage", *videos["paper_rig"]]
    assert gof([*annotate, "--board", "gof_board"]) == 1
    assert "the footage shows board 'paper_rig'" in capsys.readouterr().err


def test_the_old_name_of_the_option_still_works(tmp_path, capsys):
    for name, option in (("a", ["--template", "paper_rig"]), ("b", ["--template=paper_rig"])):
        assert gof(["capture", "draw", "--out", str(tmp_path / f"{name}.svg"), *option]) == 0
        said = capsys.readouterr()
        assert "--template is now --board" in said.err and "board 'paper_rig'" in said.out
    assert gof(["capture", "draw", "--out", str(tmp_path / "c.svg"), "--board", "gof_board"]) == 0
    assert "--template" not in capsys.readouterr().err


def test_boards_that_are_mixed_up(tmp_path, capsys):
    """Another board per camera; one board that was restarted between two cameras' films."""
    (tmp_path / "later").mkdir()
    own, papers = film(tmp_path, "gof_board", 1.2e6), film(tmp_path, "paper_rig", 1.2e6)
    out = tmp_path / "out"
    assert gof(["capture", "sync", own[0], papers[1], "--out", str(out)]) == 1
    assert "show different boards (gof_board_0 gof_board, paper_rig_1 paper_rig)" in capsys.readouterr().err
    later = film(tmp_path / "later", "gof_board", 80.2e6)
    assert gof(["capture", "sync", own[0], later[1], "--out", str(out)]) == 1
    said = capsys.readouterr().err
    assert "did not film at the same time (gof_board_0 1.200 to 1.496 s, gof_board_1 80.201 to 80.497 s)" in said
    assert said.count("did not film") == 1 and not (out / "times.json").exists()


def test_a_board_of_ones_own_is_taken_by_its_file_and_refused_where_it_is_not(tmp_path, capsys):
    """LEDs or strips in another order: their places are right, the code is not. LEDs elsewhere: no own board fits."""
    content = json.loads((files("gof.capture") / "gof_board.json").read_text())
    (tmp_path / "copy.json").write_text(json.dumps(content | {"name": "copy"}))
    swapped = [led | {"bit": {4: 13, 13: 4}.get(led["bit"], led["bit"])} for led in content["leds"]]
    (tmp_path / "swapped.json").write_text(json.dumps(content | {"name": "swapped", "leds": swapped}))
    moved = [led | {"xy": [1.25 * (x - 0.5) + 0.5 for x in led["xy"]]} for led in content["leds"]]
    (tmp_path / "moved.json").write_text(json.dumps(content | {"name": "moved", "leds": moved}))
    turned = [strip | {"slot": (strip["slot"] + 1) % 5} for strip in content["strips"]]
    (tmp_path / "turned.json").write_text(json.dumps(content | {"name": "turned", "strips": turned}))
    videos = film(tmp_path, "gof_board", 80.2e6)
    out = tmp_path / "out"
    sync = ["capture", "sync", *videos, "--out", str(out), "--no-report", "--overwrite", "--board"]
    assert gof([*sync, str(tmp_path / "copy.json")]) == 0
    np.testing.assert_allclose(start_times_us(out), [80.2e6, 80.2e6 + LATER_US], atol=8)
    (out / "times.json").unlink()
    for name, why in (
        ("swapped", "no count of board 'swapped' explains its LEDs"),
        ("moved", "shows board 'gof_board'"),
        ("turned", "us or more after the strips say so"),
    ):
        assert gof([*sync, str(tmp_path / f"{name}.json")]) == 1
        assert why in capsys.readouterr().err and not (out / "times.json").exists()
    (tmp_path / "own").mkdir()
    own = film(tmp_path / "own", "moved", 80.2e6, template=BoardTemplate.load(tmp_path / "moved.json"))
    sync = ["capture", "sync", *own, "--out", str(out), "--no-report"]
    assert gof(sync) == 1
    assert "which board it belongs to" in capsys.readouterr().err
    assert gof([*sync, "--board", str(tmp_path / "moved.json")]) == 0
    np.testing.assert_allclose(start_times_us(out), [80.2e6, 80.2e6 + LATER_US], atol=8)


def test_a_board_without_its_highest_led(tmp_path, capsys):
    """A classic ESP32 has no pin for Gray bit 14: after 65 s its place stays dark where it should shine."""
    whole = BoardTemplate.load("gof_board")
    lit = whole.led_bit != 14
    videos = film(
        tmp_path, "esp32", 80.2e6, template=replace(whole, led_xy=whole.led_xy[lit], led_bit=whole.led_bit[lit])
    )
    assert gof(["capture", "sync", *videos, "--out", str(tmp_path / "out"), "--no-report"]) == 0
    np.testing.assert_allclose(start_times_us(tmp_path / "out"), [80.2e6, 80.2e6 + LATER_US], atol=8)
    assert "the LED of Gray bit 14 stays dark" in capsys.readouterr().out


def test_cameras_on_both_sides_of_the_counters_turn(tmp_path):
    """The counter begins anew after 2^15 periods of 4 ms; one camera starts 20 ms before, the other 20 ms after."""
    turn = 2**15 * 4000.0
    template, videos = BoardTemplate.load("gof_board"), []
    for k, start in enumerate((turn - 20_000, turn + 20_000)):
        videos.append(str(tmp_path / f"cam_{k}.mp4"))
        write_video(tmp_path / f"cam_{k}.mp4", render(replace(SHOTS[k], start=start), template, FRAMES))
    assert gof(["capture", "sync", *videos, "--out", str(tmp_path / "out"), "--no-report"]) == 0
    first, second = start_times_us(tmp_path / "out")
    assert second - first == pytest.approx(40_000, abs=8)


def test_a_ring_board_is_recognised(tmp_path):
    board = RingBoard.load("rocsync")
    camera = SyntheticShot(300, 260, 20.0, "down", 8000.0, 29.97, 3.2e6, 60.0, 0.0, 0.0, (0.5, 0.5), 0.8, 2.0, 1.5)
    for k in range(2):
        shot = RingShot(replace(camera, seed=k, start=camera.start + k * 5003.0))
        write_video(tmp_path / f"cam_{k}.avi", render_ring(shot, board, 40), "FFV1")
    videos = [str(tmp_path / f"cam_{k}.avi") for k in range(2)]
    assert gof(["capture", "sync", *videos, "--out", str(tmp_path / "out"), "--no-report"]) == 0
    np.testing.assert_allclose(start_times_us(tmp_path / "out"), [3.2e6, 3.2e6 + 5003.0], atol=100)
    assert gof(["capture", "sync", *videos, "--out", str(tmp_path / "no"), "--board", "gof_board"]) == 1


def test_no_board_is_said_once_with_the_way_out(tmp_path, capsys):
    rng = np.random.default_rng(0)
    for k in range(3):
        pictures = (rng.integers(0, 255, (120, 160), np.uint8) for _ in range(12))
        write_video(tmp_path / f"cam_{k}.mp4", pictures)
    videos = [str(tmp_path / f"cam_{k}.mp4") for k in range(3)]
    for board in ([], ["--board", "gof_board"]):
        assert gof(["capture", "sync", *videos, "--out", str(tmp_path / "out"), *board]) == 1
        said = capsys.readouterr().err
        assert said.count("cam_0, cam_1, cam_2") == 1 and said.count("whole, lit") == 1
        assert "--times 240 --start 0 7 0" in said


@pytest.mark.parametrize("scene", ["capture_03/scene_0004", "capture_04/scene_0010", "capture_05/scene_0006"])
def test_the_published_clips_show_the_papers_board(clips, scene):
    for k in range(3):
        assert recognise("auto", {"cam": stored_frames(clips / scene / f"cam_{k}.mp4")}).name == "paper_rig"
