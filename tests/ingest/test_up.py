"""Which way is up, against drawn scenes whose vertical is known, and silence where nothing shows it."""

import cv2
import numpy as np
import pytest

from gof.ingest.marked_points import MarkedPoint
from gof.ingest.up import Edges, angle_deg, cameras_up, up_from_board, up_from_edges
from tests.conftest import look_at
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
