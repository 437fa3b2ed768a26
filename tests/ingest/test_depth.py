"""Stereo depth, its completion and alignment against the exact depth of drawn planes."""

import numpy as np
import pytest

from gof.core.cameras import Camera
from gof.core.errors import DataFormatError, GofError
from gof.ingest import depth as d
from gof.ingest import stereo
from tests.ingest.scene import cameras, draw
from tests.plys import read_ply

NEAR, FAR = 1.5, 8.0


@pytest.fixture(scope="module")
def views():
    rig = cameras()
    drawn = [draw(c) for c in rig]
    return rig, [p for p, _ in drawn], [z for _, z in drawn]


def error(found, truth):
    both = np.isfinite(found) & np.isfinite(truth)
    return both.sum() / np.isfinite(truth).sum(), np.abs(found[both] - truth[both]) / truth[both]


@pytest.mark.parametrize("scale", [1.0, 1000.0])
@pytest.mark.long
def test_semi_global_matching(views, scale):
    _, pictures, truth = views
    rig = cameras(scale)
    for reference, other in ((0, 1), (2, 1)):  # with a camera to the right, and to the left
        found = stereo.semi_global(pictures, rig, reference, other, NEAR * scale, FAR * scale)
        cover, relative = error(found, truth[reference] * scale)
        assert cover > 0.5 and np.median(relative) < 0.01 and (relative < 0.05).mean() > 0.95


@pytest.mark.long
def test_consistency_removes_what_no_other_view_confirms(views):
    rig, _, truth = views
    spoilt = [z.astype(np.float32).copy() for z in truth]
    spoilt[0][100:140, 100:140] *= 0.7
    kept = stereo.consistent(spoilt, rig)
    assert np.isnan(kept[0][100:140, 100:140]).mean() > 0.99
    assert np.isfinite(kept[1]).mean() > 0.8


def test_alignment_is_exact_and_robust():
    rng = np.random.default_rng(0)
    z = rng.uniform(1, 20, (40, 50))
    relative = (1 / z - 0.02) / 3.0
    z[rng.random(z.shape) < 0.3] = np.nan
    wrong = np.where(rng.random(z.shape) < 0.2, z * 0.3, z)
    a, b = d.align(relative, wrong)
    assert a == pytest.approx(3, rel=0.03) and b == pytest.approx(0.02, abs=0.01)
    for bad, message in ((np.full(z.shape, np.nan), "0 pixels"),):
        with pytest.raises(GofError, match=message):
            d.align(relative, bad)
    with pytest.raises(GofError, match="constant"):
        d.align(np.ones(z.shape), z)
    with pytest.raises(GofError, match="falls"):
        d.align(-relative, z)


@pytest.mark.parametrize("scale", [1.0, 1000.0])
def test_completion_stops_at_edges(scale):
    picture = np.full((60, 80, 3), 40, np.uint8)
    picture[:, 40:] = 200
    truth = np.where(np.arange(80) < 40, 2.0, 6.0)[None].repeat(60, 0) * scale
    known = np.full(truth.shape, np.nan)
    known[20:40, 5:15], known[20:40, 65:75] = truth[20:40, 5:15], truth[20:40, 65:75]
    whole = d.complete(known, picture)
    assert np.isfinite(whole).all()
    assert (np.abs(whole - truth) < 0.05 * truth).mean() > 0.95
    with pytest.raises(GofError, match="no pixel"):
        d.complete(np.full((4, 4), np.nan), picture[:4, :4])


def test_points_lie_where_the_planes_are(views, tmp_path):
    rig, pictures, truth = views
    camera: Camera = rig[0]
    points, colors = d.back_project(truth[0], pictures[0], camera)
    pixels, _ = camera.project(points)
    rows, columns = np.nonzero(np.isfinite(truth[0]))
    np.testing.assert_allclose(pixels, np.column_stack([columns, rows]) + 0.5, atol=1e-6)
    d.write_points(tmp_path / "p.ply", points, colors)
    vertex, _ = read_ply(tmp_path / "p.ply")
    np.testing.assert_allclose(vertex["z"], points[:, 2], atol=1e-5)
    np.testing.assert_array_equal(vertex["blue"], colors[:, 2])


def test_weights_that_are_not_there_are_named(tmp_path):
    with pytest.raises(DataFormatError, match=r"Depth-Anything-V2.*completed"):
        d.monocular(np.zeros((8, 8, 3), np.uint8), tmp_path)
