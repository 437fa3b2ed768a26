"""The compiled quadrature against its plain float64 twin."""

import numpy as np
import pytest

from gof.core.fields import VelocityField
from gof.evaluate import quadrature
from gof.evaluate.expectation import COMPILED_FROM, expected_velocity, expected_velocity_plain
from gof.evaluate.grid_quadrature import expected_velocity_on_grid
from tests.evaluate.analytic import make_gaussians


def field(shape=(9, 12, 7), dtype=np.float32, seed=0, skewed=False) -> VelocityField:
    rng = np.random.default_rng(seed)
    index_to_world = np.diag([0.1, 0.1, 0.1, 1.0])
    if skewed:  # a turned domain with unequal cells
        q = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        index_to_world[:3, :3] = q @ np.diag([0.1, 0.13, 0.08])
    index_to_world[:3, 3] = index_to_world[:3, :3] @ (-np.array(shape) / 2)
    return VelocityField(rng.normal(size=(*shape, 3)).astype(dtype), index_to_world)


def shape_of(g):
    return g.position.astype(float), g.scale.astype(float), g.rotation


def assert_agree(f, g, order=3, atol=2e-6):
    got, twin = expected_velocity_on_grid(f, *shape_of(g), order), expected_velocity_plain(f, *shape_of(g), order)
    for name, a, b in zip(got._fields, got, twin, strict=True):
        np.testing.assert_allclose(a, b, atol=atol, err_msg=name)
    return got


@pytest.mark.parametrize("order", quadrature.ORDERS)
def test_agrees_inside_across_the_border_and_outside(order):
    got = assert_agree(field(), make_gaussians(2000), order)
    assert (got.inside == 1).any() and (got.inside < 1e-6).any()
    assert order == 1 or ((got.inside > 0.1) & (got.inside < 0.9)).any()


def test_turned_domain_with_unequal_cells():
    assert_agree(field(skewed=True), make_gaussians(1000))


@pytest.mark.parametrize("shape", [(1, 1, 1), (1, 5, 2), (2, 2, 2)])
def test_axes_of_one_cell(shape):
    g = make_gaussians(
        500, scale=np.full((500, 3), 0.03), position=np.random.default_rng(1).uniform(-0.3, 0.3, (500, 3))
    )
    assert_agree(field(shape), g)


def test_half_precision_store():
    assert_agree(field(dtype=np.float16), make_gaussians(300))


def test_on_the_faces_of_cells_and_of_the_domain():
    """Points exactly on centres, faces and the border belong where the field says they do."""
    f = VelocityField.from_array(
        np.random.default_rng(2).normal(size=(4, 4, 4, 3)).astype(np.float32), (-1, -1, -1), 0.5
    )
    axis = np.arange(-1.25, 1.3, 0.25)
    points = np.stack(np.meshgrid(axis, axis, axis), -1).reshape(-1, 3)
    got = expected_velocity_on_grid(f, points, np.full_like(points, 1e-9), np.tile([1.0, 0, 0, 0], (len(points), 1)), 1)
    np.testing.assert_allclose(got.centre, f.sample(points), atol=1e-6)
    np.testing.assert_array_equal(got.inside == 1, f.contains(points))


def test_precision_does_not_fall_with_the_size_of_the_grid():
    """A linear field far from the grid's first cell: float32 world or index coordinates would lose digits here."""
    n = 3000
    ramp = np.zeros((n, 2, 2, 3), np.float32)
    ramp[..., 0] = (np.arange(n, dtype=np.float32) % 2)[:, None, None]  # zigzag: steep, exactly known
    f = VelocityField.from_array(ramp, (1000.0, 0, 0), 0.01)
    x = np.array([[1000 + 0.01 * (2901.5 + part), 0.01, 0.01] for part in (0.1, 0.25, 0.7)])
    got = expected_velocity_on_grid(f, x, np.full((3, 3), 1e-6), np.tile([1.0, 0, 0, 0], (3, 1)), 3)
    np.testing.assert_allclose(got.mean[:, 0], [0.9, 0.75, 0.3], atol=2e-6)


def test_nan_is_passed_on_where_it_is_read_and_far_points_are_outside():
    f = field()
    f.velocity[4, 6, 3] = np.nan
    x = np.array([[0, 0, 0.0], [0.4, 0.5, 0.3], [1e12, 0, 0], [-1e30, 1e30, 5]])
    got = expected_velocity_on_grid(f, x, np.full((4, 3), 1e-3), np.tile([1.0, 0, 0, 0], (4, 1)), 3)
    assert np.isnan(got.mean[0]).all() and np.isfinite(got.mean[1:]).all()
    assert (got.inside[2:] < 1e-6).all() and (got.mean[2:] == 0).all()


def test_many_gaussians_on_a_grid_take_the_compiled_path(monkeypatch):
    called = []
    monkeypatch.setattr(
        "gof.evaluate.grid_quadrature.expected_velocity_on_grid",
        lambda *a: called.append(len(a[1])) or expected_velocity_on_grid(*a),
    )
    g = make_gaussians(COMPILED_FROM // 27 + 1)
    expected_velocity(field(), *shape_of(g))
    expected_velocity(field(), *shape_of(g[:10]))
    assert called == [len(g)]


def test_launches_do_not_change_the_answer(monkeypatch):
    g = make_gaussians(1000)
    whole = expected_velocity_on_grid(field(), *shape_of(g), 3)
    monkeypatch.setattr("gof.evaluate.grid_quadrature.LAUNCH", 300)
    for a, b in zip(whole, expected_velocity_on_grid(field(), *shape_of(g), 3), strict=True):
        np.testing.assert_array_equal(a, b)
