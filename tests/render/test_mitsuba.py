"""Splatting against Mitsuba's ray-traced ellipsoids on a matched scene."""

import dataclasses

import numpy as np
import pytest

from gof.core.cameras import Camera
from gof.core.errors import DataFormatError
from gof.core.gaussians import TransientGaussians
from tests.render.scenes import camera, gaussians

pytest.importorskip("mitsuba")

from gof.render import render
from gof.render.mitsuba_scene import ellipsoids, render_mitsuba, sensor


def matched(distance=2.0, width=64, height=48) -> Camera:
    """Square pixels; the further away, the longer the lens: only the perspective inside a Gaussian goes."""
    cam = camera(width, height)
    W, K = cam.world_to_camera.copy(), cam.K.copy()
    W[2, 3] += distance - 2
    K[0, 0] = K[1, 1] = K[0, 0] * distance / 2
    return Camera("matched", width, height, K, W)


def flame(n=40, seed=3, size=0.07):
    g = gaussians(n, seed, size, spread=0.25)
    r = np.random.default_rng(seed)
    return TransientGaussians(
        g["position"],
        r.normal(size=(n, 3)) * 0.1,
        np.zeros(n),
        np.full(n, 0.2),
        g["scale"],
        g["rotation"],
        0.3 * g["opacity"],
        np.clip(g["color"], 0, 1),
        np.arange(n) % 2 == 0,
    )


def test_images_agree_on_a_matched_scene():
    """What remains: perspective inside a Gaussian (less from afar), the cuts at 1/255 and 3 sigma, order, noise."""
    errors = {}
    for distance in (2.0, 6.0):
        cam = matched(distance)
        ours, theirs = render(flame(), cam, 0.05, antialias=True)["color"], render_mitsuba(flame(), cam, 0.05, spp=64)
        errors[distance] = np.abs(ours - theirs).sum() / ours.sum()
        assert abs(ours.mean() / theirs.mean() - 1) < 0.03
    assert errors[6.0] < errors[2.0] < 0.075 and errors[6.0] < 0.045


def test_principal_point_and_orientation_match():
    for dx, dy in ((0, 0), (6, 0), (0, -5)):
        cam = matched(4.0)
        cam = dataclasses.replace(cam, K=cam.K + np.array([[0, 0, dx], [0, 0, dy], [0, 0, 0.0]]))
        g = flame()[:1]
        g.position[:] = [0.05, 0, 0.1]
        ours, theirs = render(g, cam, 0.0)["color"].sum(-1), render_mitsuba(g, cam, 0.0, spp=32).sum(-1)
        y, x = np.mgrid[: cam.height, : cam.width]
        centre = lambda a: np.array([(x * a).sum(), (y * a).sum()]) / a.sum()  # noqa: E731, B023
        np.testing.assert_allclose(centre(ours), centre(theirs), atol=0.15)


def test_what_mitsuba_cannot_hold_is_named():
    with pytest.raises(DataFormatError, match="at least one"):
        ellipsoids(flame()[:0], 0.0)
    with pytest.raises(DataFormatError, match="fx = fy"):
        sensor(camera())
