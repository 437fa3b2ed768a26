"""Our Adam against the paper's formula in float64, on both sets of kernels."""

import numpy as np
import pytest

dr = pytest.importorskip("drjit")

from gof.render.adam import Adam  # noqa: E402
from gof.render.backend import Array3f, Float, floats  # noqa: E402
from gof.render.scene import columns  # noqa: E402

pytestmark = pytest.mark.usefixtures("kernels")


@pytest.mark.parametrize("masked", [False, True])
def test_steps_follow_the_paper(masked):
    r = np.random.default_rng(0)
    start = {"position": r.normal(size=(50, 3)), "opacity": r.normal(size=(70, 1))}
    params = {"position": columns(start["position"], Array3f), "opacity": floats(start["opacity"])}
    optimizer = Adam(lr=1.0, params=params, beta_1=0.8, beta_2=0.95, epsilon=1e-15, mask_updates=masked)
    rates = {"position": 0.02, "opacity": 0.003}
    optimizer.set_learning_rate(rates)
    state = {k: (x, 0 * x, 0 * x) for k, x in start.items()}
    for t in range(1, 6):
        for key, (x, m, v) in state.items():
            g = 1e-4 * r.normal(size=x.shape) * (r.random(x.shape) < 0.7)
            dr.set_grad(optimizer[key], columns(g, Array3f) if key == "position" else floats(g))
            first, second = 0.8 * m + 0.2 * g, 0.95 * v + 0.05 * g * g
            root = np.sqrt(second / (1 - 0.95**t))
            moved = x - rates[key] * np.divide(first / (1 - 0.8**t), root, out=0 * x, where=root > 0)
            stays = masked & (g == 0)
            state[key] = tuple(np.where(stays, a, b) for a, b in ((x, moved), (m, first), (v, second)))
        optimizer.step()
    for key, (x, _, _) in state.items():
        np.testing.assert_allclose(np.array(dr.detach(optimizer[key])).T.reshape(x.shape), x, atol=2e-6)
        assert dr.grad_enabled(optimizer[key])


def test_what_has_no_gradient_stays():
    optimizer = Adam(lr=0.1, params={"a": Float([1.0, 2.0]), "b": Float([3.0])})
    dr.backward(dr.sum(optimizer["b"]))
    optimizer.step()
    np.testing.assert_array_equal(optimizer["a"].numpy(), [1, 2])
    np.testing.assert_allclose(optimizer["b"].numpy(), [2.9], rtol=1e-6)
