"""The quadrature against closed forms and Monte Carlo."""

import itertools

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gof.core.errors import GofError
from gof.core.fields import VelocityField
from gof.core.rotations import rotation_matrices
from gof.evaluate.expectation import CHUNK_POINTS, expected_velocity
from gof.evaluate.quadrature import ORDERS, product_rule
from tests.evaluate.analytic import Analytic, covariance, make_gaussians, waves


def exact_shape(g):
    return g.position.astype(float), g.scale.astype(float), g.rotation


@pytest.mark.parametrize("order", ORDERS)
def test_product_rule_has_the_moments_of_a_standard_normal(order):
    nodes, weights = product_rule(order)
    assert nodes.shape == (order**3, 3) and weights.sum() == pytest.approx(1, abs=1e-15) and (weights > 0).all()
    assert (nodes[order**3 // 2] == 0).all()  # the middle node is the centre
    double_factorial = {0: 1, 2: 1, 4: 3, 6: 15, 8: 105, 10: 945, 12: 10395}
    for power in range(0, 2 * order):
        assert weights @ nodes[:, 1] ** power == pytest.approx(double_factorial.get(power, 0), abs=1e-9, rel=1e-12)
    # one degree further the rule fails, so the test above can fail: n nodes miss moment 2n by n!
    miss = double_factorial.get(2 * order, 135135) - weights @ nodes[:, 1] ** (2 * order)
    assert miss == pytest.approx(float(np.prod(np.arange(1, order + 1))), rel=1e-9)


@pytest.mark.parametrize("order", [0, 2, 4, 9])
def test_other_orders_are_refused(order):
    with pytest.raises(GofError, match="order"):
        product_rule(order)


def test_rotation_matrices_match_scipy():
    q = np.random.default_rng(0).normal(size=(20, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    np.testing.assert_allclose(rotation_matrices(q), Rotation.from_quat(q[:, [1, 2, 3, 0]]).as_matrix(), atol=1e-14)


@pytest.mark.parametrize("order", ORDERS)
def test_linear_field_is_exact_at_every_order(order):
    A, b = np.random.default_rng(1).normal(size=(3, 3)), np.array([0.3, -1, 2])
    x, s, q = exact_shape(make_gaussians())
    got = expected_velocity(Analytic(lambda p: p @ A.T + b), x, s, q, order)
    np.testing.assert_allclose(got.mean, x @ A.T + b, rtol=1e-12, atol=1e-13)
    np.testing.assert_allclose(got.centre, x @ A.T + b, rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("order,exact", [(1, False), (3, True), (5, True), (7, True)])
def test_quadratic_field_needs_order_3(order, exact):
    Q = np.random.default_rng(2).normal(size=(3, 3, 3))
    x, s, q = exact_shape(make_gaussians())
    truth = np.einsum("kij,ni,nj->nk", Q, x, x) + np.einsum("kij,nij->nk", Q, covariance(s, q))
    got = expected_velocity(Analytic(lambda p: np.einsum("kij,ni,nj->nk", Q, p, p)), x, s, q, order).mean
    assert (np.abs(got - truth).max() < 1e-12) == exact


@pytest.mark.parametrize("flow", ["abc", "taylor_green"])
def test_waves_against_the_analytic_expectation(flow):
    """Error falls with the order; at k s <= 0.5 three nodes are good to 1e-3, seven to 1e-8."""
    V, mean = waves(k=2.5)[flow]
    g = make_gaussians(200)
    x, s, q = exact_shape(g)
    truth = mean(x, covariance(s, q))
    error = [np.abs(expected_velocity(Analytic(V), x, s, q, order).mean - truth).max() for order in ORDERS]
    assert all(later < earlier / 10 for earlier, later in itertools.pairwise(error))
    assert error[1] < 2e-3 and error[3] < 2e-8


@pytest.mark.parametrize("ks,expected", [(0.5, 0.8826), (1.0, 0.6131), (1.5, 0.381), (2.0, 0.351), (3.0, 0.822)])
def test_known_failure_of_three_nodes_on_short_waves(ks, expected):
    """sin(kx) seen by three nodes: 2/3 + cos(sqrt(3) k s)/3 instead of exp(-(k s)^2 / 2)."""
    field = Analytic(lambda p: np.sin(p + np.pi / 2))
    got = expected_velocity(field, np.zeros((1, 3)), np.array([[ks, 1e-9, 1e-9]]), np.array([[1.0, 0, 0, 0]]), 3).mean
    assert got[0, 0] == pytest.approx(expected, abs=5e-4)


def test_monte_carlo_on_a_gridded_field_of_a_rotated_gaussian():
    rng = np.random.default_rng(3)
    coarse = VelocityField.from_array(rng.normal(size=(6, 6, 6, 3)).astype(np.float32), (-3, -3, -3), 1.0)
    x, s = np.array([[0.2, -0.3, 0.1]]), np.array([[0.9, 0.15, 0.3]])
    q = np.array([[0.8, 0.3, -0.4, 0.2]])
    draws = x + rng.normal(size=(400_000, 3)) @ (rotation_matrices(q)[0] * s).T
    truth = coarse.sample(draws).mean(0)
    got = expected_velocity(coarse, x, s, q, 7).mean[0]
    assert np.abs(got - truth).max() < 0.05  # the field changes from cell to cell: seven nodes see a kinked integrand
    wrong = expected_velocity(coarse, x, s * np.sqrt(2), q, 7).mean[0]  # hermgauss nodes would sit sqrt(2) too far out
    assert np.abs(wrong - truth).max() > 2 * np.abs(got - truth).max()


def test_huge_anisotropy_is_exact_on_a_quadratic():
    g = make_gaussians(20, scale=np.tile([1e-6, 1e-2, 10.0], (20, 1)))
    x, s, q = exact_shape(g)
    truth = (x**2).sum(1) + np.trace(covariance(s, q), axis1=1, axis2=2)
    got = expected_velocity(Analytic(lambda p: np.repeat((p**2).sum(1, keepdims=True), 3, 1)), x, s, q, 3).mean
    np.testing.assert_allclose(got, np.repeat(truth[:, None], 3, 1), rtol=1e-12)


def test_share_inside_of_gaussians_at_the_edge():
    x = np.array([[0.0, 0, 0], [1.0, 0, 0], [5.0, 0, 0]])
    field = Analytic(np.ones_like, low=-1.0, high=1.0)
    got = expected_velocity(field, x, np.full((3, 3), 0.1), np.tile([1.0, 0, 0, 0], (3, 1)), 3)
    np.testing.assert_allclose(got.inside, [1, 5 / 6, 0], atol=1e-12)  # the middle node lies on the border, inside
    np.testing.assert_allclose(got.mean[:, 0], got.inside, atol=1e-12)


def test_chunks_do_not_change_the_answer():
    n = 2 * (CHUNK_POINTS // 27) + 5
    V, _ = waves(2.0)["abc"]
    g = make_gaussians(n)
    x, s, q = exact_shape(g)
    whole = expected_velocity(Analytic(V, -0.4, 0.4), x, s, q)
    some = np.array([0, CHUNK_POINTS // 27 - 1, CHUNK_POINTS // 27, n - 1])
    part = expected_velocity(Analytic(V, -0.4, 0.4), x[some], s[some], q[some])
    for a, b in zip(whole, part, strict=True):
        np.testing.assert_allclose(a[some], b, atol=1e-14)


def test_no_gaussians():
    got = expected_velocity(Analytic(np.ones_like), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 4)))
    assert got.mean.shape == (0, 3) and got.inside.shape == (0,)
