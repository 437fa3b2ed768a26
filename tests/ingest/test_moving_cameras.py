"""Cameras that move a little and change their exposure: known moves and gains are found and undone."""

import json

import cv2
import numpy as np
import pytest

from gof.commands.cli import main as gof
from gof.core.errors import DataFormatError
from gof.footage.defects import FrameChanges
from gof.footage.steadying import corner_moves, find_gains, find_moves, look, steady
from gof.footage.videos import read_info
from gof.ingest.footage import Footage, PreparedClip
from tests.ingest.scene import FOCAL, HEIGHT, WIDTH, cameras, draw
from tests.videos import write_video

COUNT = 16
CORNERS = np.array([[0, 0], [WIDTH, 0], [0, HEIGHT], [WIDTH, HEIGHT], [WIDTH / 2, HEIGHT / 2]])
K = np.array([[FOCAL, 0, WIDTH / 2], [0, FOCAL, HEIGHT / 2], [0, 0, 1]])
WARM = np.array([1.0, 0.45, 0.12])  # a fire's light


def linear(values):
    """The standard's own formula, IEC 61966-2-1."""
    v = np.asarray(values) / 255
    return np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4)


def display(light):
    light = np.clip(light, 0, 1)
    return 255 * np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


def flame(k: int) -> np.ndarray:
    """(H, W, 3) light of a flame that sways, grows and breathes with its number."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    tall = 35 + 8 * np.sin(1.7 * k)
    at = 120 + 12 * np.sin(0.9 * k + (200 - y) / 25)
    body = np.exp(-(((x - at) / 14) ** 2)) * np.exp(-(((y - 180) / tall) ** 2)) * (0.8 + 0.4 * np.sin(2.3 * k))
    return body[..., None] * WARM


def filmed(moves=None, gains=None, room=None, count=COUNT, noise=1.5):
    """(N, H, W, 3) uint8 of the drawn scene with a flame; moves: (N, 3, 3) from the scene's pixels to a frame's."""
    rng, still = np.random.default_rng(4), linear(draw(cameras()[0])[0])
    clip = []
    for k in range(count):
        light = still * (1 if room is None else 1 + room[k]) + flame(k)
        light = light * (1 if gains is None else gains[k])
        picture = display(light).astype(np.float32)
        if moves is not None:
            picture = cv2.warpPerspective(
                picture, moves[k], (WIDTH, HEIGHT), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT_101
            )
        clip.append(picture + rng.normal(0, noise, picture.shape))
    return np.uint8(np.clip(np.rint(clip), 0, 255))


def shaken(kind: str, amount: float = 1.0) -> np.ndarray:
    """(N, 3, 3): moves of a hand, as shifts with a little turn and zoom, or as turns of the camera about its place."""
    rng, moves = np.random.default_rng(2), []
    for _ in range(COUNT):
        if kind == "turns":
            rotation = cv2.Rodrigues(amount * rng.normal(0, 0.004, 3))[0]
            moves.append(K @ rotation @ np.linalg.inv(K))
            continue
        angle, zoom, x, y = amount * rng.normal(0, [0.002, 0.001, 1.2, 1.2])
        c, s = (1 + zoom) * np.cos(angle), (1 + zoom) * np.sin(angle)
        moves.append(np.array([[c, -s, x], [s, c, y], [0, 0, 1]]))
    return np.array(moves)


def at(matrix, points):
    moved = np.c_[points, np.ones(len(points))] @ matrix.T
    return moved[:, :2] / moved[:, 2:]


def drift(size: float) -> np.ndarray:
    return np.exp(size * np.sin(np.linspace(0, 3, COUNT)))[:, None, None, None]


def steadied(clip, place=COUNT // 2):
    known = np.arange(0, len(clip), 2) if place % 2 == 0 else np.arange(len(clip))
    return steady(look(clip, clip[place], place), known, "cam_0.mp4", np.arange(len(clip)))


@pytest.mark.parametrize("kind, model", [("shifts", "similarity"), ("turns", "homography")])
@pytest.mark.parametrize("gained", [False, True])
def test_known_moves_are_found_to_a_tenth_of_a_pixel_beside_a_flame(kind, model, gained):
    moves, gains = shaken(kind), drift(0.2) if gained else None
    clip, place = filmed(moves, gains), COUNT // 2
    found, called, points, _ = find_moves(look(clip, clip[place], place), np.arange(COUNT))
    assert called == model and points > 100
    off = [
        np.linalg.norm(at(found[k], at(moves[k], CORNERS)) - at(moves[place], CORNERS), axis=1) for k in range(COUNT)
    ]
    assert np.abs(moves - moves[place]).max() > 2, "the frames did move"
    assert np.sqrt(np.mean(np.square(off))) < 0.05 and np.max(off) < 0.15, np.round(np.max(off, 1), 3)


def test_the_flame_and_the_board_do_not_move_the_camera():
    """More of the picture's corners may be on what moves by itself, together, than noise would explain."""
    clip = filmed()
    band = cv2.GaussianBlur(np.random.default_rng(1).integers(0, 255, (HEIGHT, 60, 3), np.uint8), (0, 0), 1.5)
    for k, picture in enumerate(clip):
        picture[:, 20:80] = np.roll(band, -3 * (k - 8), axis=0)  # all of it rises by 3 px a frame
    found = steadied(clip)
    assert found.frames == () and found.moved_px.max() < 0.1 and found.notes == ()


def test_known_gains_are_found_and_a_steady_clip_has_none():
    gains = drift(0.2)
    clip = filmed(gains=gains)
    seen = look(clip, clip[8], 8)
    found, said = find_gains(seen, find_moves(seen, np.arange(COUNT))[0], np.arange(COUNT))
    truth = (gains / np.median(gains)).reshape(-1, 1)
    assert np.abs(np.log(found / truth)).max() < 0.01, np.round(found / truth, 4)
    assert "the exposure changes by 22 %" in said or "the exposure changes by 21 %" in said, said
    still = steadied(filmed())
    assert (still.gain == 1).all() and still.frames == () and still.notes == ()


def test_the_fires_light_on_the_room_is_not_exposure():
    """Warm, flickering as the flame does, weaker farther away, and up to as strong as daylight on the same wall."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    near = 1 / (1 + ((x - 120) ** 2 + (y - 180) ** 2) / 80**2)
    slow = 0.5 + 0.5 * np.sin(np.linspace(0, 5, COUNT))
    for strength in (0.1, 0.3, 1.0):
        room = strength * slow[:, None, None, None] * near[..., None] * WARM
        found = steadied(filmed(room=room))
        assert found.frames == () and (found.gain == 1).all(), strength
    assert any("unequally, as a fire's own does: it is left" in note for note in found.notes)
    white = 0.3 * slow[:, None, None, None] * near[..., None] * np.ones(3)
    assert (steadied(filmed(room=white)).gain == 1).all(), "of one colour, and yet not everywhere"


def test_a_large_drift_is_found_beside_the_fires_own_light():
    """Frames near the usual exposure show the fire's light more than the drift; they are not who is asked."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    near = 1 / (1 + ((x - 120) ** 2 + (y - 180) ** 2) / 80**2)
    gains = np.linspace(0.8, 1.2, COUNT)[:, None, None, None]
    room = 0.12 * (np.arange(COUNT) % 2)[:, None, None, None] * near[..., None] * WARM
    found = steadied(filmed(gains=gains, room=room))
    assert "the exposure changes by" in found.notes[0] and "brought to the usual one" in found.notes[0]
    truth = (gains / np.median(gains)).reshape(-1, 1)
    assert np.abs(np.log(found.gain / truth)).max() < 0.06, np.round(found.gain / truth, 3)


def test_lamps_that_flicker_are_not_exposure():
    found = steadied(filmed(room=0.2 * (-1.0) ** np.arange(COUNT)[:, None, None, None]))
    assert (found.gain == 1).all() and "flickers" in found.notes[0] and "lamps" in found.notes[0]


def test_a_camera_that_moves_too_much_is_refused_with_figures():
    moves = np.tile(np.eye(3), (COUNT, 1, 1))
    moves[5, 0, 2] = 0.03 * WIDTH
    with pytest.raises(
        DataFormatError, match=r"cam_0\.mp4: the camera moves by up to 7\.[12] px, 3\.0% .*frame 5;.*tri"
    ):
        steadied(filmed(moves))
    moves[5, 0, 2] = 0.015 * WIDTH
    assert steadied(filmed(moves)).moved_px.max() == pytest.approx(0.015 * WIDTH, abs=0.1)


def test_nothing_is_claimed_where_nothing_stands_still():
    rng = np.random.default_rng(0)
    clip = rng.integers(0, 255, (COUNT, HEIGHT, WIDTH, 3), np.uint8)
    found = steadied(clip)
    assert found.model == "none" and found.points == 0 and found.frames == ()
    dark = np.uint8(np.rint(display(np.array([flame(k) for k in range(COUNT)]))))
    found = steadied(dark)
    assert found.frames == () and (found.gain == 1).all()


def test_corrected_pictures_are_those_of_a_camera_that_stood():
    moves, gains = shaken("shifts", 0.7), drift(0.15)
    clip, place = filmed(moves, gains), COUNT // 2
    found = steadied(clip)
    usual = np.median(gains)
    truth = filmed(np.tile(moves[place], (COUNT, 1, 1)), np.tile(usual, (COUNT, 1, 1, 1)))
    inside = np.s_[20:-20, 20:-20]

    def psnr(a, b):
        return 10 * np.log10(255**2 / np.mean((a[inside].astype(float) - b[inside]) ** 2))

    right = [c.applied(picture) for c, picture in zip(found.frames, clip, strict=True)]
    before = [psnr(a, b) for a, b in zip(clip, truth, strict=True) if a is not clip[place]]
    after = [psnr(a, b) for a, b in zip(right, truth, strict=True)]
    # The noise of 1.5 levels, twice, leaves 41.6 dB; resampling smooths it, and the picture a little.
    assert np.median(before) < 28 and min(after) > 36, (np.round(before, 1), np.round(after, 1))
    assert all((picture > 0).any(-1).all() for picture in right), "the rim shows the reference, not black"


# ---- through files ---------------------------------------------------------------------------------------------------


def test_a_clip_that_needs_nothing_gives_its_own_bytes(tmp_path):
    path = write_video(tmp_path / "a.mp4", filmed())
    clip = Footage.open([path], "none", None, 60.0).clips([np.arange(COUNT)])[0]
    plain = [np.array(frame) for frame in clip]
    assert isinstance(clip, PreparedClip) and clip.corrections == {}
    found = steady(look(clip, plain[8], 8), np.arange(COUNT), "a.mp4", np.arange(COUNT))
    assert found.frames == ()


def test_frames_that_repeat_are_found_and_left_out(tmp_path):
    clip = list(filmed())
    for k in (9, 5):
        clip.insert(k, clip[k - 1])
    videos = [write_video(tmp_path / "a.mp4", filmed(count=COUNT + 2)), write_video(tmp_path / "b.mp4", clip)]
    assert read_info(videos[0]).repeated == () and read_info(videos[1]).repeated == (5, 10)
    still = write_video(tmp_path / "still.mp4", [clip[0]] * 9)
    assert read_info(still).repeated == (), "a film in which nothing moves"
    twice = [picture for picture in filmed() for _ in (0, 1)]
    info = read_info(write_video(tmp_path / "twice.mp4", twice))
    assert info.repeated == tuple(range(1, 2 * COUNT, 2))


@pytest.mark.long
def test_ingest_says_and_stores_what_it_put_right(tmp_path, capsys):
    known = [
        {"name": c.name, "width": c.width, "height": c.height, "K": c.K.tolist(), "world_to_camera": w.tolist()}
        for c in cameras()[:2]
        for w in [c.world_to_camera]
    ]
    (tmp_path / "cameras.json").write_text(json.dumps({"cameras": known}))
    hand = [str(write_video(tmp_path / f"{n}.mp4", filmed(m))) for n, m in (("a", shaken("shifts", 0.7)), ("b", None))]
    words = ["--times", "60", "--cameras", str(tmp_path / "cameras.json"), "--board", "none"]
    assert gof(["ingest", *hand, *words, "--out", str(tmp_path / "set")]) == 0
    said = capsys.readouterr().out
    assert "note: a.mp4: the camera moves by up to" in said and "b.mp4: the camera" not in said
    notes = json.loads((tmp_path / "set" / "dataset.json").read_text())["provenance"]
    assert notes["steadied"]["cam_0"]["moved_px"] > 1 > notes["steadied"]["cam_1"]["moved_px"]
    plain = read_picture_of(hand[1], 3)
    stored = cv2.imread(str(tmp_path / "set" / "cameras" / "cam_1" / "rgb" / "000003.png"))[..., ::-1]
    np.testing.assert_array_equal(stored, plain)
    assert gof(["ingest", *hand, *words, "--out", str(tmp_path / "set"), "--frames", "3"]) == 1
    far = np.tile(np.eye(3), (COUNT, 1, 1))
    far[4:, 0, 2] = 12
    hand[0] = str(write_video(tmp_path / "far.mp4", filmed(far)))
    assert gof(["ingest", *hand, *words, "--out", str(tmp_path / "other")]) == 1
    assert "tripod" in capsys.readouterr().err


def read_picture_of(video: str, number: int) -> np.ndarray:
    """As OpenCV reads it, with nothing of ours between."""
    film = cv2.VideoCapture(video)
    for _ in range(number + 1):
        _, picture = film.read()
    return picture[..., ::-1]


def test_how_far_a_corner_goes():
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])  # a quarter turn about the first pixel's centre
    assert corner_moves(turn[None], (3, 3))[0] == pytest.approx(np.hypot(2.5, 2.5) * np.sqrt(2))


@pytest.mark.parametrize("shown", [(2,), (2, 3), (3,), (4,), (8,)], ids=["2", "2:3", "3", "4", "8"])
def test_copies_at_a_higher_rate_have_repeats_most_of_the_time(shown):
    """Most neighbours of a frame are repeats, too; a film that rests and then burns has none."""
    rng, changes, repeats = np.random.default_rng(0), FrameChanges(), 0
    for k in range(40):
        picture = rng.integers(0, 255, (64, 64, 3)).astype(np.uint8)
        for _ in range(shown[k % len(shown)]):
            changes.add(picture)
        repeats += shown[k % len(shown)] - 1
    assert len(changes.repeated) > 0.75 * repeats
    resting = FrameChanges()
    for k in range(60):
        resting.add(
            np.full((64, 64, 3), 10, np.uint8) if k < 30 else rng.integers(0, 255, (64, 64, 3)).astype(np.uint8)
        )
    assert len(resting.repeated) <= 1  # the last one before the fire may count
