"""Our Adam against the paper's formula in float64, on both sets of kernels."""

import numpy as np
import pytest

dr = pytest.importorskip("drjit")

from gof.render.adam import Adam  # noqa: E402
from gof.render.backend import Array2f, Array3f, Float, floats  # noqa: E402
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


def test_some_rows_are_moved_as_the_paper_says_and_the_others_stay():
    """Another choice of rows each time, in runs and alone; a parameter that is not asked for moves as ever."""
    r, names = np.random.default_rng(3), ("position", "opacity")
    start = {"position": r.normal(size=(100, 3)), "opacity": r.normal(size=(100, 1)), "plate": r.normal(size=(7, 1))}
    params = {k: columns(x, Array3f) if k == "position" else floats(x) for k, x in start.items()}
    optimizer = Adam(lr=0.02, params=params, beta_1=0.8, beta_2=0.95, epsilon=1e-15, mask_updates=True)
    state = {k: (x, 0 * x, 0 * x) for k, x in start.items()}
    for t in range(1, 8):
        rows = np.flatnonzero(r.random(100) < 0.3)
        if t % 2:
            rows = np.unique(np.concatenate([rows, np.arange(10 * t, 10 * t + 30) % 100]))
        part = optimizer.only(names, rows.astype(np.uint32))
        assert set(part) == set(names) and dr.width(part["position"]) == len(rows)
        np.testing.assert_allclose(part["opacity"].numpy(), state["opacity"][0][rows, 0], atol=2e-6)
        loss, pulls = dr.sum(optimizer["plate"] * optimizer["plate"]), {"plate": 2 * state["plate"][0]}
        for name in names:
            k = start[name].shape[1]
            pull = r.normal(size=(len(rows), k)) * (r.random((len(rows), k)) < 0.8)
            parts = list(part[name]) if k > 1 else [part[name]]
            loss += sum(dr.sum(floats(p) * c) for p, c in zip(pull.T, parts, strict=True))
            pulls[name] = np.zeros_like(start[name])
            pulls[name][rows] = pull
        dr.backward(loss)
        optimizer.step()
        for name, (x, m, v) in state.items():
            g = pulls[name]
            first, second = 0.8 * m + 0.2 * g, 0.95 * v + 0.05 * g * g
            root = np.sqrt(second / (1 - 0.95**t))
            moved = x - 0.02 * np.divide(first / (1 - 0.8**t), root, out=0 * x, where=root > 0)
            state[name] = tuple(np.where(g == 0, a, b) for a, b in ((x, moved), (m, first), (v, second)))
    for name, expected in state.items():
        value, _, _, (t, *moments, _) = optimizer.state[name]
        assert int(t[0]) == 7
        for found, here in zip((value, *moments), expected, strict=True):
            np.testing.assert_allclose(np.array(dr.detach(found)).reshape(-1, len(here)).T, here, atol=3e-6)
        assert dr.grad_enabled(optimizer[name])


def test_rows_that_come_and_go_between_steps_of_some_rows():
    """The parameters' memory is another then."""
    optimizer = Adam(lr=0.1, params={"w": floats(np.arange(6.0))}, mask_updates=True)

    def pull(*rows: int) -> None:
        dr.backward(dr.sum(optimizer.only(["w"], np.array(rows, np.uint32))["w"]))
        optimizer.step()

    pull(1, 4)
    np.testing.assert_allclose(optimizer["w"].numpy(), [0, 0.9, 2, 3, 3.9, 5], atol=1e-6)
    optimizer.regroup(["w"], np.array([1, 4, 5]), {"w": floats(np.array([9.0]))}, np.array([3, 0, 1, 2]))
    pull(0, 2)  # who is new moves for the first time, in the second step: 0.1 (0.1 / 0.19) / (0.001 / 0.001999)^0.5
    np.testing.assert_allclose(optimizer["w"].numpy(), [8.92559, 0.9, 3.8, 5], atol=2e-5)
    optimizer["w"] = floats(np.array([1.0, 2.0]))  # as a checkpoint does
    pull(1)
    np.testing.assert_allclose(optimizer["w"].numpy(), [1, 1.9], atol=1e-4)


def test_rows_that_are_there_again_add_their_gradients():
    """As if the sum had come once; the second row three times, with 1, 2 and -0.5."""
    one, two = (
        Adam(lr=0.1, params={"w": columns(np.arange(10.0).reshape(5, 2), Array2f)}, mask_updates=True) for _ in "12"
    )
    rows = np.array([0, 2, 3], np.uint32)
    for _ in range(3):
        part = one.only(["w"], rows, np.array([1, 0, 1], np.uint32))["w"]
        assert dr.width(part) == 6
        np.testing.assert_array_equal(part.x.numpy()[3:], part.x.numpy()[[1, 0, 1]])
        pulls = np.array([0, 1, 3, 2, 0, -0.5])
        dr.backward(dr.sum(part.x * floats(pulls)) - dr.sum(part.y * floats(2 * pulls)))
        one.step()
        part = two.only(["w"], rows)["w"]
        pulls = np.array([0, 2.5, 3])
        dr.backward(dr.sum(part.x * floats(pulls)) - dr.sum(part.y * floats(2 * pulls)))
        two.step()
    for found, wanted in zip(one["w"], two["w"], strict=True):
        np.testing.assert_allclose(found.numpy(), wanted.numpy(), atol=1e-6)
    np.testing.assert_array_equal(one["w"].x.numpy()[[0, 1, 4]], [0, 2, 8])
    part, shared = one.only(["w"], rows, np.array([1, 0, 1], np.uint32))["w"], floats(np.array([0, 1, 3, 2, 0, -0.5]))
    before = [plane.numpy().copy() for plane in one.state["w"][3][1]]
    dr.backward(dr.sum(part.x * shared) + dr.sum(part.y * shared))  # one gradient for both columns
    one.step()
    np.testing.assert_array_equal(shared.numpy(), [0, 1, 3, 2, 0, -0.5])
    for old, plane in zip(before, one.state["w"][3][1], strict=True):
        np.testing.assert_allclose(plane.numpy()[[2, 3]], 0.9 * old[[2, 3]] + 0.1 * np.array([2.5, 3]), rtol=1e-5)


def test_a_step_that_stands_for_several_corrects_the_bias_of_so_many():
    """By hand: 0.1 of each moment is the gradient's, 0.001 of its square; then a fourth step, of one."""
    optimizer = Adam(lr=0.1, params={"w": floats(np.array([1.0, 2.0])), "still": floats(np.ones(1))}, mask_updates=True)
    dr.backward(dr.sum(optimizer["w"] * floats(np.array([3.0, 0.0]))))
    optimizer.step(3)
    first = 0.1 * (0.1 / (1 - 0.9**3)) / (0.001 / (1 - 0.999**3)) ** 0.5
    np.testing.assert_allclose(optimizer["w"].numpy(), [1 - first, 2], atol=1e-6)
    assert [int(optimizer.state[name][3][0][0]) for name in ("w", "still")] == [3, 3]
    dr.backward(dr.sum(optimizer["w"] * floats(np.array([3.0, 0.0]))))
    optimizer.step()
    second = 0.1 * (0.19 / (1 - 0.9**4)) / (0.001999 / (1 - 0.999**4)) ** 0.5
    np.testing.assert_allclose(optimizer["w"].numpy(), [1 - first - second, 2], atol=1e-6)


def test_some_rows_need_an_optimiser_that_leaves_the_others():
    optimizer = Adam(lr=0.1, params={"w": floats(np.arange(6.0))})
    with pytest.raises(ValueError, match="mask_updates"):
        optimizer.only(["w"], np.array([1], np.uint32))


def test_what_a_step_does_not_look_at_stays_and_its_steps_are_counted():
    optimizer = Adam(
        lr=0.1, params={"a": floats(np.array([1.0, 2.0])), "b": floats(np.array([3.0]))}, mask_updates=True
    )
    dr.backward(dr.sum(optimizer["b"]))
    optimizer.step()
    np.testing.assert_array_equal(optimizer["a"].numpy(), [1, 2])
    assert not np.any([m.numpy() for m in optimizer.state["a"][3][1:3]])
    dr.backward(dr.sum(optimizer["a"]))
    optimizer.step()  # 0.1 (0.1 / 0.19) / (0.001 / 0.001999)^0.5, as of the second step
    np.testing.assert_allclose(optimizer["a"].numpy(), [0.92559, 1.92559], atol=2e-5)
    np.testing.assert_allclose(optimizer["b"].numpy(), [2.9], atol=1e-5)


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
