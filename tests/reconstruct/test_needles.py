"""Gaussians that are long along the rays are cut, and the cameras see what they saw."""

import numpy as np
import pytest

from gof.core.gaussians import TransientGaussians
from gof.core.rotations import rotation_matrices
from gof.reconstruct.needles import LONGEST, blunt, is_one_sided
from gof.render import render
from tests.conftest import arc, look_at

EYE = np.array([0.0, -3.0, 1.0])


def gaussian(position, scale, rotation=(1.0, 0, 0, 0)):
    return TransientGaussians(
        position=np.array([position], np.float32),
        velocity=np.zeros((1, 3), np.float32),
        t_mu=np.zeros(1, np.float32),
        t_sigma=np.full(1, np.inf, np.float32),
        scale=np.array([scale], np.float32),
        rotation=np.array([rotation], np.float32),
        opacity=np.full(1, 0.8, np.float32),
        color=np.ones((1, 3), np.float32),
        dynamic=np.ones(1, bool),
    )


def covariance(gaussians):
    axes = rotation_matrices(gaussians.rotation)
    return np.einsum("nij,nj,nkj->nik", axes, gaussians.scale.astype(float) ** 2, axes)


def test_a_needle_is_cut_to_what_is_allowed_and_looks_the_same_from_where_it_was_seen():
    """Along y, four times as long as wide, straight before the camera: by hand, 1.5 times is left of it."""
    needle = gaussian((0, 0, 1), (0.02, 0.08, 0.02))
    cut = blunt(needle, EYE)
    assert covariance(cut)[0] == pytest.approx(np.diag([0.02**2, (LONGEST * 0.02) ** 2, 0.02**2]), rel=1e-5, abs=1e-10)
    camera, side = look_at("front", EYE, [0, 0, 1]), look_at("side", [3.0, 0, 1], [0, 0, 1])
    before, after = (
        [render(g, c, 0.0, background=np.zeros((c.height, c.width, 3), np.float32))["color"] for c in (camera, side)]
        for g in (needle, cut)
    )
    assert before[0].max() > 0.5 and np.abs(after[0] - before[0]).max() < 2e-3
    assert after[1].sum() < 0.6 * before[1].sum(), "from the side it is short"


def test_a_leaning_needle_keeps_what_is_across_the_ray():
    turn = np.array([np.cos(0.3), 0, 0, np.sin(0.3)])  # about z, by 0.6
    needle = gaussian((0.2, 0.1, 1.1), (0.02, 0.1, 0.03), turn)
    cut = blunt(needle, EYE)
    ray = needle.position[0] - EYE
    ray /= np.linalg.norm(ray)
    flat = np.eye(3) - np.outer(ray, ray)
    assert flat @ covariance(cut)[0] @ flat == pytest.approx(flat @ covariance(needle)[0] @ flat, abs=1e-9)
    along = ray @ covariance(cut)[0] @ ray
    assert along == pytest.approx(LONGEST**2 * 0.5 * np.trace(flat @ covariance(needle)[0] @ flat), rel=1e-4)


@pytest.mark.parametrize("scale", [(0.08, 0.02, 0.02), (0.02, 0.02, 0.08), (0.03, 0.04, 0.03), (0.01, 0.01, 0.01)])
def test_others_stay_as_they_are(scale):
    """Long across the view, or hardly longer along it."""
    one = gaussian((0, 0, 1), scale)
    cut = blunt(one, EYE)
    assert (cut.scale == one.scale).all() and (cut.rotation == one.rotation).all()


def test_bad_points():
    """A Gaussian at the eye itself has no ray, and one of no width at all is no longer than wide."""
    at_eye, thin = gaussian(EYE, (0.02, 0.08, 0.02)), gaussian((0, 0, 1), (1e-12, 0.1, 1e-12))
    assert (blunt(at_eye, EYE).scale == at_eye.scale).all()
    cut = blunt(thin, EYE)
    assert np.isfinite(cut.scale).all() and np.isfinite(cut.rotation).all() and (cut.scale > 0).all()
    assert cut.scale.max() < 1e-9


def test_cameras_far_apart_tell_how_long_a_gaussian_is():
    """35 degrees to either side of the middle, or 9; one camera tells nothing."""
    flame = np.array([0.0, 0, 1])
    near = [look_at(f"cam_{k}", [3 * np.sin(a), -3 * np.cos(a), 1.0], flame) for k, a in enumerate((-0.16, 0, 0.16))]
    assert is_one_sided(near, flame) and is_one_sided(near[:1], flame)
    assert not is_one_sided(arc(3), flame)


def test_needles_of_hardly_any_width_in_all_directions():
    """The width across is the difference of two nearly equal numbers, below 0 for some by rounding."""
    rng = np.random.default_rng(0)
    for place in rng.normal(size=(50, 3)):
        ray = (place - EYE) / np.linalg.norm(place - EYE)
        half = np.array([1 + ray[0], 0, -ray[2], ray[1]])  # turns x onto the ray
        cut = blunt(gaussian(place, (0.1, 1e-12, 1e-12), half / np.linalg.norm(half)), EYE)
        assert np.isfinite(cut.scale).all() and np.isfinite(cut.rotation).all() and (cut.scale > 0).all()
