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


def test_rows_that_come_and_go_keep_their_places_and_compile_nothing():
    """After the first change; through numpy a vector of another length was two more kernels."""
    r, values, late = np.random.default_rng(1), np.arange(30.0).reshape(10, 3), []
    optimizer = Adam(lr=0.1, params={"x": columns(values, Array3f), "w": floats(values[:, 0])})
    optimizer.set_learning_rate({"x": 0.0, "w": 0.0})
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        for more in (3, 5, 8):
            dr.backward(dr.sum(dr.sum(optimizer["x"] * optimizer["x"])) + dr.sum(optimizer["w"]))
            optimizer.step()
            kept, new = np.flatnonzero(r.random(len(values)) < 0.8), r.normal(size=(more, 3)).astype(np.float32)
            order = r.permutation(len(kept) + more)
            moment = np.stack([m.numpy() for m in optimizer.state["x"][3][1]], -1)
            born = {"x": columns(new, Array3f), "w": floats(new[:, 0])}
            optimizer.regroup(("x", "w"), kept, born, order)
            values = np.concatenate([values[kept], new])[order]
            moment = np.concatenate([moment[kept], 0 * new])[order]
            for name, here in (("x", values), ("w", values[:, 0])):
                found = [c.numpy() for c in (optimizer[name] if name == "x" else [optimizer[name]])]
                np.testing.assert_allclose(np.stack(found, -1).reshape(here.shape), here, rtol=1e-6)
            np.testing.assert_array_equal(np.stack([m.numpy() for m in optimizer.state["x"][3][1]], -1), moment)
            met = [k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT]
            late.append(sum(k["cache_disk"] or not k["cache_hit"] for k in met))
    assert late[1:] == [0, 0]
