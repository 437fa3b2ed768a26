"""Films: decoded again and held against `gof.render`; stopped and gone on; what is behind the flame; refusals."""

import json
import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest
from PIL import Image

from gof.commands.cli import main as gof
from gof.commands.video import FilmStyle, _made_of
from gof.core.datum import Datum
from gof.core.errors import GofError
from gof.core.gaussians import TransientGaussians
from gof.core.trajectory import Trajectory
from gof.evaluate.screen_motion import sideways_velocity
from gof.look.film import FilmOptions, make_film
from gof.look.panels import Scales, Subject, depth_colours, draw_panel, error_colours, measure_scales, picture, stamp
from gof.look.path import Shot, orbit, shots
from gof.look.player.opened import open_moving
from gof.render import render
from tests.conftest import arc, look_at, write_dataset

SCALES = Scales(2.0, 1.0, 4.0)


def one(position=(0.0, 0.0, 1.0), velocity=(0.0, 0.0, 0.0), scale=0.3, opacity=0.95, dynamic=True, color=(1, 0.5, 0)):
    return TransientGaussians(
        position=[position],
        velocity=[velocity],
        t_mu=[0.0],
        t_sigma=[np.inf],
        scale=[[scale] * 3],
        rotation=[[1, 0, 0, 0]],
        opacity=[opacity],
        color=[color],
        dynamic=[dynamic],
    )


def flame(n=40) -> TransientGaussians:
    """Soft and slow enough for a video codec to keep."""
    rng = np.random.default_rng(3)
    return TransientGaussians(
        position=rng.normal([0, 0, 1], [0.15, 0.15, 0.3], (n, 3)),
        velocity=rng.normal([0, 0, 1], 0.2, (n, 3)),
        t_mu=rng.uniform(0, 0.2, n),
        t_sigma=np.full(n, 0.2),
        scale=np.full((n, 3), 0.12),
        rotation=np.tile([1.0, 0, 0, 0], (n, 1)),
        opacity=np.full(n, 0.5),
        color=rng.uniform([0.8, 0.3, 0.0], [1.0, 0.6, 0.2], (n, 3)),
        dynamic=np.ones(n, bool),
    )


def psnr(a, b) -> float:
    return float(10 * np.log10(255**2 / np.mean((a.astype(float) - b.astype(float)) ** 2)))


def decoded(path) -> list[np.ndarray]:
    """The frames of a film by another reader than the one under test."""
    if path.suffix == ".webp":
        with Image.open(path) as film:
            frames = []
            for k in range(film.n_frames):
                film.seek(k)
                frames.append(np.asarray(film.convert("RGB")))
            return frames
    video, frames = cv2.VideoCapture(str(path)), []
    while True:
        there, frame = video.read()
        if not there:
            return frames
        frames.append(frame[..., ::-1])


# ---------------------------------------------------------------- panels


@pytest.mark.parametrize("distance", [2.0, 8.0])
def test_velocity_across_the_view_is_in_m_per_s_from_any_distance(distance):
    camera = look_at("a", (0, -distance, 1), (0, 0, 1))
    right_and_up = one(velocity=(2.0, 0.7, 0.5))  # 0.7 m/s away from the camera: not seen in a picture
    flow, alpha = sideways_velocity(right_and_up, camera, 0.0)
    np.testing.assert_allclose(flow[alpha > 0.01], np.tile([2.0, -0.5], (np.count_nonzero(alpha > 0.01), 1)), atol=1e-4)


def test_depth_is_yellow_near_violet_far_and_dark_where_nothing_is():
    solid, nothing = np.ones((1, 3)), np.zeros((1, 3))
    near, middle, far = depth_colours(np.array([[1.0, 2.0, 4.0]]), solid, SCALES)[0].astype(int)
    assert near[0] > 240 and near[1] > 220 and near[2] < 60
    assert far[2] > far[1] and far[0] < 90
    assert middle[1] > middle[0] and middle[1] > middle[2], "the middle of log depth is green"
    assert depth_colours(np.zeros((1, 3)), nothing, SCALES).max() < 40


def test_scales_are_those_of_the_clip():
    shot = Shot(look_at("a", (0, -3, 1), (0, 0, 1)), 0.0)
    scales = measure_scales([Subject("a", one(velocity=(1.5, 0, 0), scale=0.05))], [shot])
    assert scales.speed == pytest.approx(1.5, rel=1e-3) and scales.near == pytest.approx(3.0, rel=0.02)
    still = measure_scales([Subject("a", one(opacity=0.0))], [shot])
    assert np.isfinite([still.speed, still.near, still.far]).all() and still.near < still.far


def test_reduced_shows_smaller_gaussians_and_no_plate():
    shot = Shot(look_at("a", (0, -3, 1), (0, 0, 1)), 0.0)
    subject = Subject("a", one(), plate=np.full((64, 36, 3), 0.5, np.float32))
    whole, small = (draw_panel(kind, subject, shot, SCALES, 0.25).astype(int) for kind in ("rgb", "reduced"))
    assert small[0, 0].max() == 0 and whole[0, 0].min() > 100
    assert (
        0 < (small.sum(-1) > 100).sum() < 0.3 * (draw_panel("reduced", subject, shot, SCALES, 1.0).sum(-1) > 100).sum()
    )


def test_a_still_scene_stands_behind_and_before_the_flame():
    shot = Shot(look_at("a", (0, -3, 1), (0, 0, 1)), 0.0)
    red, blue = one(color=(1, 0, 0), scale=0.1), {"color": (0, 0, 1), "dynamic": False, "scale": 0.1}
    behind = picture(Subject("a", red, scene=one((0, 1, 1), **blue)), shot)[32, 18]
    before = picture(Subject("a", red, scene=one((0, -1, 1), **blue)), shot)[32, 18]
    assert behind[0] > 0.8 > 0.2 > behind[2] and before[2] > 0.8 > 0.2 > before[0]
    harmonics = replace(red, color=np.zeros((1, 4, 3)))
    assert np.isfinite(picture(Subject("a", harmonics, scene=one((0, 1, 1), **blue)), shot)).all()


def test_a_result_sampled_in_time_is_shown_too_and_holds_its_ends():
    g = one()
    path = np.array([[[0.0, 0, 1]], [[0.2, 0, 1]]])
    sampled = Trajectory(
        np.array([0.0, 0.1]),
        path,
        scale=g.scale,
        rotation=g.rotation,
        opacity=np.full((2, 1), 0.9),
        color=g.color,
        dynamic=g.dynamic,
    )
    camera = look_at("a", (0, -3, 1), (0, 0, 1))
    ends = [picture(Subject("a", sampled), Shot(camera, t)) for t in (0.1, 0.2)]
    np.testing.assert_array_equal(*ends)


# ---------------------------------------------------------------- films


@pytest.mark.parametrize("suffix, least", [(".webm", 36), (".mp4", 36), (".webp", 33)])
def test_the_films_frames_are_those_of_the_renderer(tmp_path, suffix, least):
    camera, g = look_at("a", (0, -3, 1), (0, 0, 1), width=96, height=128, focal_px=150), flame()
    at = shots(orbit(camera, np.array([0, 0, 1.0]), 360), np.linspace(0, 0.2, 6), np.arange(6) / 6)
    film = make_film(tmp_path / f"a{suffix}", [Subject("a", g)], at, FilmOptions(("rgb", "reduced")), "made of")
    frames = decoded(film.path)
    assert len(frames) == 6 and film.size == frames[0].shape[1::-1]
    clear = slice(16, 112)  # no words there
    for shot, frame in zip(at, frames, strict=True):
        drawn = np.clip(render(g, shot.camera, shot.time_s)["color"], 0, 1) * 255
        assert psnr(frame[clear, :96], drawn[clear]) > least
    assert psnr(frames[0][clear, :96], frames[3][clear, :96]) < 30, "another frame is another picture"
    assert not list(tmp_path.glob("*.frames"))


@pytest.mark.parametrize("width", [120, 200, 2000])
def test_words_on_a_narrow_film_are_not_cut_off(width):
    """Nothing is written within half a letter of the right edge; a narrow page has more lines."""
    words = "123.7 ms, 115\N{DEGREE SIGN} from the nearest camera: a guess"
    written = stamp(np.full((355, width, 3), 90, np.uint8), words) != 90
    rows = np.flatnonzero(written.any((1, 2)))
    assert written.any() and not written[:, -4:].any()
    assert (355 - rows.min() < 28) == (width == 2000)


def test_a_stopped_film_goes_on_and_is_the_same(tmp_path):
    camera = look_at("a", (0, -3, 1), (0, 0, 1))
    at = shots(orbit(camera, np.array([0, 0, 1.0]), 360), np.zeros(5), np.arange(5) / 5)
    arguments = [Subject("a", flame())], at, FilmOptions(("rgb",), keep_frames=True), "made of"

    def stop(done, total):
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make_film(tmp_path / "a.webm", *arguments, progress=stop)
    assert not (tmp_path / "a.webm").exists()
    other = tmp_path / "a.webm.frames" / "mine.png"
    other.write_bytes(b"mine")
    film = make_film(tmp_path / "a.webm", *arguments)
    whole = make_film(tmp_path / "b.webm", *arguments)
    assert (film.found, whole.found) == (3, 0)
    kept = [sorted(tmp_path.glob(f"{name}.webm.frames/*_*.png")) for name in "ab"]
    assert [file.read_bytes() for file in kept[0]] == [file.read_bytes() for file in kept[1]] and len(kept[0]) == 5
    changed = [Subject("a", flame())], at, FilmOptions(("reduced",)), "made of"
    assert make_film(tmp_path / "a.webm", *changed).found == 0, "another film's frames are not taken for this one's"
    assert [file.name for file in other.parent.iterdir()] == ["mine.png"], "ours are gone, and only ours"


def test_a_file_that_is_no_film_is_refused_before_any_work(tmp_path):
    with pytest.raises(GofError, match="webm"):
        make_film(tmp_path / "a.avi", [], [], FilmOptions(), "")
    assert not list(tmp_path.iterdir())


# ---------------------------------------------------------------- the command


@pytest.fixture
def made(tmp_path):
    """A dataset and a result in a folder of their own."""
    cameras, times = arc(3), [0.0, 0.1, 0.2]
    images = np.stack([np.full((3, 64, 36, 3), 0.1 + 0.2 * k) for k in range(3)])
    write_dataset(tmp_path / "data", cameras, images, np.full((3, 64, 36, 3), 0.25), times)
    flame().save(tmp_path / "fire.npz")
    return tmp_path


def film_of(made, *words) -> tuple[list[np.ndarray], dict]:
    asked = ["video", str(made / "fire.npz"), "--dataset", str(made / "data"), "--out", str(made / "a.webp")]
    style = [] if "--style" in words else ["--style", "slow=5"]
    assert gof([*asked, "--fps", "10", *style, "--json", str(made / "a.json"), *words]) == 0
    return decoded(made / "a.webp"), json.loads((made / "a.json").read_text())


def test_command_around_the_flame_is_over_black_and_says_so(made, capsys):
    frames, figures = film_of(made)
    assert figures["frames"] == len(frames) == 10
    assert frames[0].shape[1] == 4 * 36 + 3 * 4
    assert "behind fire: nothing, so black" in capsys.readouterr().out
    assert frames[0][60, 33].max() < 16


def test_command_from_a_camera_has_its_plate_and_what_it_recorded(made, capsys):
    frames, _ = film_of(made, "--camera-path", "camera", "--style", "slow=5", "recorded", "--panels", "rgb")
    assert "the plate of" in capsys.readouterr().out
    recorded = [int(frame[30, 30].mean()) for frame in frames]
    assert abs(recorded[0] - 26) < 6 and abs(recorded[-1] - 128) < 6, "the frame nearest in time: 0.1, 0.3, 0.5"
    assert abs(int(frames[0][60, 73].mean()) - 64) < 6, "the plate, 0.25"


def test_another_methods_gaussians_are_not_helped_by_our_plate(made, capsys):
    """They may be the whole scene: `gof evaluate` draws them over black, and so does a film."""
    assert gof(["convert", str(made / "fire.npz"), str(made / "theirs.ftgs.ply")]) == 0
    asked = ["video", str(made / "theirs.ftgs.ply"), "--dataset", str(made / "data"), "--camera-path", "camera"]
    asked += ["--panels", "rgb", "--out", str(made / "b.png"), "--overwrite"]
    for words, said, level in (([], "may be the whole scene", 0), (["--flame-only"], "the plate of", 64)):
        assert gof(["convert", str(made / "theirs.ftgs.ply"), "--time-unit", "0.2", *words, "--overwrite"]) == 0
        assert gof(asked) == 0
        assert said in " ".join(capsys.readouterr().out.split())
        assert abs(int(cv2.imread(str(made / "b.png"))[60, 33].mean()) - level) < 6


def test_command_two_results_and_a_still_scene(made, capsys):
    one((0, 1, 1), dynamic=False, scale=0.5, color=(0, 0, 1)).save(made / "still.npz")
    flame(20).save(made / "other.npz")
    words = ["--camera-path", "cameras", "--mode", "freeze", "--style", f"scene={made / 'still.npz'}", "seconds=0.2"]
    asked = ["video", f"ours={made / 'fire.npz'}", f"theirs={made / 'other.npz'}", "--dataset", str(made / "data")]
    assert gof([*asked, *words, "--fps", "10", "--out", str(made / "b.webm")]) == 0
    frames = decoded(made / "b.webm")
    assert len(frames) == 2 and frames[0].shape[:2] == (2 * 64 + 4, 4 * 36 + 12)
    assert "behind theirs: the still scene" in capsys.readouterr().out
    assert frames[0][..., 2].max() > 100, "blue"


def test_command_makes_a_grid_of_errors_as_one_picture(made):
    asked = ["video", str(made / "fire.npz"), "--dataset", str(made / "data"), "--camera-path", "camera"]
    assert gof([*asked, "--style", "recorded", "--panels", "rgb", "error", "--out", str(made / "grid.png")]) == 0
    grid = cv2.imread(str(made / "grid.png"))[..., ::-1].astype(int)
    assert grid.shape[:2] == (64, 3 * 36 + 8)
    assert abs(grid[60, 33].mean() - 0.3 * 255) < 3 and abs(grid[60, 73].mean() - 0.25 * 255) < 3
    faint, strong = (
        error_colours(np.full((1, 1, 3), 64), np.full((1, 1, 3), 77)),
        error_colours(np.zeros((1, 1, 3)), np.full((1, 1, 3), 255)),
    )
    assert np.abs(grid[60, 113] - faint[0, 0]).max() <= 8, "an error of 0.05"
    assert faint.max() < 80 < 240 < strong.max()


@pytest.mark.parametrize(
    "words, said",
    [
        (["--names", "a", "b"], "NAME=fire.npz"),
        (["--style", "recorded"], "--camera-path camera"),
        (["--panels", "error"], "--style recorded"),
        (["--style", "camera=nobody"], "the dataset has"),
        (["--style", "stop=9"], "the clip is from 0 to 0.2 s"),
        (["--style", "slow=0"], "slow 0"),
        (["--style", "slower=2"], "slower is not a field"),
        (["--style", "fast"], "KEY=VALUE"),
        (["--out", "film.avi"], ".webm"),
        (["--style", "scene=fire.npz"], "nothing that stands still"),
    ],
)
def test_command_refuses_by_name(made, words, said, capsys, monkeypatch):
    monkeypatch.chdir(made)
    assert gof(["video", "fire.npz", "--dataset", "data", *words]) != 0
    assert said in capsys.readouterr().err


@pytest.mark.parametrize("name", ["mine.mp4", "mine.png"])
def test_command_keeps_a_file_that_a_user_named(made, name, capsys):
    """A film of a camera, say. One that this command was about to write again, from frames beside it, goes on."""
    (made / name).write_bytes(b"of a camera")
    asked = ["video", str(made / "fire.npz"), "--mode", "freeze", "--panels", "rgb", "--max-size", "32"]
    asked += ["--style", "seconds=0.1", "keep_frames", "--out", str(made / name)]
    assert gof(asked) == 1
    assert "is there already" in capsys.readouterr().err and (made / name).read_bytes() == b"of a camera"
    assert gof([*asked, "--overwrite"]) == 0 and (made / name).read_bytes() != b"of a camera"
    capsys.readouterr()
    assert gof(asked) == 0 and "were there already" in capsys.readouterr().out


def test_command_without_a_dataset_goes_around_and_nothing_else(made, capsys):
    assert gof(["video", str(made / "fire.npz"), "--camera-path", "camera"]) != 0
    assert "--dataset" in capsys.readouterr().err


def test_command_makes_a_film_anew_of_a_folder_with_other_files(made, capsys):
    """A folder's result is its files, and frames that are kept are of those of before."""
    asked = ["video", str(made / "clip"), "--mode", "freeze", "--panels", "rgb", "--max-size", "64", "--overwrite"]
    asked += ["--style", "seconds=0.1", "keep_frames", "--out", str(made / "a.png")]
    seen = []
    for color in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)):
        replace(flame(), color=np.tile(np.float32(color), (40, 1))).save(made / "one.npz")
        shutil.rmtree(made / "clip", ignore_errors=True)
        (made / "clip.gof.json").unlink(missing_ok=True)
        words = ["convert", str(made / "one.npz"), str(made / "clip"), "--clip", "0", "0.2", "--frame-time", "0.1"]
        assert gof(words) == 0
        assert gof(["convert", str(made / "clip"), "--time-unit", "0.1"]) == 0
        assert gof(asked) == 0
        picture = cv2.imread(str(made / "a.png"))[..., ::-1]
        height, width = picture.shape[:2]  # words stand at its edges
        seen.append(picture[height // 2 - 8 : height // 2 + 8, width // 2 - 8 : width // 2 + 8].mean((0, 1)))
    red, green = np.array(seen, int)
    assert red[0] > 100 > 20 > red[1] and green[1] > 100 > 20 > green[0]
    capsys.readouterr()
    assert gof(asked) == 0 and "1 of 1 frames were there already" in capsys.readouterr().out


def test_a_film_is_of_the_results_own_plates_too(made):
    (made / "plates").mkdir()
    keys = []
    for grey in (10, 200):
        Image.fromarray(np.full((64, 36), grey + grey % 3, np.uint8)).save(made / "plates/cam_0.png", compress_level=0)
        keys.append(_made_of(FilmStyle.read(()), [open_moving(made / "fire.npz")], None))
    assert keys[0] != keys[1]


def test_command_shows_a_result_by_the_datasets_clock(made):
    """The same flame in a file that counts from half a second earlier."""
    near, _ = film_of(made, "--panels", "rgb")
    g = flame()
    replace(g, t_mu=g.t_mu + 0.5, datum=Datum(time_s=-0.5)).save(made / "fire.npz")
    far, _ = film_of(made, "--panels", "rgb", "--overwrite")
    assert len(near) == len(far) and near[0].max() > 60
    for a, b in zip(near, far, strict=True):
        assert np.abs(a.astype(int) - b).mean() < 2
