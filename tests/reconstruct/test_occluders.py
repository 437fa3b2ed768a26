"""What stands before the flame, found by the other cameras: a ball of light whose views are known exactly."""

import numpy as np
import pytest

from gof.reconstruct.occluders import blocked_views
from gof.reconstruct.voxels import carve
from tests.conftest import arc
from tests.reconstruct.test_voxels import ball

CAMERAS = arc(3)


def seen(bar=None):
    """Masks and light (F, C, H, W) of two equal frames; camera 0 does not see what is in `bar` (H, W)."""
    _, lengths = ball(CAMERAS)
    light = lengths.copy()
    if bar is not None:
        light[0][bar] = 0
    return np.stack([light > 0] * 2), np.stack([light] * 2)


def bar_across():
    """A horizontal bar over the middle of camera 0's ball, and what of the ball it hides: (H, W) bool each."""
    masks, _ = ball(CAMERAS)
    rows = np.flatnonzero(masks[0].any(1))
    middle, half = int(rows.mean()), max(2, len(rows) // 8)
    bar = np.zeros_like(masks[0])
    bar[middle - half : middle + half + 1] = True
    return bar, bar & masks[0]


def test_a_bar_before_the_flame_is_found_where_it_hides_it():
    bar, hidden = bar_across()
    blocked = blocked_views(CAMERAS, *seen(bar))
    assert not blocked[1:].any(), "the others see everything"
    assert not (blocked[0] & ~bar).any(), "only the bar stands in the way"
    assert (blocked[0] & hidden).sum() > 0.8 * hidden.sum()


def test_what_a_bar_hides_stays_in_the_hull():
    whole = len(carve(CAMERAS, seen()[0], 32).center)
    bar, _ = bar_across()
    masks, light = seen(bar)
    size = [len(carve(CAMERAS, masks, 32, blocked=b).center) for b in (None, blocked_views(CAMERAS, masks, light))]
    assert size[0] < 0.85 * whole, "the bar cuts a slice out of it"
    assert size[1] == pytest.approx(whole, rel=0.06)


def test_nothing_is_blocked_where_nothing_is():
    assert not blocked_views(CAMERAS, *seen()).any()
    masks, light = seen()
    assert not blocked_views(CAMERAS, np.zeros_like(masks), np.zeros_like(light)).any(), "no flame at all"


def test_two_flames_with_air_between_are_not_one_behind_a_post():
    """The gap is a gap for every camera: the others do not fill it."""
    cameras = arc(3)
    balls = [ball(cameras, center=(x, 0, 1.0), radius=0.15)[1] for x in (-0.25, 0.25)]
    light = np.stack([sum(balls)] * 2)
    assert not blocked_views(cameras, light > 0, light).any()


def test_two_cameras_cannot_tell():
    bar, _ = bar_across()
    masks, light = seen(bar)
    assert not blocked_views(CAMERAS[:2], masks[:, :2], light[:, :2]).any()
