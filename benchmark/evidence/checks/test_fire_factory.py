"""The factory's fires: what is drawn, what shines, their pictures against closed forms."""

import numpy as np
import pytest

from gof_benchmark.training.factory.draws import KINDS, Draw
from gof_benchmark.training.factory.light import LAWS, emission
from gof_benchmark.training.factory.pictures import around, developed, gathered


def test_a_law_shines_where_it_should():
    """What burns, or what is hot: gas that is burnt and hot glows, and cold fuel that burns at its edge does not."""
    flame = np.array([0.0, 0.8, 0.0, -1e-3], np.float16)
    heat = np.array([0.0, 0.3, 3.0, 1.5], np.float16)
    for law in ("reaction", "soot", "sheets"):
        np.testing.assert_array_equal(emission(law, flame, heat), np.float32([0, np.float16(0.8), 0, 0]))
    glow = emission("glow", flame, heat)
    assert glow[2] == pytest.approx(1) and glow[0] < 1e-10
    kelvin = 293 + 1707 / 2
    assert glow[3] == pytest.approx(np.exp(12_000 / 2000 - 12_000 / kelvin), rel=0.01)


def ball(cells: int = 24, cell: float = 0.05, radius: float = 0.35) -> tuple[np.ndarray, np.ndarray]:
    """A ball of light 1 in the middle of a box about zero, one frame."""
    matrix = np.diag([cell, cell, cell, 1.0])
    matrix[:3, 3] = -cells * cell / 2
    axis = (np.arange(cells) + 0.5) * cell + matrix[0, 3]
    distance = np.linalg.norm(np.stack(np.meshgrid(axis, axis, axis, indexing="ij")), axis=0)
    return np.clip((radius - distance) / cell + 0.5, 0, 1)[None].astype(np.float32), matrix


def middle_of(picture: np.ndarray) -> float:
    h, w = picture.shape
    return float(picture[h // 2 - 1 : h // 2 + 1, w // 2 - 1 : w // 2 + 1].mean())


def test_a_ray_gathers_the_light_along_it_and_no_more_than_is_not_hidden():
    """Through the middle: emission x chord; with absorption a, (1 - exp(-a chord)) / a. From any side."""
    light, matrix = ball()
    cameras = around(np.full(3, -0.6), np.full(3, 0.6), np.array([10.0, 100]), np.array([0.0, 20]), 2.0, 60)
    for camera in cameras:
        assert middle_of(gathered(camera, light, matrix)[0]) == pytest.approx(0.7, rel=0.03)
        hidden = gathered(camera, light, matrix, absorption=3.0)[0]
        assert middle_of(hidden) == pytest.approx((1 - np.exp(-2.1)) / 3, rel=0.03)


def test_light_is_seen_where_the_camera_projects_it():
    """A single bright cell off the middle; the picture's brightest pixels are about its projection."""
    light = np.zeros((2, 12, 12, 12), np.float32)
    light[1, 9, 3, 8] = 1
    matrix = np.diag([0.1, 0.1, 0.1, 1.0])
    centre = np.array([[0.95, 0.35, 0.85]])
    for camera in around(np.zeros(3), np.full(3, 1.2), np.array([-30.0, 70]), np.array([5.0, 25]), 1.5, 80):
        dark, seen = gathered(camera, light, matrix)
        assert dark.max() == 0
        row, column = np.unravel_index(seen.argmax(), seen.shape)
        pixel, _ = camera.project(centre)
        assert np.linalg.norm(pixel[0] - [column + 0.5, row + 0.5]) < 2


def test_cameras_hold_the_whole_box():
    low, high = np.array([-0.2, -0.3, 0.0]), np.array([0.2, 0.1, 1.0])
    corners = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T
    for camera in around(low, high, np.array([0.0, 50, 200]), np.array([-5.0, 10, 28]), 1.4, 200):
        pixels, depth = camera.project(corners)
        assert (depth > 0).all() and (pixels > 0).all() and (pixels < [camera.width, camera.height]).all()


def test_developed_pictures_are_eight_bits_and_dark_light_keeps_its_value():
    light = np.linspace(0, 3, 12).reshape(1, 3, 4)
    picture = next(developed(light, np.ones(3), np.zeros((3, 4, 3)), 0.0, np.random.default_rng(0)))
    np.testing.assert_allclose(picture * 255, np.rint(picture * 255), atol=1e-4)
    assert picture.max() <= 1 and (np.diff(picture[..., 0].ravel()) >= 0).all()
    assert picture[0, 2, 0] == pytest.approx(1.055 * (6 / 11) ** (1 / 2.4) - 0.055, abs=0.003)


@pytest.mark.parametrize("number", range(3 * len(KINDS)))
def test_every_kind_can_be_drawn_and_again_the_same(number):
    """The spec itself is checked where it is made: burner inside the box, known fuel, sane clock."""
    draw, again = Draw.of(number), Draw.of(number)
    assert draw.kind == KINDS[number % len(KINDS)]
    assert draw.spec == again.spec and draw.exposure == again.exposure
    fire, clip, box = draw.spec.fire, draw.spec.clip, draw.spec.domain
    assert 0.03 <= 2 * fire.radius <= 1.3
    assert (fire.jet_speed > 0) >= (draw.kind == "jet") and fire.jet_speed <= 7
    assert 25 <= clip.fps <= 400 and (clip.warm_up_frames + clip.frames) * clip.steps_per_frame < 170
    assert clip.warm_up_frames / clip.fps > 0.5 * box.size[2] / (3 * box.size[2] ** 0.5 + fire.jet_speed)
    assert 2 <= len(draw.azimuth_deg) <= 5


def test_kinds_meet_every_law():
    met = {(draw.kind, draw.law) for draw in map(Draw.of, range(len(LAWS) * len(KINDS)))}
    assert len(met) == len(KINDS) * len(LAWS)
