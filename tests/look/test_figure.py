"""Figures for print: what stands where on the page, letters that stay letters, and tiles against what is known."""

import json
import re
import zlib
from dataclasses import replace

import cv2
import numpy as np
import pytest

from gof.commands.cli import main as gof
from gof.commands.figure_modalities import run_folder
from gof.core.colour import linear_to_srgb, srgb_to_linear
from gof.core.errors import GofError
from gof.core.gaussians import TransientGaussians
from gof.dataset import Dataset
from gof.evaluate.screen_motion import ScreenVelocity, sideways_velocity
from gof.look.comparison import Moment, comparison, fire_removal, largest_errors, subject
from gof.look.drawing import DPI
from gof.look.images import ramp
from gof.look.modalities import Modalities, Sources, modalities, training_frame
from gof.look.pages import flat, in_words, page_pictures
from gof.look.paper import GAP_IN, write_sheet
from gof.look.tiles import Bar, Box, Tile, Wheel, depth_tile
from gof.look.velocity import arrows
from gof.reconstruct import pipeline
from gof.reconstruct.run_inputs import recompute_inputs
from gof.reconstruct.settings import ReconstructionSettings
from gof.render import render
from tests.conftest import arc, look_at, random_gaussians, write_dataset
from tests.look.printed import texts
from tests.reconstruct.rising_flame import RISE, write_flame


def streams(pdf: bytes) -> bytes:
    """What the PDF's streams hold."""
    found = b""
    for data in re.findall(rb"stream\r?\n(.*?)endstream", pdf, re.DOTALL):
        try:
            found += zlib.decompressobj().decompress(data)
        except zlib.error:
            pass
    return found


# ---------------------------------------------------------------- the page


def test_boxes_arrows_and_outlines_lie_on_their_pixels(tmp_path):
    """A tile's pixel (x, y) is found where the page's inches say it is; edges of pixels are at whole numbers."""
    dark = np.zeros((96, 48, 3), np.uint8)
    white = dark.copy()
    white[24:72, 12:36] = 255
    outline = np.zeros((96, 48), bool)
    outline[24:72, 12:36] = True
    arrow = np.array([[[6.0, 90.0], [6.0, 60.0]]])
    tiles = [
        Tile(white),
        Tile(dark, boxes=(Box(12, 24, 24, 48),)),
        Tile(dark, outline=outline),
        Tile(dark, arrows=arrow),
    ]
    write_sheet(tmp_path / "a.png", [tiles], width_in=4.0, lettered=False)
    page = cv2.imread(str(tmp_path / "a.png")).astype(int).sum(-1) / 3
    tile_px, gap_px = (4.0 - 5 * GAP_IN) / 4 * DPI, GAP_IN * DPI

    def extent(number):
        """(left, top, right, bottom) of what is bright in a tile, in its own pixels."""
        left = gap_px + number * (tile_px + gap_px)
        y, x = np.nonzero(page[round(gap_px) : -round(gap_px), round(left) : round(left + tile_px)] > 100)
        return np.array([x.min(), y.min(), x.max() + 1, y.max() + 1]) * 48 / tile_px

    for number, room in ((0, 0.3), (1, 0.8), (2, 0.8)):
        np.testing.assert_allclose(extent(number), [12, 24, 36, 72], atol=room)
    left, top, right, bottom = extent(3)
    assert abs((left + right) / 2 - 6) < 0.5 and abs(top - 60) < 1 and abs(bottom - 90) < 1


def test_a_printed_page_has_letters_and_lines_and_the_pictures_own_pixels(tmp_path):
    rng = np.random.default_rng(0)
    image = rng.integers(0, 255, (20, 30, 3)).astype(np.uint8)
    bar = Bar(1.5, 6.0, "m", ramp(cv2.COLORMAP_VIRIDIS) / 255, log=True)
    tiles = [
        Tile(image, "depth & <time>", "45 %", bar),
        Tile(image, "$speed$", legend=Wheel(2.25, "m/s"), arrows=np.array([[[3.0, 3.0], [9.0, 9.0]]])),
    ]
    for name in ("a.pdf", "b.pdf", "a.svg", "b.svg"):
        write_sheet(tmp_path / name, [tiles])
    assert (tmp_path / "a.pdf").read_bytes() == (tmp_path / "b.pdf").read_bytes(), "no date in it"
    assert (tmp_path / "a.svg").read_bytes() == (tmp_path / "b.svg").read_bytes()
    said = texts((tmp_path / "a.svg").read_text())
    for words in ("(a) depth &amp; &lt;time&gt;", "(b) $speed$", "45 %", "1.5", "3", "6", "0 to 2.25 m/s"):
        assert words in said, (words, said)
    pdf = (tmp_path / "a.pdf").read_bytes()
    assert b"/FontFile2" in pdf and b"/Type3" not in pdf, "whole TrueType fonts, which publishers ask for"
    sizes = set(re.findall(rb"/Height (\d+)[^>]*?/Width (\d+)|/Width (\d+)[^>]*?/Height (\d+)", pdf))
    assert any(b"20" in size and b"30" in size for size in sizes), "the picture is not resampled"
    assert b"(a)" in streams(pdf) or b"Tj" in streams(pdf) or b"TJ" in streams(pdf), "text is text"


def test_long_titles_stay_over_their_own_tile(tmp_path):
    tile = Tile(np.zeros((10, 10, 3), np.uint8), "a title that is much too long for so narrow a picture")
    write_sheet(tmp_path / "a.png", [[tile, replace(tile, title="b")]], width_in=2.0)
    page = cv2.imread(str(tmp_path / "a.png")).astype(int).sum(-1) / 3
    gap = round((GAP_IN + (2.0 - 3 * GAP_IN) / 2) * DPI)
    assert page[:45, gap + 1 : gap + round(GAP_IN * DPI) - 1].min() > 250, "nothing is written between the tiles"


@pytest.mark.parametrize("name, said", [("a.eps", ".pdf, .svg, .png"), ("a", ".pdf")])
def test_other_kinds_of_files_are_refused(tmp_path, name, said):
    with pytest.raises(GofError, match=re.escape(said)):
        write_sheet(tmp_path / name, [[Tile(np.zeros((4, 4, 3), np.uint8))]])
    assert not list(tmp_path.iterdir())


def test_a_depth_tile_is_dark_where_nobody_knows_and_its_bar_has_the_ends():
    depth = np.array([[1.0, 2.0, 4.0, np.nan]])
    tile = depth_tile(depth, "d", 1.0, 4.0, "m")
    assert tile.image[0, 0, 0] > 240 and tile.image[0, 3].max() < 40
    assert tile.legend.log and (tile.legend.low, tile.legend.high) == (1.0, 4.0)
    np.testing.assert_allclose(tile.legend.colours[0] * 255, tile.image[0, 0], atol=1)
    np.testing.assert_allclose(tile.legend.colours[-1] * 255, tile.image[0, 2], atol=1)
    np.testing.assert_allclose(tile.legend.colours[128] * 255, tile.image[0, 1], atol=6, err_msg="2 is the middle")


def test_velocity_pictures_show_the_gas_and_not_the_light():
    camera = look_at("a", (0, -3, 1), (0, 0, 1))
    light = random_gaussians(3)
    light = replace(light, velocity=np.tile([0.0, 0, 1], (3, 1)), dynamic=np.ones(3, bool), t_sigma=np.full(3, np.inf))
    gas = replace(light, gas_velocity=np.tile([0.0, 0, 3], (3, 1)))
    for g, speed in ((light, 1.0), (gas, 3.0)):
        flow, alpha = sideways_velocity(g, camera, 0.0)
        seen = alpha > 0.05
        np.testing.assert_allclose(flow[seen], np.tile([0, -speed], (seen.sum(), 1)), atol=1e-3)
        steps = np.diff(arrows(ScreenVelocity(flow, alpha), 3.0), axis=1)[:, 0]
        assert len(steps) and (steps[:, 1] < 0).all(), "up in the picture is a smaller y"


# ---------------------------------------------------------------- modalities


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A column of light that rises at RISE, its dataset, and a short reconstruction by the pipeline's own stages."""
    folder = tmp_path_factory.mktemp("figure")
    write_flame(folder / "data", frames=6, dt=0.01)
    dataset = Dataset.open(folder / "data")
    choices = {"gaussians": 800, "iterations": 30, "voxels": 24, "longest_side": 64, "flow_prior": False}
    settings = ReconstructionSettings(dataset.identity(), **choices)
    pipeline.reconstruct(dataset, settings, folder / "run")
    return folder


@pytest.fixture(scope="module")
def shown(made) -> Modalities:
    dataset = Dataset.open(made / "data")
    return modalities(dataset, recompute_inputs(dataset, made / "run"), Sources(made / "run"), 1, 2)


def tile(shown: Modalities, title: str) -> Tile:
    return next(one for one in shown.tiles if one.title == title)


@pytest.mark.long
def test_all_modalities_of_a_run_are_there_or_missing_by_name(shown):
    titles = [one.title for one in shown.tiles]
    assert titles[:3] == ["picture (truth)", "background", "flame mask"]
    assert titles[-6:] == [
        "optical flow",
        "fused flow field",
        "seeds",
        "result",
        "velocity, result",
        "velocity, truth",
    ]
    assert "--depth" in shown.missing["monocular depth"] and "--depth" in shown.missing["depth, this frame"]


@pytest.mark.long
def test_modalities_show_what_is_known_of_the_flame(made, shown):
    dataset = Dataset.open(made / "data")
    np.testing.assert_allclose(tile(shown, "picture (truth)").image / 255, dataset.image(1, 2), atol=0.003)
    np.testing.assert_allclose(tile(shown, "background").image / 255, dataset.static(1), atol=0.003)
    mask = tile(shown, "flame mask").outline
    lit = np.abs(dataset.image(1, 2) - dataset.static(1)).max(-1)
    assert mask.shape == (64, 32), "at the size that the run has seen"
    assert cv2.resize(lit, (32, 64), interpolation=cv2.INTER_AREA)[mask].mean() > 3 * lit[lit < 0.3].mean()
    # The camera in the middle looks along +y: of RISE = (0.1, 0, 1.2) it sees all, up and a little to the right.
    truth = tile(shown, "velocity, truth")
    step = np.diff(truth.arrows, axis=1)[:, 0]
    assert len(step) > 10 and (step[:, 1] < 0).all()
    np.testing.assert_allclose(step[:, 0] / -step[:, 1], RISE[0] / RISE[2], atol=0.02)
    per_speed = 48 / 14 / truth.legend.longest  # px an arrow is long for each m/s
    off = np.abs(np.linalg.norm(step, axis=1) / per_speed / np.linalg.norm(RISE) - 1)
    assert np.quantile(off, 0.85) < 1e-3, "all but the few arrows at the edge of the grid of true velocities"
    assert tile(shown, "fused flow field").legend == tile(shown, "velocity, result").legend == truth.legend
    flow = tile(shown, "optical flow")
    px_per_s = 110.0 * 64 / 96 * np.linalg.norm(RISE) / 3.0  # focal length in px of that size, 3 m away
    assert flow.legend.longest == pytest.approx(px_per_s, rel=0.35) and flow.legend.unit == "px/s"


@pytest.mark.long
def test_the_results_tile_is_the_renderers_picture(made, shown):
    dataset = Dataset.open(made / "data")
    result = TransientGaussians.load(made / "run/result.npz")
    plate = cv2.imread(str(made / "run/plates/cam_1.png"), cv2.IMREAD_UNCHANGED)[..., ::-1] / 65535
    small = cv2.resize(dataset.static(1), plate.shape[1::-1], interpolation=cv2.INTER_AREA)
    behind = np.clip(dataset.static(1) + cv2.resize(plate - small, (48, 96), interpolation=cv2.INTER_LINEAR), 0, 1)
    drawn = render(result, dataset.cameras[1], 0.02, background=behind.astype(np.float32))["color"]
    np.testing.assert_allclose(tile(shown, "result").image, np.clip(drawn, 0, 1) * 255, atol=1.5)


@pytest.mark.long
def test_what_is_seen_again_is_what_the_run_saw(made):
    """The run has left pictures of its mask and flow; those of the second look are the same."""
    dataset = Dataset.open(made / "data")
    seen = recompute_inputs(dataset, made / "run")
    left = cv2.imread(str(made / "run/stages/1_masks.png"))[..., ::-1] / 255
    f = len(seen.observation.frames) // 2
    again = seen.observation.image[f] * (0.25 + 0.75 * seen.observation.mask[f][..., None])
    np.testing.assert_allclose(left, np.hstack(again), atol=0.003)


@pytest.mark.long
def test_command_writes_the_figure_of_a_run_and_says_what_is_missing(made, capsys):
    asked = ["figure", "modalities", str(made / "run"), "--dataset", str(made / "data"), "--time", "0.038"]
    assert gof([*asked, "--out", str(made / "m.svg"), str(made / "m.pdf"), "--camera", "cam_2"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "cam_2, frame 3 at" in said, "frame 4 is nearest, and held out"
    assert "left out: monocular depth" in said
    assert (made / "m.pdf").stat().st_size > 10_000
    words = texts((made / "m.svg").read_text())
    assert "(a) picture (truth)" in words and "hue: direction" in words
    assert any(re.fullmatch(r"0 to [\d.]+ m/s", word) for word in words)


@pytest.mark.long
def test_command_refuses_other_datasets_and_folders(made, tmp_path, capsys):
    other = write_flame(tmp_path / "other", frames=5, dt=0.01)
    assert gof(["figure", "modalities", str(made / "run"), "--dataset", str(other)]) == 1
    assert "was made of the dataset" in capsys.readouterr().err
    assert gof(["figure", "modalities", str(tmp_path), "--dataset", str(other)]) == 1
    assert "gof reconstruct" in capsys.readouterr().err
    assert gof(["figure", "nothing"]) == 2


def test_the_frame_is_a_training_frame(made):
    dataset = Dataset.open(made / "data")
    assert training_frame(dataset, 0, 0.04) in (3, 5), "frame 4 is held out"
    assert training_frame(dataset, 0, None) in dataset.train_frames


# ---------------------------------------------------------------- results side by side


@pytest.fixture
def two(tmp_path):
    """A dataset whose held-out frame is bright in one corner; a result that knows, and one that knows of nothing."""
    cameras, times = arc(3), [0.0, 0.1, 0.2]
    plates = np.full((3, 64, 36, 3), 0.2)
    images = np.repeat(plates[None], 3, 0).copy()
    images[1, :, 6:16, 20:30] = (0.9, 0.5, 0.2)
    masks = np.zeros((3, 3, 64, 36))
    masks[1, :, 6:16, 20:30] = 1
    write_dataset(tmp_path / "data", cameras, images, plates, times, masks=masks, test_frames=(1,))
    nothing = replace(random_gaussians(2), opacity=np.zeros(2), dynamic=np.ones(2, bool))
    nothing.save(tmp_path / "nothing.npz")
    return tmp_path


def test_the_largest_errors_are_found_where_they_are(two):
    rng = np.random.default_rng(0)
    recorded = rng.random((90, 60, 3))
    drawn = [recorded.copy(), recorded.copy()]
    drawn[0][60:80, 5:25] += 0.5
    drawn[1][10:30, 35:55] += 0.3
    low, high = sorted(largest_errors(drawn, recorded, 2), key=lambda box: -box.y)
    for box, (top, left) in ((low, (60, 5)), (high, (10, 35))):
        assert box.width == box.height == 20 and (abs(box.y - top), abs(box.x - left)) == (0, 0)
    many = largest_errors(drawn, recorded, 4)
    inside = np.zeros((90, 60), int)
    for box in many:
        inside[box.y : box.y + box.height, box.x : box.x + box.width] += 1
    assert len(many) == 4 and inside.max() == 1, "none overlap"


def test_a_result_without_flame_is_its_plate_and_its_decibels_are_those_of_the_plate(two):
    """flame: (0.9, 0.5, 0.2) over 0.2 in 8 bits, whose PSNR is a closed form."""
    moment = Moment(Dataset.open(two / "data"), 1, 1)
    nothing = TransientGaussians.load(two / "nothing.npz")
    subjects = [subject("ours", nothing, "gof", two / "nothing.npz", moment)]
    subjects.append(subject("theirs", nothing, "yang", two / "nothing.npz", moment))
    rows = comparison(subjects, moment, 1)
    assert [one and one.title for one in rows[0]] == ["filmed", "ours", "theirs"]
    steps = np.array([230, 128, 51]) - 51  # of 255: 0.9, 0.5, 0.2 as PNG holds them
    expected = -10 * np.log10(np.mean((steps / 255) ** 2))
    assert rows[0][1].note == rows[2][0].note == f"flame {expected:.2f} dB"
    assert rows[0][2].image.max() == 0, "another method's Gaussians stand before nothing"
    box = rows[0][0].boxes[0]
    assert box.x <= 20 and box.x + box.width >= 30 and rows[1][0].frame == 0
    np.testing.assert_array_equal(rows[1][1].image, rows[0][1].image[box.y : box.y + 12, box.x : box.x + 12])
    bar = rows[2][1].legend
    assert bar.high == 1.0, "theirs is off by 0.53 in the flame: 0.5 does not hold it"
    for place, error in (((0, 0), 0.0), ((10, 25), np.mean(steps) / 255)):
        np.testing.assert_allclose(rows[2][1].image[place], 255 * bar.colours[round(255 * error)], atol=4)
    assert len(rows) == 3, "nothing moves, so there is no row of velocities"


def test_the_sync_boards_lamps_are_no_error(two):
    """A lamp that shines in every frame but in no plate, in the corner that the flame is not in."""
    folder = two / "data"
    file = next((folder / "cameras/cam_1").rglob("*1.png"))
    picture = cv2.imread(str(file))
    picture[50:60, 2:12] = 255
    cv2.imwrite(str(file), picture)
    meta = json.loads((folder / "dataset.json").read_text())
    meta["cameras"][1]["board_mask"] = "cameras/cam_1/board_mask.png"
    (folder / "dataset.json").write_text(json.dumps(meta))

    def rows_with(board):
        cv2.imwrite(str(folder / meta["cameras"][1]["board_mask"]), np.uint8(255 * board))
        moment = Moment(Dataset.open(folder), 1, 1)
        nothing = TransientGaussians.load(two / "nothing.npz")
        return comparison([subject("ours", nothing, "gof", two / "nothing.npz", moment)], moment, 1)

    board = np.zeros((64, 36))
    lamp = rows_with(board)
    assert lamp[0][0].boxes[0].y > 40, "the lamp is the largest error there is"
    board[46:64, 0:16] = 1
    flame = rows_with(board)
    assert flame[0][0].boxes[0].y < 20, "no longer"
    assert flame[2][1].legend.high < lamp[2][1].legend.high
    dark = flame[2][1].legend.colours[0]
    np.testing.assert_allclose(flame[2][1].image[55, 6], 255 * dark, atol=4)
    np.testing.assert_array_equal(flame[0][0].image, lamp[0][0].image)


@pytest.mark.long
def test_true_and_drawn_velocities_have_one_scale(made):
    dataset = Dataset.open(made / "data")
    moment = Moment(dataset, 1, 4)
    result = TransientGaussians.load(made / "run/result.npz")
    rows = comparison([subject("ours", result, "gof", made / "run/result.npz", moment)], moment, 0)
    true, ours = rows[-1]
    assert true.legend == ours.legend and true.legend.longest == pytest.approx(np.linalg.norm(RISE), rel=0.3)


def test_command_compares_what_was_scored_as_it_was_scored(two, capsys):
    assert gof(["evaluate", str(two / "nothing.npz"), "--dataset", str(two / "data"), "--out", str(two / "board")]) == 0
    flame = str(two / "board")
    asked = ["figure", "compare", f"scored={flame}", f"file={two / 'nothing.npz'}"]
    files = ["--out", str(two / "c.svg"), str(two / "c.png"), "--json", str(two / "c.json")]
    assert gof([*asked, "--dataset", str(two / "data"), "--parts", "20,6,8,12", *files]) == 0
    assert "frame 1 at 0.1000 s, held out" in capsys.readouterr().out
    said = texts((two / "c.svg").read_text())
    assert "scored" in said and "file" in said and "error: background alone" in said
    tiles = json.loads((two / "c.json").read_text())["tiles"]
    assert tiles[0][1]["note"] == tiles[0][2]["note"] and tiles[0][0]["boxes"] == [[20, 6, 8, 12]]
    board = json.loads((two / "board/scores.json").read_text())
    mine = next(p for p in board["images"]["pictures"] if p["camera"] == "cam_1")
    assert tiles[0][1]["note"] == f"flame {mine['psnr_flame']:.2f} dB", "the figure of gof evaluate for this picture"


@pytest.mark.parametrize(
    "words, said",
    [
        (["--names", "a", "b"], "--names"),
        (["--parts", "30,0,20,10"], "leaves the picture"),
        (["--parts", "0,0,0,10"], "1 or more"),
        (["--parts", "2", "30,0,2,1"], "60,120,40,40"),
        (["--parts", "9"], "--parts 9"),
        (["--camera", "nobody"], "the dataset has"),
        (["--out", "a.jpg"], ".pdf, .svg, .png"),
    ],
)
def test_command_compare_refuses_by_name(two, words, said, capsys):
    assert gof(["figure", "compare", str(two / "nothing.npz"), "--dataset", str(two / "data"), *words]) != 0
    assert said in capsys.readouterr().err


# ---------------------------------------------------------------- fire removal


def test_removal_shows_the_fire_alone_and_what_is_left_elsewhere(two):
    dataset = Dataset.open(two / "data")
    ((recorded, plate, fire, difference),) = fire_removal(dataset, 1, [0])
    assert (recorded.title, plate.title) == ("filmed, cam_0", "background"), "it has neither a spec nor a true velocity"
    linear = srgb_to_linear(np.array([230, 128, 51]) / 255) - srgb_to_linear(np.full(3, 51 / 255))
    np.testing.assert_allclose(fire.image[10, 25] / 255, linear_to_srgb(linear), atol=0.003)
    assert fire.image[40, 10].max() == 0 and difference.note == "mean 0.0000 outside the flame"
    assert difference.outline[10, 25] and not difference.outline[40, 10]


@pytest.mark.long
def test_removal_with_a_result_shows_its_plate_too(made, capsys):
    asked = ["figure", "removal", str(made / "data"), "--result", str(made / "run"), "--camera", "cam_0"]
    assert gof([*asked, "--out", str(made / "r.svg"), "--json", str(made / "r.json")]) == 0
    titles = [one["title"] for one in json.loads((made / "r.json").read_text())["tiles"][0]]
    assert titles[2] == "background of the result" and titles[-1] == "difference"


def test_removal_refuses_a_result_that_is_not_there_and_notes_one_without_plates(two, tmp_path, capsys):
    (two / "empty").mkdir()
    asked = ["figure", "removal", str(two / "data"), "--out", str(tmp_path / "r.svg"), "--result"]
    for wrong, why in (("nothing_at_all", "no such file or folder"), ("empty", "holds no result of 'gof reconstruct'")):
        assert gof([*asked, str(two / wrong)]) == 1
        assert f"{wrong}: {why}" in capsys.readouterr().err and not (tmp_path / "r.svg").exists()
    assert gof([*asked, str(two / "nothing.npz"), "--json", str(tmp_path / "r.json")]) == 0
    (note,) = json.loads((tmp_path / "r.json").read_text())["notes"]
    assert "no plates of its own" in note and "note:" in capsys.readouterr().out


def test_a_run_is_named_by_its_folder_its_result_or_its_demo(tmp_path):
    run = tmp_path / "demo/reconstruct"
    run.mkdir(parents=True)
    for name in ("settings.json", "result.npz"):
        (run / name).touch()
    assert {run_folder(path) for path in (run, run / "result.npz", tmp_path / "demo")} == {run}


# ---------------------------------------------------------------- on pages


def test_pages_have_the_tiles_with_all_that_is_drawn_over_them():
    image = np.zeros((40, 30, 3), np.uint8)
    tile = Tile(image, "t", "n", Wheel(2.0, "m/s"), np.array([[[5.0, 35.0], [5.0, 20.0]]]), (Box(10, 10, 12, 8),))
    drawn = flat(tile).astype(int)
    factor = drawn.shape[1] // 30
    assert drawn[30 * factor, 5 * factor].min() > 150, "the arrow"
    cyan = (drawn[..., 1] > 150) & (drawn[..., 0] < 100)
    y, x = np.nonzero(cyan)
    np.testing.assert_allclose([x.min(), y.min(), x.max(), y.max()], np.array([10, 10, 22, 18]) * factor, atol=factor)
    assert in_words(tile) == "n; full brightness: 2 m/s"
    assert flat(Tile(np.zeros((2000, 1000, 3), np.uint8))).shape == (960, 480, 3)
    (line,) = page_pictures([[None, tile]])
    assert line[0] is None and line[1].uri.startswith("data:image/webp;base64,")


# ---------------------------------------------------------------- charts


def test_the_leaderboard_prints_its_charts(two, capsys):
    board = two / "board"
    assert gof(["evaluate", str(two / "nothing.npz"), "--dataset", str(two / "data"), "--out", str(board)]) == 0
    (board / "method.json").write_text(json.dumps({"name": "none", "train_seconds": 12}))
    assert gof(["leaderboard", str(board), "--out", str(two / "lb"), "--figure", "pdf", "svg"]) == 0
    files = sorted(path.name for path in (two / "lb").glob("accuracy_*"))
    assert files == [f"accuracy_{score}_flame.{kind}" for score in ("psnr", "ssim") for kind in ("pdf", "svg")]
