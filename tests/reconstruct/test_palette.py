"""A clip's colours, and Gaussians drawn to them."""

import colorsys
from dataclasses import replace

import drjit as dr
import numpy as np
import pytest

from gof.reconstruct.palette import CELLS, FAINT, RARE, Palette, find_palette
from gof.reconstruct.parameters import recolor
from gof.render.backend import Array3f
from gof.render.scene import columns
from tests.conftest import arc
from tests.reconstruct.test_unseen import observation

ORANGE, BLUE = (1.0, 0.5, 0.1), (0.2, 0.3, 1.0)


def clip(*colors, plate=0.02, frames=2, thickness=0.3):
    """Three cameras' pictures of a fire whose columns have these colours of light, one after another."""
    seen = np.full((frames, 3, 40, 40), thickness)
    seen[..., :4] = 0  # the plate alone
    color = np.array(colors)[np.arange(40) % len(colors)]
    return observation(seen, arc(3, width=40, height=40), color, plate)


def hue(color):
    return np.array([colorsys.rgb_to_hsv(*map(float, c))[0] for c in np.atleast_2d(color)])


def of_light(color, thickness=0.3):
    """Display values of light that a fire of this thickness adds; IEC 61966-2-1."""
    light = 1 - np.exp(-thickness * np.array(color))
    shown = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    return shown / shown.max()


@pytest.mark.parametrize("plate", [0.0, 0.02, 0.3])
def test_colours_are_those_of_the_light_whatever_stands_behind(plate):
    palette = find_palette(clip(ORANGE, BLUE, plate=plate))
    own = np.array([of_light(ORANGE), of_light(BLUE)])
    # light through a plate of 0.3 is less by 0.7, in all channels alike
    assert np.abs(palette.find(own) - own).max() < 0.03
    dark = 0.05 * own
    assert np.abs(palette.find(dark) - own).max() < 0.03, "however dark"


def test_white_pixels_before_a_bright_wall_have_no_colour_to_give():
    """Red and green are white there: less the wall's light their difference is green, which no fire is."""
    burning = clip(ORANGE)
    image, plate = burning.image.copy(), burning.plate.copy()
    plate[:, :, 20:] = wall = (0.75, 0.6, 0.6)
    image[:, :, :, 20:] = 1.0  # half of every picture is white before a wall, the other half tells its colour
    palette = find_palette(replace(burning, image=image, plate=plate))
    lacking = 1 - np.array([wall])
    found = palette.find(lacking)
    assert found[0, 0] == 1 > found[0, 1], "cyan of what the wall lacks becomes the fire's own colour"
    white = replace(burning, image=np.ones_like(image), plate=plate)
    assert find_palette(white) is not None, "where all is white, that is all there is"


def test_red_that_a_camera_presses_together_is_not_green():
    """capture_04/scene_0005 shows (0.91, 0.84, 0.48) before a fire-lit wall of (0.58, 0.36, 0.12)."""
    burning = clip(ORANGE)
    image, plate = burning.image.copy(), burning.plate.copy()
    plate[:, :, 10:], image[:, :, :, 10:] = (0.58, 0.36, 0.12), (0.91, 0.84, 0.48)
    palette = find_palette(replace(burning, image=image, plate=plate))
    green = palette.find(np.array([[0.8, 1.0, 0.3], [0.1, 1.0, 0.1]]))
    assert (green[:, 0] >= green[:, 1]).all(), "soot is never greener than yellow"
    assert palette.held and not find_palette(burning).held


@pytest.mark.parametrize("share", [0.1, 1.0])
def test_a_fire_with_salts_may_be_green(share):
    copper = (0.15, 1.0, 0.45)
    palette = find_palette(clip(*[copper] * int(10 * share), *[ORANGE] * (10 - int(10 * share))))
    assert np.abs(palette.find(np.array([of_light(copper)])) - of_light(copper)).max() < 0.03
    assert not palette.held


def test_green_becomes_what_burns():
    palette = find_palette(clip(ORANGE, BLUE))
    green, violet = palette.find(np.array([[0.7, 1.0, 0.1], [0.4, 0.1, 0.9]]))
    assert abs(hue(green) - hue(of_light(ORANGE))) < 0.07
    assert abs(hue(violet) - hue(of_light(BLUE))) < 0.1
    anything = palette.find(np.random.default_rng(3).uniform(0, 1, (500, 3)))
    near = np.minimum(abs(hue(anything) - hue(of_light(ORANGE))), abs(hue(anything) - hue(of_light(BLUE))))
    assert near.max() < 0.12 and (anything.max(1) == 1).all()


def test_what_is_found_is_in_the_palette():
    """Its own colours are not moved again."""
    palette = find_palette(clip(ORANGE, (1.0, 0.8, 0.4)))
    once = palette.find(np.random.default_rng(4).uniform(0, 1, (500, 3)))
    assert np.abs(palette.find(once) - once).max() < 2 / CELLS


def test_rare_colours_and_faint_ones_are_none_of_the_fires():
    seen = clip(ORANGE, frames=4)
    rng = np.random.default_rng(1)
    rows = rng.integers(0, 40, (3, 2))  # dead pixels, fewer than RARE
    assert len(rows) < RARE * seen.mask.sum()
    seen.image[0, 0, rows[:, 0], rows[:, 1]] = (0.1, 1, 0.1)
    seen.image[:, 1, :, 20:] = seen.plate[1, 0, 0] + np.array([0, FAINT / 4, 0], np.float32)
    assert hue(find_palette(seen).find(np.array([[0.0, 1, 0]]))) == pytest.approx(hue(of_light(ORANGE)), abs=0.07)


def test_where_nothing_burns_there_is_none():
    seen = clip(ORANGE)
    seen.mask[:] = False
    assert find_palette(seen) is None
    seen = clip(ORANGE)
    seen.delivered[:] = False
    assert find_palette(seen) is None


@pytest.mark.parametrize("color", [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 1), (1e-30, 0, 0), (1e-7,) * 3])
def test_corners_of_the_colours(color):
    for nearest in (0, CELLS - 1):  # of a palette at the map's own corners
        palette = Palette(np.full((CELLS, CELLS, 2), nearest))
        found = palette.find(np.array([color], np.float32))
        assert np.isfinite(found).all() and (found >= 0).all() and found.max() == 1


def test_a_step_towards_the_palette():
    palette = find_palette(clip(ORANGE))
    logit = np.array([[0.0, 3.0, -1.0], [-2.0, 0.5, -3.0], [60.0, -60.0, -60.0], [-60.0] * 3], np.float32)
    raw = {"color_logit": columns(logit, Array3f)}
    colors = []
    for pull in (0.0, 0.3, 1.0):
        moved = recolor(raw, palette, pull)
        dr.eval(moved)
        moved = np.stack([c.numpy() for c in moved], -1)
        assert np.isfinite(moved).all()
        color = 1 / (1 + np.exp(-moved.astype(np.float64)))
        colors.append(color / color.max(1, keepdims=True))
    assert np.abs(moved[3] - logit[3]).max() == 0, "black has no colour that could be another"
    away = [np.abs(c[:3] - of_light(ORANGE)).max(1) for c in colors]
    assert (away[0] >= away[1]).all() and (away[1] > away[2]).all() and (away[2] < 0.25).all()
    level = (1 / (1 + np.exp(-logit.astype(np.float64)))).max(1)[:3]
    assert np.abs((1 / (1 + np.exp(-moved.astype(np.float64)))).max(1)[:3] - level).max() < 1e-3, "as bright as before"
