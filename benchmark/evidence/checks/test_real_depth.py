"""The score of real flames' depth, where the answer is known: a sheet of light before a wall, square to the camera."""

import numpy as np
import pytest

from gof.core.gaussians import TransientGaussians
from gof_benchmark.evidence.real_depth import Drawn, HeldOutView, scores, what_is_drawn
from tests.conftest import look_at

CAMERA = look_at("a", (0, -4, 0), (0, 0, 0), width=61, height=61, focal_px=50.0)


def sheet(distance, half_width, opacity):
    """Flat Gaussians side by side, that far from the camera."""
    x, z = (axis.ravel() for axis in np.meshgrid(*[np.arange(-half_width, half_width + 0.01, 0.1)] * 2))
    n = len(x)
    return TransientGaussians(
        position=np.stack([x, np.full(n, distance - 4.0), z], 1),
        velocity=np.zeros((n, 3)),
        t_mu=np.zeros(n),
        t_sigma=np.full(n, np.inf),
        scale=np.tile([0.1, 1e-3, 0.1], (n, 1)),
        rotation=np.tile([1.0, 0, 0, 0], (n, 1)),
        opacity=np.full(n, opacity),
        color=np.ones((n, 3)),
        dynamic=np.ones(n, bool),
    )


@pytest.mark.parametrize("nearer", [0.0, 0.1, -0.2])
def test_how_far_off_a_flame_stands(nearer):
    wall, flame = sheet(6.0, 5.0, 0.99), sheet(4 * (1 - nearer), 1.0 * (1 - nearer), 0.99)  # as large in the picture
    where = np.zeros((61, 61), bool)
    where[19:42, 19:42] = True  # within the flame, which is 25 pixels wide, and two more on each side at half its light
    depth = np.full((61, 61), 6.0)
    depth[16:45, 16:45] = 4.0
    moment = HeldOutView(CAMERA, 0.0, where, depth, 1 / depth)
    error, off = scores(Drawn(TransientGaussians.concatenate([wall, flame]), flame), moment)
    assert off == pytest.approx(abs(nearer), abs=2e-3)
    assert error < 0.02, "a scale and an offset always fit two distances: why `off` is printed too"


def test_a_wall_alone_is_no_flame():
    wall, nothing = sheet(6.0, 5.0, 0.99), sheet(4.0, 1.0, 0.01)
    where = np.zeros((61, 61), bool)
    where[19:42, 19:42] = True
    moment = HeldOutView(CAMERA, 0.0, where, np.full((61, 61), 4.0), np.full((61, 61), 1 / 4))
    assert scores(Drawn(wall, wall), moment)[1] == pytest.approx(0.5, abs=2e-3)
    assert np.isnan(scores(Drawn(wall, nothing), moment)[1]), "what is hardly there stands nowhere"
    assert np.isnan(
        scores(Drawn(wall, wall), HeldOutView(CAMERA, 0.0, where & False, moment.depth, moment.disparity))
    ).all()


def test_what_is_missing_is_named(tmp_path):
    with pytest.raises(Exception, match="gof_0.*is missing; make it with"):
        what_is_drawn(tmp_path)
