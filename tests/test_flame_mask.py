"""Where flame is told to be: shapes painted into a picture."""

import numpy as np
import pytest

from gof.footage.flame_mask import flame_mask

ORANGE, WHITE, GLOW = (0.95, 0.6, 0.2), (1.0, 1.0, 0.95), (0.42, 0.33, 0.25)


@pytest.fixture
def static():
    return np.full((60, 80, 3), (0.3, 0.28, 0.25))


def painted(static, *boxes):
    picture = static.copy()
    for (top, bottom, left, right), colour in boxes:
        picture[top:bottom, left:right] = colour
    return picture


def test_an_overexposed_core_is_flame(static):
    """White raises blue as much as red; what is orange around it says what it is."""
    mask = flame_mask(painted(static, ((10, 50, 20, 60), ORANGE), ((20, 45, 28, 52), WHITE)), static)
    assert mask[10:50, 20:60].all()
    assert mask.sum() <= 44 * 44, "grown by two pixels"


def test_white_lights_and_thrown_light_are_none(static):
    """LEDs that touch no flame, and a wall that the fire lights."""
    fire = ((10, 30, 10, 30), ORANGE)
    mask = flame_mask(painted(static, ((0, 60, 0, 40), GLOW), fire, ((50, 55, 45, 75), WHITE)), static)
    assert mask[10:30, 10:30].all() and mask.sum() <= 24 * 24


def test_faint_parts_belong_to_a_flame_that_is_bright_somewhere(static):
    faint = (0.5, 0.3, 0.25)
    alone = flame_mask(painted(static, ((10, 30, 10, 30), faint)), static)
    beside = flame_mask(painted(static, ((10, 30, 10, 30), faint), ((30, 40, 10, 30), ORANGE)), static)
    assert not alone.any() and beside[10:40, 10:30].all()


def test_leaves_are_none(static):
    leaves = ((10, 30, 10, 30), (0.8, 0.95, 0.3))
    assert not flame_mask(painted(static, leaves), static).any()
    assert flame_mask(painted(static, ((10, 30, 10, 30), (0.8, 0.7, 0.3))), static).any(), "red in place of green"


def test_a_picture_like_its_plate_has_none(static):
    assert not flame_mask(static, static).any()


@pytest.mark.parametrize("light, found", [(1.0, True), (0.25, True), (0.05, False)])
def test_a_dim_camera_sees_the_same_flame(static, light, found):
    """All of a picture at a share of its light, in linear values; the wall that the fire lights stays none."""

    def dimmed(picture):
        linear = np.where(picture <= 0.04045, picture / 12.92, ((picture + 0.055) / 1.055) ** 2.4) * light
        return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)

    picture = painted(static, ((0, 60, 0, 40), GLOW), ((10, 30, 10, 30), (0.95, 0.85, 0.4)))
    mask = flame_mask(dimmed(picture), dimmed(static))
    assert mask[10:30, 10:30].all() == mask.any() == found
    assert mask.sum() <= 24 * 24
    assert not flame_mask(dimmed(painted(static, ((0, 60, 0, 40), GLOW))), dimmed(static)).any()
