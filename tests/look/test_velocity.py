"""The velocity panels show what really moves on the screen."""

import numpy as np
import pytest

from gof.core.colour import direction_colors
from gof.evaluate.screen_motion import ScreenVelocity, screen_velocities, screen_velocity
from gof.look.velocity import MIN_ALPHA, draw, legend, living
from tests.conftest import arc
from tests.evaluate.analytic import make_gaussians


def blob(n=1, **changes):
    return make_gaussians(
        n,
        position=np.tile([0.1, -0.2, 1.1], (n, 1)),
        scale=np.full((n, 3), 0.15),
        opacity=np.full(n, 0.8),
        t_mu=np.full(n, 0.5),
        **changes,
    )


def test_screen_velocity_is_the_projected_motion_per_second():
    camera = arc(3)[2]
    g = blob(velocity=[[0.7, -0.4, 1.3]])
    drawn = screen_velocity(g, camera, 0.5)
    h = 1e-4
    before, after = (camera.project(g.position.astype(float) + s * h * g.velocity.astype(float))[0][0] for s in (-1, 1))
    seen = drawn.alpha > 0.05
    assert seen.sum() > 20
    np.testing.assert_allclose(
        drawn.flow[seen], np.tile((after - before) / (2 * h), (seen.sum(), 1)), rtol=1e-4, atol=1e-3
    )
    assert (drawn.flow[drawn.alpha == 0] == 0).all()


def test_replacing_the_velocity_moves_nothing():
    camera, g = arc(1)[0], blob(velocity=[[0.7, -0.4, 1.3]])
    own, other = screen_velocity(g, camera, 0.6), screen_velocity(g, camera, 0.6, -g.velocity)
    np.testing.assert_array_equal(own.alpha, other.alpha)
    np.testing.assert_allclose(own.flow, -other.flow, atol=1e-3)
    for alone, together in zip((own, other), screen_velocities(g, camera, 0.6, [g.velocity, -g.velocity]), strict=True):
        np.testing.assert_array_equal(alone.alpha, together.alpha)
        np.testing.assert_array_equal(alone.flow, together.flow)


@pytest.mark.parametrize("moving", [0, 1], ids=["front", "back"])
def test_opacity_weighted_mean_of_two(moving):
    """One moves, one is still: the ray's mean weighs the front one by its alpha, the back one by what is left."""
    camera = arc(1)[0]
    g = blob(2)
    g.velocity[:] = 0
    g.velocity[moving, 0] = 2.0
    g.position[1] += 0.05 * (g.position[1] - camera.position)  # behind the first, on the same line of sight
    drawn = screen_velocity(g, camera, 0.5)
    single = [screen_velocity(g[k : k + 1], camera, 0.5) for k in range(2)]
    i = np.unravel_index(single[0].alpha.argmax(), single[0].alpha.shape)
    front, back = (s.alpha[i] for s in single)
    weight = [front, back * (1 - front)]
    share = drawn.flow[i][0] / single[moving].flow[i][0]
    assert share == pytest.approx(weight[moving] / sum(weight), abs=1e-3)


def test_nothing_to_draw_and_behind_the_camera():
    camera = arc(1)[0]
    empty = screen_velocity(make_gaussians(0), camera, 0.0)
    assert empty.flow.shape == (64, 36, 2) and not empty.alpha.any()
    behind = make_gaussians(2, position=[[0, -9.0, 1], [0, 0, 1.0]])
    assert np.isfinite(screen_velocity(behind, camera, 0.0).flow).all()


def test_living_drops_the_static_and_the_dead():
    g = make_gaussians(
        4,
        dynamic=[True, True, False, True],
        t_mu=[0, 9.0, 0, 0],
        t_sigma=np.full(4, 0.1),
        opacity=[0.5, 0.5, 0.5, 1e-4],
    )
    assert len(living(g, 0.0)) == 1


def test_colours_tell_direction_and_speed_evenly():
    angles = np.deg2rad(np.arange(0, 360, 10))
    full = direction_colors(np.stack([np.cos(angles), np.sin(angles)], -1) * 5, 5.0)
    assert ((full >= 0) & (full <= 1)).all()
    grey = full @ [0.2126, 0.7152, 0.0722]
    assert grey.max() - grey.min() < 0.25  # no direction looks much faster than another
    distance = np.linalg.norm(full[:, None] - full[None], axis=-1) + 9 * np.eye(len(full))
    assert distance.min() > 0.03  # all directions differ
    up = direction_colors(np.array([0.0, -1.0]), 1.0)
    assert up[2] > up[0] + 0.3  # up is blue
    slow = direction_colors(np.array([[0.0, -0.2], [0.0, -0.6], [0, -1.0], [0, -7.0]]), 1.0).sum(-1)
    assert slow[0] < slow[1] < slow[2] == slow[3]
    assert np.ptp(direction_colors(np.zeros(2), 1.0)) < 0.02 and np.isfinite(direction_colors(np.zeros(2), 0.0)).all()


def test_arrows_only_where_something_is():
    flow = np.zeros((200, 140, 2))
    flow[..., 0] = 3.0
    alpha = np.zeros((200, 140))
    alpha[50:150, :70] = 0.9
    panel = draw(ScreenVelocity(flow, alpha), 3.0, scale=2)
    assert panel.shape == (400, 280, 3) and panel.dtype == np.uint8
    white = (panel > 200).all(-1)
    assert white[100:300, :150].sum() > 300 and not white[:, 160:].any() and not white[:90].any()
    faint = draw(ScreenVelocity(flow, np.full_like(alpha, MIN_ALPHA / 2)), 3.0)
    assert not (faint > 200).all(-1).any()
    still = draw(ScreenVelocity(0 * flow, alpha), 1.0)  # at rest: drawn, without arrows
    assert still.std() > 0 and not (still > 200).all(-1).any()


def test_legend():
    wheel = legend(64)
    assert wheel.shape == (64, 64, 4) and wheel[0, 0, 3] == 0 and wheel[32, 32, 3] == 255
    np.testing.assert_allclose(wheel[1, 32, :3] / 255, direction_colors(np.array([0.0, -0.96]), 1.0), atol=0.03)
