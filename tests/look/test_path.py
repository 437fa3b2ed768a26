"""Where a film's camera is: closed forms of circles, splines through their knots, clocks by hand."""

import numpy as np
import pytest

from gof.core.errors import GofError
from gof.look.path import Shot, clock, orbit, say_what_is_a_guess, shots, stay, through
from tests.conftest import arc, look_at

MIDDLE = np.array([0.3, -0.2, 1.0])
FAR = np.array([5e5, 6e6, 0.0])  # metres: coordinates of a map


def test_an_orbit_begins_and_ends_with_the_camera_and_keeps_its_distance():
    camera = look_at("a", (2, -2, 1.5), MIDDLE)
    at = orbit(camera, MIDDLE, 360)
    np.testing.assert_allclose(at(0).world_to_camera, camera.world_to_camera, atol=1e-12)
    radius = np.hypot(*(camera.position - MIDDLE)[:2])
    for share in np.linspace(0, 1, 9):
        moved = at(share)
        assert np.hypot(*(moved.position - MIDDLE)[:2]) == pytest.approx(radius)
        assert moved.position[2] == pytest.approx(camera.position[2])
    opposite = 2 * MIDDLE - camera.position
    np.testing.assert_allclose(at(0.5).position[:2], opposite[:2], atol=1e-9)


@pytest.mark.parametrize("away", [np.zeros(3), FAR])
def test_what_stands_on_the_axis_stays_in_its_pixel(away):
    camera = look_at("a", (2, -2, 1.5) + away, (0, 0, 1) + away)
    column = MIDDLE + away + np.array([[0, 0, -0.3], [0, 0, 0.4]])
    before, _ = camera.project(column)
    for share in (0.1, 0.4, 0.9):
        after, _ = orbit(camera, MIDDLE + away, 360)(share).project(column)
        np.testing.assert_allclose(after, before, atol=1e-6)


def test_less_than_a_turn_swings_to_both_sides():
    camera = look_at("a", (0, -3, 1), (0, 0, 1))
    at = orbit(camera, np.array([0, 0, 1.0]), 40)

    def angle(share):
        x, y, _ = at(share).position
        return np.rad2deg(np.arctan2(x, -y))

    assert [round(angle(share), 6) for share in (0, 0.25, 0.5, 0.75, 1)] == [0, 20, 0, -20, 0]


@pytest.mark.parametrize("count", [2, 3, 5])
def test_the_way_through_the_cameras_passes_each_of_them(count):
    cameras = arc(count)
    at = through(cameras)
    knots = np.r_[0, np.cumsum(np.linalg.norm(np.diff([c.position for c in cameras], axis=0), axis=1))]
    for camera, knot in zip(cameras, knots, strict=True):
        there = np.arccos(1 - 2 * knot / knots[-1]) / (2 * np.pi)
        for share in (there, 1 - there):  # on the way there and on the way back
            np.testing.assert_allclose(at(share).world_to_camera, camera.world_to_camera, atol=1e-6)
            np.testing.assert_allclose(at(share).K, camera.K, atol=1e-6)


def test_cameras_of_other_sizes_show_the_same_height_of_view():
    first, second = arc(2)[0], look_at("big", (2, -2, 1), (0, 0, 1), width=144, height=128, focal_px=160)
    last = through([first, second])(0.5)
    assert (last.width, last.height) == (36, 64)
    np.testing.assert_allclose(last.K, [[80, 0, 18], [0, 80, 32], [0, 0, 1]], atol=1e-9)


def test_two_cameras_in_one_place_are_no_error_and_one_camera_is():
    camera = arc(1)[0]
    assert np.isfinite(through([camera, camera])(0.3).world_to_camera).all()
    with pytest.raises(GofError, match="one camera"):
        through([camera])


def test_clocks():
    times, along = clock("play", (10.0, 10.2), slow=5, seconds=9, fps=10, stop_s=10.1)
    np.testing.assert_allclose(times, 10 + 0.02 * np.arange(10))
    np.testing.assert_allclose(along, np.arange(10) / 10)
    times, along = clock("freeze", (10.0, 10.2), slow=5, seconds=0.4, fps=10, stop_s=10.1)
    assert times.tolist() == [10.1] * 4 and along.tolist() == [0, 0.25, 0.5, 0.75]
    times, along = clock("bullet", (10.0, 10.2), slow=5, seconds=0.4, fps=10, stop_s=10.1)
    assert len(times) == 14 and (np.diff(times) >= 0).all() and times[-1] <= 10.2
    assert (along[times != 10.1] == 0).all() and np.count_nonzero(along) == 3


def test_a_clip_of_one_instant_is_one_frame():
    times, along = clock("play", (3.0, 3.0), slow=5, seconds=1, fps=30, stop_s=3.0)
    assert times.tolist() == [3.0] and along.tolist() == [0.0]


def test_a_camera_that_stays_keeps_its_shutter_and_one_that_flies_has_none():
    from dataclasses import replace

    rolling = replace(arc(1)[0], row_time_s=1e-5)
    assert stay(rolling)(0.4) is rolling
    assert orbit(rolling, MIDDLE, 360)(0.4).row_time_s == 0
    assert [shot.time_s for shot in shots(stay(rolling), np.array([1.0, 2.0]), np.zeros(2))] == [1.0, 2.0]


def test_shots_from_where_nobody_filmed_say_so():
    """Cameras at -17, 0 and 17 degrees of a circle: 15 degrees beside the last is theirs, 60 is not."""
    on_circle = [3 * np.array([np.sin(a), -np.cos(a), 0]) for a in np.radians([-17, 0, 17, 32, 77])]
    cameras = [look_at("a", place, [0, 0, 0]) for place in on_circle]
    film = [Shot(camera, 0.5) for camera in cameras[3:]]
    first, second = say_what_is_a_guess(film, cameras[:3])
    assert first == film[0] and second.note == "60\N{DEGREE SIGN} from the nearest camera: a guess"
