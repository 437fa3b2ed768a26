"""Phase spread of Gaussians on waves whose wavelength is known."""

import numpy as np
import pytest

from gof.core.fields import VelocityField
from gof.evaluate import dve
from gof.evaluate.wavelength import LIMIT_RAD, phase_spread, share_of_short_waves
from tests.evaluate.analytic import Analytic, covariance, make_gaussians, waves


def parts(g):
    return g.position.astype(float), g.scale.astype(float), g.rotation


@pytest.mark.parametrize("k_sigma", [0.5, 1.0, 1.5, 2.0, 3.0])
def test_oblique_plane_wave(k_sigma):
    """A wave across the grid axes, round Gaussians at every phase: k sigma within a few per cent of the truth."""
    direction = np.array([1, 2, -2.0]) / 3
    g = make_gaussians(200, scale=np.full((200, 3), 0.1))
    k = k_sigma / 0.1
    wave = Analytic(lambda p: np.sin(p @ direction * k)[:, None] * np.array([0.5, -1, 2]), voxel_size=0.02)
    got = phase_spread(wave, *parts(g))
    assert np.median(got) == pytest.approx(k_sigma, rel=0.06)
    # a crest alone is hard to tell from a long wave, so single values scatter; their side of the limit does not
    if k_sigma <= 1 or k_sigma >= 2:
        assert np.mean((got > LIMIT_RAD) == (k_sigma > LIMIT_RAD)) > 0.97


def test_a_thin_gaussian_along_the_crests_has_no_spread():
    x = np.random.default_rng(0).uniform(-1, 1, (50, 3))
    wave = Analytic(lambda p: np.sin(20 * p[:, [0]]) * np.array([0, 0, 1.0]), voxel_size=0.02)
    along = phase_spread(wave, x, np.tile([0.01, 0.3, 0.3], (50, 1)), np.tile([1.0, 0, 0, 0], (50, 1)))
    across = phase_spread(wave, x, np.tile([0.3, 0.01, 0.01], (50, 1)), np.tile([1.0, 0, 0, 0], (50, 1)))
    assert along.max() < 1 and across.min() > 4


@pytest.mark.parametrize("flow", ["abc", "taylor_green"])
def test_flows_of_several_waves(flow):
    """ABC: three waves of the same k along the axes, so the axes' mean (k sigma)^2; Taylor-Green: |k| = sqrt 2 k."""
    k, s = 8.0, 0.15
    g = make_gaussians(300, scale=np.full((300, 3), s))
    got = phase_spread(Analytic(waves(k)[flow][0], voxel_size=0.02), *parts(g))
    assert np.median(got) == pytest.approx(k * s * (1 if flow == "abc" else np.sqrt(2)), rel=0.05)
    turned = make_gaussians(300, scale=np.tile([0.3, 0.05, 0.05], (300, 1)))
    mean_square = np.trace(covariance(turned.scale, turned.rotation), axis1=1, axis2=2) / 3
    if flow == "abc":
        got = phase_spread(Analytic(waves(k)[flow][0], voxel_size=0.02), *parts(turned))
        assert np.median(got / (k * np.sqrt(mean_square))) == pytest.approx(1, rel=0.1)


@pytest.mark.parametrize("function", [np.ones_like, np.zeros_like, lambda p: p @ np.diag([1.0, -2, 3]) + 5])
def test_no_curvature_no_spread(function):
    g = make_gaussians(40)
    assert (phase_spread(Analytic(function, voxel_size=0.02), *parts(g)) == 0).all()
    grid = VelocityField.from_array(np.zeros((40, 40, 40, 3)), (-2, -2, -2), 0.1)
    filled = VelocityField(
        function(grid.cell_centers().reshape(-1, 3)).reshape(40, 40, 40, 3).astype(np.float32), grid.index_to_world
    )
    assert (phase_spread(filled, *parts(g)) == 0).all()  # float32 rounding is no wave


def test_outside_and_across_the_border():
    """The step to zero at the border is no structure of the flow."""
    g = make_gaussians(50, position=np.random.default_rng(1).uniform(-1.3, 1.3, (50, 3)))
    field = Analytic(lambda p: 0 * p + 2, -1.0, 1.0, voxel_size=0.05)
    assert (phase_spread(field, *parts(g)) == 0).all()
    far = make_gaussians(3, position=np.full((3, 3), 9.0))
    assert (phase_spread(field, *parts(far)) == 0).all()


def test_share_in_the_score():
    """Half of the weight in Gaussians of 3 rad, half of 0.3 rad; above 128 Gaussians by an even sample."""
    wave = Analytic(lambda p: np.sin(10 * p[:, [0]]) * np.array([0, 0, 1.0]) + 1, voxel_size=0.02)
    for n in (100, 4000):
        scale = np.where(np.arange(n)[:, None] % 2 == 0, [0.3, 0.02, 0.02], [0.03, 0.02, 0.02])
        g = make_gaussians(
            n, scale=scale, rotation=np.tile([1.0, 0, 0, 0], (n, 1)), opacity=np.where(np.arange(n) % 2 == 0, 0.05, 0.5)
        )
        got = dve(g, wave, 0.0)
        assert got.weight_short_waves == pytest.approx(0.5, abs=0.13)
    assert share_of_short_waves(wave, np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 4)), np.zeros(0)) == 0


def test_beyond_the_limit_three_nodes_fail_and_below_they_do_not():
    wave = Analytic(lambda p: np.sin(10 * p[:, [0]]) * np.array([0, 0, 1.0]) + np.array([0, 0, 0.05]), voxel_size=0.02)
    errors = {}
    for s in (0.05, 0.1, 0.25):
        g = make_gaussians(500, scale=np.tile([s, 0.02, 0.02], (500, 1)), rotation=np.tile([1.0, 0, 0, 0], (500, 1)))
        a, b = dve(g, wave, 0.0, order=3), dve(g, wave, 0.0, order=7)
        errors[s] = abs(a.cos_sim - b.cos_sim) + abs(a.l2 / b.l2 - 1), a.weight_short_waves
    assert errors[0.05][0] < 0.01 and errors[0.05][1] < 0.01
    assert errors[0.25][0] > 0.3 and errors[0.25][1] > 0.99
