"""Which way is up, against drawn scenes whose vertical is known, and silence where nothing shows it."""

import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from gof.ingest import accelerometer
from gof.ingest.accelerometer import Tilt, read_tilt, up_from_tilts
from gof.ingest.axes import up_from_points
from gof.ingest.marked_points import MarkedPoint
from gof.ingest.sfm import PoseError
from gof.ingest.up import Edges, angle_deg, cameras_up, up_from_board, up_from_edges
from tests.conftest import look_at
from tests.ingest.gopro import film, track
from tests.ingest.scene import FOCAL, HEIGHT, WIDTH, cameras, draw, lens


def posts(camera, directions, seed=0):
    """(H, W, 3) uint8: bars of 1.2 m along these unit directions, on a noisy ground."""
    rng = np.random.default_rng(seed)
    picture = np.full((HEIGHT, WIDTH, 3), 120.0)
    for direction, x, y in zip(
        directions, np.linspace(-0.8, 0.8, len(directions)), rng.uniform(-0.3, 1.5, len(directions)), strict=True
    ):
        foot = np.array([x, y, 0.0])
        side = 0.04 * np.array([1.0, 0, 0])
        corners = np.array([foot - side, foot + side, foot + side + 1.2 * direction, foot - side + 1.2 * direction])
        pixels = camera.project(corners)[0] - 0.5
        cv2.fillConvexPoly(picture, np.int32(np.rint(pixels * 16)), [40, 60, 50], cv2.LINE_AA, 4)
    return np.uint8(np.clip(picture + rng.normal(0, 2, picture.shape), 0, 255))


def rig(pitch):
    """Three cameras that look down by about `pitch` degrees."""
    height = 0.6 + 3 * np.tan(np.deg2rad(pitch))
    angles = np.deg2rad([-12, 0, 12])
    return [
        look_at(f"cam_{i}", (3 * np.sin(a), -3 * np.cos(a), height), (0, 0, 0.6), WIDTH, HEIGHT, FOCAL)
        for i, a in enumerate(angles)
    ]


def edges_of(pictures, cams):
    masks = [np.ones(p.shape[:2], bool) for p in pictures]
    return Edges.find(pictures, masks, [lens(c) for c in cams], np.array([c.world_to_camera for c in cams]))


@pytest.mark.parametrize("pitch", [0.0, 8.0, 15.0])
def test_posts_show_the_vertical_that_tilted_cameras_hide(pitch):
    cams = rig(pitch)
    upright = [np.array([0.0, 0, 1])] * 7
    level = cameras_up(np.array([c.world_to_camera for c in cams]))
    up, report = up_from_edges(edges_of([posts(c, upright) for c in cams], cams), level)
    assert angle_deg(up, np.array([0.0, 0, 1])) < 1.0
    assert report.lean_deg == pytest.approx(angle_deg(level, np.array([0.0, 0, 1])), abs=1.0)
    assert report.spread_deg < 3 and report.edges >= 8


def test_edges_that_agree_on_nothing_are_no_vertical():
    """Noise has edges in every direction, and so has a heap of sticks."""
    cams = cameras()
    level = cameras_up(np.array([c.world_to_camera for c in cams]))
    assert up_from_edges(edges_of([draw(c)[0] for c in cams], cams), level) is None
    rng = np.random.default_rng(3)
    sticks = rng.normal(0, 1, (9, 3)) * [0.5, 0.5, 0.2] + [0, 0, 0.4]
    sticks /= np.linalg.norm(sticks, axis=1, keepdims=True)
    assert up_from_edges(edges_of([posts(c, sticks) for c in cams], cams), level) is None
    assert up_from_edges(edges_of([np.full((HEIGHT, WIDTH, 3), 80, np.uint8)] * 3, cams), level) is None


def test_a_board_that_stands_upright_shows_it():
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0.5, 0]]) * 0.06
    points = [MarkedPoint({0: np.zeros(2)}, xyz) for xyz in square]
    up = np.array([0.2, -0.1, 1.0]) / np.linalg.norm([0.2, -0.1, 1.0])
    right = np.cross(up, [0, -1, 0.0])
    right /= np.linalg.norm(right)
    world = 5 + square[:, :1] * right - square[:, 1:2] * up
    level = np.array([0.0, 0, 1])
    assert angle_deg(up_from_board(points, world, level), up) < 1e-6
    lying = 5 + square[:, 1:2] * right + square[:, :1] * up  # mounted on its side
    assert angle_deg(up_from_board(points, lying, level), up) < 1e-6
    world[0] = np.nan
    assert angle_deg(up_from_board(points, world, level), up) < 1e-6
    assert up_from_board(points[:2], world[:2], level) is None


# ---- marked points ---------------------------------------------------------------------------------------------------

POST, TREE = [(-0.4, 0.1, -0.4), (-0.4, 0.1, 1.6)], [(0.5, 0.4, 0.0), (0.5, 0.4, 1.1)]
FLOOR = [(-0.6, -0.4, 0.0), (0.6, -0.3, 0.0), (0.1, 0.9, 0.0)]


def marked(cams, noise=0.0, **things):
    """Points of things given as kind_name=[xyz, ...], in all cameras."""
    rng = np.random.default_rng(1)
    points = []
    for key, places in things.items():
        kind, name = key.split("_")
        for place in places:
            pixels = {c: cam.project(np.array([place]))[0][0] + rng.normal(0, noise, 2) for c, cam in enumerate(cams)}
            points.append(MarkedPoint(pixels, **{kind: name}))
    return points


def up_of(cams, points):
    poses = np.array([c.world_to_camera for c in cams])
    return up_from_points(poses, [lens(c) for c in cams], points, cameras_up(poses))


@pytest.mark.parametrize(
    "things",
    [
        {"upright_post": POST},
        {"level_floor": FLOOR},
        {"upright_post": POST, "upright_tree": TREE, "level_floor": FLOOR},
        {"level_sill": FLOOR[:2], "level_step": FLOOR[1:]},  # two level lines across each other
    ],
)
def test_marked_points_give_the_vertical(things):
    cams = rig(15.0)
    up, report = up_of(cams, marked(cams, **things))
    assert angle_deg(up, np.array([0.0, 0, 1])) < 1e-6 and report.source == "points"
    assert report.lean_deg == pytest.approx(
        angle_deg(cameras_up(np.array([c.world_to_camera for c in cams])), up), abs=0.01
    )
    error = angle_deg(up_of(cams, marked(cams, 1.0, **things))[0], up)
    assert error < 3 * report.spread_deg, "the spread is that of marks a pixel off"


def test_points_that_do_not_hold_the_vertical_are_refused():
    cams = rig(8.0)
    for things, words in (
        ({"level_sill": FLOOR[:2]}, "turn this vertical by"),
        ({"upright_stub": [(0, 0, 0), (0, 0, 0.02)]}, "taller post"),
        ({"upright_post": POST, "level_ramp": [*FLOOR[:2], (0.1, 0.9, 0.5)]}, r"'(ramp|post)' is \d+ degrees from"),
        ({"upright_post": POST[:1]}, "'post' .upright. fewer than two"),
    ):
        with pytest.raises(PoseError, match=words):
            up_of(cams, marked(cams, **things))
    one_view = [MarkedPoint({0: p.pixels[0]}, upright="post") for p in marked(cams, upright_post=POST)]
    with pytest.raises(PoseError, match="two pictures"):
        up_of(cams, one_view)
    with pytest.raises(PoseError, match="no point of --points"):
        up_of(cams, [MarkedPoint({0: np.zeros(2)})])
    above = [
        look_at(f"cam_{i}", (x, 0.001, 4.0), (x, 0, 0), WIDTH, HEIGHT, FOCAL) for i, x in enumerate((-0.5, 0, 0.5))
    ]
    with pytest.raises(PoseError, match="tells up from down"):
        up_of(above, marked(above, level_floor=FLOOR))


# ---- accelerometers --------------------------------------------------------------------------------------------------

DOWN_7 = np.array([0.0, np.cos(np.deg2rad(7)), np.sin(np.deg2rad(7))])
"""Where the top shows, in Blender's camera axes, of a camera that looks 7 degrees down."""
IN_PICTURE = DOWN_7 * [1, -1, -1]


def test_what_the_camera_says_of_gravity_is_believed_before_its_accelerometer(tmp_path):
    """HERO8 writes zeros, and is asked for its accelerometer; one that shakes is not believed."""
    elsewhere = np.array([0.6, 0.8, 0.0])
    known = film(tmp_path / "known.mp4", track(elsewhere, "XzY", gravity=-IN_PICTURE))
    np.testing.assert_allclose(read_tilt(known, "none").up, IN_PICTURE, atol=1e-4)
    silent = film(tmp_path / "silent.mp4", track(DOWN_7, "zxY", gravity=np.zeros(3)))
    np.testing.assert_allclose(read_tilt(silent, "none").up, IN_PICTURE, atol=1e-3)
    carried = read_tilt(film(tmp_path / "carried.mp4", track(DOWN_7, "zxY", shake=3.0)), "none")
    assert carried.up is None and "moved" in carried.why


@pytest.mark.skipif("GOF_GOPRO_SAMPLE" not in os.environ, reason="GOF_GOPRO_SAMPLE: GoPro's samples/max-heromode.mp4")
def test_a_real_gopros_gravity_and_its_accelerometer_agree(monkeypatch):
    """A MAX, carried along a path, 7 degrees down (the horizon is above the middle): github.com/gopro/gpmf-parser."""
    sample = Path(os.environ["GOF_GOPRO_SAMPLE"])
    by_gravity = read_tilt(sample, "none").up
    np.testing.assert_allclose(by_gravity, [0, -0.992, -0.12], atol=0.02)
    raw = [stream for stream in accelerometer.streams(sample) if "ACCL" in stream]
    assert "moved" in accelerometer._stored_up(raw), "it is carried"
    monkeypatch.setattr(accelerometer, "MOST_SHAKE", 9.0)
    assert angle_deg(accelerometer._stored_up(raw), by_gravity) < 3
    assert {str(stream["ORIN"]) for stream in raw} == {"XzY"}


def test_a_lying_picture_is_told_from_an_upright_one(tmp_path):
    sample = film(tmp_path / "a.mp4", track(DOWN_7, "ZXY"))
    assert "90 degrees from upright; give --turn" in read_tilt(sample, "clockwise").why
    assert "180 degrees from upright" in read_tilt(sample, "half").why


def test_files_without_a_track_say_nothing_and_damaged_ones_are_named(tmp_path):
    data = film(tmp_path / "whole.mp4", track(DOWN_7, "XzY", gravity=-IN_PICTURE)).read_bytes()
    picture = tmp_path / "folder"
    picture.mkdir()
    assert read_tilt(picture, "none") == Tilt()
    for content in (b"", b"\x1a\x45\xdf\xa3" + bytes(2000), data[:20], bytes(64)):
        (tmp_path / "a.mp4").write_bytes(content)
        assert read_tilt(tmp_path / "a.mp4", "none") == Tilt()
    rng = np.random.default_rng(0)
    at = data.index(b"moov") - 4
    for _ in range(300):  # nothing but a tilt or words, whatever is damaged
        broken = bytearray(data)
        for place in rng.integers(at if rng.random() < 0.7 else 0, len(data), 6):
            broken[place] = rng.integers(256)
        (tmp_path / "a.mp4").write_bytes(broken[: rng.integers(len(data) // 2, len(data) + 1)])
        tilt = read_tilt(tmp_path / "a.mp4", "none")
        assert tilt.up is None or (np.isfinite(tilt.up).all() and abs(np.linalg.norm(tilt.up) - 1) < 1e-6)
    (tmp_path / "a.mp4").write_bytes(data.replace(b"SCALs\x02\x00\x01\x7f\xff", b"SCALs\x02\x00\x01\x00\x00"))
    assert "scale" in read_tilt(tmp_path / "a.mp4", "none").why


def test_accelerometers_must_agree():
    cams = rig(10.0)
    poses = np.array([c.world_to_camera for c in cams])
    level = cameras_up(poses)
    tilts = [Tilt(c.world_to_camera[:3, 2]) for c in cams]  # Z of the world in each camera
    up, report = up_from_tilts(poses, tuple(tilts), level)
    assert angle_deg(up, np.array([0.0, 0, 1])) < 1e-6 and report.spread_deg == 0
    assert up_from_tilts(poses, (Tilt(), tilts[1], Tilt()), level)[1].spread_deg is None
    turn = cv2.Rodrigues(np.array([0.0, 0, np.deg2rad(12)]))[0]
    assert "contradict" in up_from_tilts(poses, (tilts[0], Tilt(turn @ tilts[1].up), tilts[2]), level)
    assert "contradict" in up_from_tilts(poses[[0, 0]], (tilts[0], Tilt(-tilts[0].up)), level)
    assert up_from_tilts(poses, (Tilt(), Tilt(why="b.mp4: shakes"), Tilt()), level) == "b.mp4: shakes"
