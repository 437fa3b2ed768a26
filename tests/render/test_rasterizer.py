"""The Dr.Jit renderer against its numpy float64 twin: values, gradients, hard cases."""

import dataclasses

import numpy as np
import pytest

from gof.core.errors import DataFormatError, NonFiniteError
from gof.core.gaussians import TransientGaussians

dr = pytest.importorskip("drjit")

from gof.render import Splats, reference, render, render_splats, require_finite_splats, transient_state  # noqa: E402
from gof.render.backend import Array3f, Float, floats, whole_numbers  # noqa: E402
from gof.render.scene import Stack, columns  # noqa: E402
from tests.render.drawing import gradients, image, loss_weights, splats, weighted_sum  # noqa: E402
from tests.render.scenes import camera, found_once, gaussians  # noqa: E402

pytestmark = pytest.mark.usefixtures("kernels")


@pytest.mark.parametrize(
    "n, size, wh, channels, antialias",
    [
        (300, 0.05, (50, 37), 3, False),
        (60, 0.2, (64, 32), 1, True),
        (400, 0.004, (33, 64), 8, True),
        (1, 0.1, (1, 1), 3, False),
        (150, 0.1, (7, 3), 5, False),
    ],
)
def test_image_equals_float64_twin(n, size, wh, channels, antialias):
    cam, g = camera(*wh), gaussians(n, 1, size, channels=channels)
    background = np.random.default_rng(0).random((cam.height, cam.width, channels)).astype(np.float32)
    frame = render_splats(
        splats(g),
        cam,
        [floats(background[..., k]) for k in range(channels)],
        depth=True,
        antialias=antialias,
        dynamic=Float(1),
    )
    color, alpha, depth = reference.render(*g.values(), cam, background, antialias=antialias)
    assert alpha.max() > 0.05  # the scene is in view
    # A pair within float32 rounding of 1/255 or of the stop may flip: at most a few pixels, by at most 1/255 of a
    # colour.
    for got, want in (
        (image(frame.color, cam), color),
        (image([frame.alpha], cam)[..., 0], alpha),
        (image([frame.depth], cam)[..., 0], depth),
    ):
        error = np.abs(got - want)
        assert error.max() < 1.7 / 255 and (error > 2e-5).mean() < 2e-3
    np.testing.assert_allclose(frame.dynamic_alpha.numpy(), frame.alpha.numpy(), atol=1e-6)


@pytest.mark.parametrize("wh", [(50, 37), (32, 24), (3, 2)])
@pytest.mark.parametrize("pair_budget", [1 << 24, 200])
def test_a_stack_is_its_pictures_each_alone(wh, pair_budget):
    """Gaussians of all sizes, many across the edges, in mixed order: none is in another's picture."""
    cam, g, pictures = camera(*wh), gaussians(240, 4, 0.15, spread=0.6), 3
    picture = np.random.default_rng(2).integers(0, pictures, 240).astype(np.uint32)
    picture[picture == 1] = 2 * (np.arange((picture == 1).sum()) % 2)  # and one picture is empty
    backgrounds = np.random.default_rng(0).random((pictures, cam.height, cam.width, 3)).astype(np.float32)
    weights = np.random.default_rng(3).normal(size=backgrounds.shape).astype(np.float32)

    def weighed(frame, weight):
        return sum(dr.sum(c * floats(weight[..., k])) for k, c in enumerate(frame.color))

    planes = [floats(backgrounds[..., k]) for k in range(3)]
    s = splats(g, grad=True)
    stack = Stack(pictures, whole_numbers(picture))
    frame = render_splats(s, cam, planes, depth=True, stack=stack, pair_budget=pair_budget)
    dr.backward(weighed(frame, weights))
    found = gradients(s)
    color = np.stack([c.numpy() for c in frame.color], -1).reshape(backgrounds.shape)
    alpha, depth = (plane.numpy().reshape(backgrounds.shape[:3]) for plane in (frame.alpha, frame.depth))
    for k in range(pictures):
        own = {name: value[picture == k] for name, value in g.items()}
        for got, want in zip(
            (color[k], alpha[k], depth[k]), reference.render(*own.values(), cam, backgrounds[k]), strict=True
        ):
            error = np.abs(got - want)
            assert error.max() < 1.7 / 255 and (error > 2e-5).mean() < 3e-3
        if not len(own["opacity"]):
            continue
        lone = splats(own, grad=True)
        alone = render_splats(lone, cam, [floats(backgrounds[k, ..., c]) for c in range(3)])
        dr.backward(weighed(alone, weights[k]))
        for name, gradient in gradients(lone).items():
            np.testing.assert_allclose(found[name][picture == k], gradient, rtol=2e-4, atol=2e-4, err_msg=name)
        np.testing.assert_allclose(frame.radius.numpy()[picture == k], alone.radius.numpy(), rtol=1e-6)


def test_a_gaussian_of_no_picture_of_the_stack_is_drawn_nowhere():
    cam, g = camera(20, 14), gaussians(40, 4, 0.15)
    picture = np.tile(np.uint32([0, 1, 2, 2**32 - 1]), 10)
    s = splats(g, grad=True)
    frame = render_splats(s, cam, stack=Stack(2, whole_numbers(picture)))
    dr.backward(sum(dr.sum(c) for c in frame.color))
    own = splats({name: value[picture < 2] for name, value in g.items()})
    wanted = render_splats(own, cam, stack=Stack(2, whole_numbers(picture[picture < 2])))
    for found, plane in zip(frame.color, wanted.color, strict=True):
        np.testing.assert_allclose(found.numpy(), plane.numpy(), atol=1e-6)
    for name, gradient in gradients(s).items():
        assert np.isfinite(gradient).all() and not gradient[picture >= 2].any(), name


@pytest.mark.parametrize("count, n", [(0, 40), (2, 39)])
def test_a_stack_that_does_not_fit_is_named(count, n):
    with pytest.raises(DataFormatError, match=f"'stack' has {count} pictures, and those of {n} of 40"):
        render_splats(splats(gaussians(40)), camera(8, 8), stack=Stack(count, whole_numbers(np.zeros(n))))


def test_an_empty_stack_is_its_backgrounds():
    cam = camera(6, 5)
    nothing = splats({name: value[:0] for name, value in gaussians(1).items()})
    planes = [floats(np.arange(2 * 30) / 60) for _ in range(3)]
    frame = render_splats(nothing, cam, planes, stack=Stack(2, whole_numbers(np.zeros(0))))
    np.testing.assert_array_equal(frame.color[0].numpy(), planes[0].numpy())
    assert len(frame.alpha) == 60 and not frame.alpha.numpy().any()


@pytest.mark.parametrize("antialias", [False, True])
@pytest.mark.long
def test_gradient_equals_central_differences(antialias):
    cam, g = camera(24, 20), gaussians(25, 3, 0.12)
    weights, extra = loss_weights(cam, 3)
    s = splats(g, grad=True)
    frame = render_splats(s, cam, [0.3, 0.2, 0.9], depth=True, antialias=antialias)
    dr.backward(weighted_sum(frame, weights, extra))
    got = gradients(s)

    def objective(params):
        color, alpha, depth = reference.render(*params.values(), cam, [0.3, 0.2, 0.9], antialias=antialias)
        return (color * weights).sum() + (alpha * extra[0]).sum() + (depth * extra[1]).sum()

    r = np.random.default_rng(0)

    def differences(name, value):
        picks = [tuple(r.integers(0, n) for n in value.shape) for _ in range(40)]
        want = []
        for pick in picks:
            h = 1e-6 * max(1e-2, abs(value[pick]))
            ends = []
            for sign in (1, -1):
                moved = {k: v.copy() for k, v in g.items()}
                moved[name][pick] += sign * h
                ends.append(objective(moved))
            want.append((ends[0] - ends[1]) / (2 * h))
        return picks, np.array(want)

    for name, value in g.items():
        key = ("gradients", antialias, name)
        picks, want = found_once(key, lambda name=name, value=value: differences(name, value))
        have = np.array([got[name][p] for p in picks])
        assert np.abs(want).max() > 0
        np.testing.assert_allclose(have, want, atol=2e-3 * np.abs(want).max(), err_msg=name)


def test_transient_state_and_its_gradient():
    r = np.random.default_rng(2)
    n, t = 20, 0.7
    v = {
        "x": r.normal(size=(n, 3)),
        "v": r.normal(size=(n, 3)),
        "mu": r.uniform(0, 1, n),
        "sigma": r.uniform(0.1, 0.5, n),
        "o": r.random(n),
    }
    dynamic = r.random(n) < 0.7
    wx, wo = r.normal(size=(n, 3)), r.normal(size=n)
    args = [columns(v["x"], Array3f), columns(v["v"], Array3f), floats(v["mu"]), floats(v["sigma"]), floats(v["o"])]
    dr.enable_grad(args)
    x, o = transient_state(*args, t, dynamic=floats(dynamic) > 0)
    dr.backward(sum(dr.sum(a * floats(b)) for a, b in zip([*x, o], [*wx.T, wo], strict=True)))
    X, O = reference.transient_state(*v.values(), t, dynamic)
    np.testing.assert_allclose(np.stack([np.array(c.numpy()) for c in x], -1), X, atol=1e-6)
    np.testing.assert_allclose(o.numpy(), O, atol=1e-6)
    for k, (name, value) in enumerate(v.items()):
        for pick in [(i, *([1] if value.ndim == 2 else [])) for i in range(n)]:
            ends = []
            for sign in (1, -1):
                moved = {key: a.copy() for key, a in v.items()}
                moved[name][pick] += sign * 1e-6
                X, O = reference.transient_state(*moved.values(), t, dynamic)
                ends.append((X * wx).sum() + (O * wo).sum())
            grad = dr.grad(args[k])[1] if value.ndim == 2 else dr.grad(args[k])
            grad = np.broadcast_to(np.array(grad.numpy()), n)
            assert abs(grad[pick[0]] - (ends[0] - ends[1]) / 2e-6) < 1e-4 * (1 + abs(grad[pick[0]])), name


def test_transient_state_limits():
    n = 5
    sigma = Float([np.inf, 0.0, 1e-12, 1e-3, 1e-3])
    mu = Float([0.0, 0.5, 0.4, 0.5, -100.0])
    x, vel, o = columns(np.ones((n, 3)), Array3f), columns(np.full((n, 3), 1e4), Array3f), Float([0.5] * n)
    dr.enable_grad(x, vel, mu, sigma, o)
    position, opacity = transient_state(x, vel, mu, sigma, o, 0.5)
    dr.backward(dr.sum(opacity) + dr.sum(position.x + position.y))
    np.testing.assert_allclose(opacity.numpy(), [0.5, 0.5, 0, 0.5, 0], atol=1e-7)
    for a in (*x, *vel, mu, sigma, o):
        assert np.isfinite(dr.grad(a).numpy()).all()


HARD = {
    "no gaussians": lambda g: {k: v[:0] for k, v in g.items()},
    "all off-screen": lambda g: g | {"position": g["position"] + [100.0, 0, 0]},
    "behind": lambda g: g | {"position": g["position"] - [0, 50.0, 0]},
    "tiny": lambda g: g | {"scale": g["scale"] * 0 + 1e-8},
    "huge": lambda g: g | {"scale": g["scale"] * 0 + 1e3},
    "needle": lambda g: g | {"scale": np.broadcast_to([1e-4, 1e-4, 1.0], g["scale"].shape)},
    "opacity 0": lambda g: g | {"opacity": g["opacity"] * 0},
    "opacity 1": lambda g: g | {"opacity": g["opacity"] * 0 + 1},
    "opacity 1-1e-7": lambda g: g | {"opacity": g["opacity"] * 0 + (1 - 1e-7)},
    "zero quaternion": lambda g: g | {"rotation": g["rotation"] * 0},
    "unnormalised quaternion": lambda g: g | {"rotation": g["rotation"] * 1e3},
    "hdr and negative colours": lambda g: g | {"color": g["color"] * 1e4 - 3e3},
    # float32 depths tie out there, so the order is only the twin's up to ties: one colour for all
    "far away": lambda g: g | {"position": g["position"] + [0, 1e6, 0], "color": g["color"] * 0 + 0.7},
}


@pytest.mark.parametrize("case", HARD)
def test_hard_case_is_finite_and_equals_twin(case):
    cam = camera(24, 20)
    g = HARD[case](gaussians(12, 4, 0.1))
    s = splats(g, grad=True)
    frame = render_splats(s, cam, [0.1, 0.2, 0.3], depth=True)
    dr.backward(weighted_sum(frame, *loss_weights(cam, 3)))
    for name, value in gradients(s).items():
        assert np.isfinite(value).all(), name
    color, alpha, _ = reference.render(*g.values(), cam, [0.1, 0.2, 0.3])
    np.testing.assert_allclose(image([frame.alpha], cam)[..., 0], alpha, atol=2e-5)
    scale = max(1.0, np.abs(g["color"]).max(initial=0))
    np.testing.assert_allclose(image(frame.color, cam), color, atol=2e-5 * scale)
    assert np.isfinite(frame.expected_depth.numpy()).all()
    if case in ("no gaussians", "all off-screen", "behind", "opacity 0"):
        assert frame.intersections == 0 and not frame.alpha.numpy().any()


def test_centres_around_the_near_plane_and_on_the_axis():
    cam = camera(24, 20)
    depths = np.array([-1.0, 0.0, 0.00999, 0.01001, 0.011, 0.5])
    axis = cam.world_to_camera[2, :3]
    g = gaussians(len(depths), 0, 0.02)
    g["position"] = cam.position + depths[:, None] * axis
    s = splats(g, grad=True)
    frame = render_splats(s, cam, depth=True)
    dr.backward(weighted_sum(frame, *loss_weights(cam, 3)))
    got = gradients(s)
    assert all(np.isfinite(v).all() for v in got.values())
    assert not got["opacity"][:3].any() and got["opacity"][3:].all()  # at or nearer than `near`: not drawn, gradient 0
    assert (frame.radius.numpy()[:3] == 0).all() and (frame.radius.numpy()[3:] > 0).all()


def test_mean2d_gradient_moves_with_the_image():
    """Shifting one Gaussian by a pixel changes the loss by its mean2d gradient."""
    cam, g = camera(24, 20), gaussians(1, 3, 0.1, spread=0.01)
    weights, extra = loss_weights(cam, 3)
    s = splats(g, grad=True)
    frame = render_splats(s, cam, depth=True)
    assert frame.mean2d_grad is None
    extra[1] = 0
    dr.backward(weighted_sum(frame, weights, extra))
    want = []
    for axis in (0, 1):
        ends = []
        for sign in (1, -1):
            K = cam.K.copy()
            K[axis, 2] += sign * 1e-5
            moved = dataclasses.replace(cam, K=K)
            color, alpha, _ = reference.render(*g.values(), moved)
            ends.append((color * weights).sum() + (alpha * extra[0]).sum())
        want.append((ends[0] - ends[1]) / 2e-5)
    got = frame.mean2d_grad
    np.testing.assert_allclose([got.x[0], got.y[0]], want, rtol=2e-3)


def test_non_finite_input_is_named():
    g = gaussians(10)
    g["scale"][7, 1] = np.nan
    with pytest.raises(NonFiniteError, match=r"'scale' .* \[7\]"):
        require_finite_splats(splats(g))


def test_wrong_shapes_are_named():
    g = gaussians(4)
    with pytest.raises(DataFormatError, match="9 channels"):
        splats(g | {"color": np.zeros((4, 9))})
    with pytest.raises(DataFormatError, match="'color' has 3 rows"):
        splats(g | {"color": np.zeros((3, 3))})
    with pytest.raises(DataFormatError, match="background"):
        render_splats(splats(g), camera(), [0.0])
    for name in ("near", "dilation"):
        with pytest.raises(DataFormatError, match=f"'{name}' is 0"):
            render_splats(splats(g), camera(), **{name: 0})


def test_no_kernel_is_compiled_after_the_first_steps(kernels):
    """Another number of Gaussians, of pairs, and another time or camera run the kernels of the first step."""
    cam, misses, made = camera(48, 36), [], []
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        for step, n in enumerate((600, 650, 700, 730, 590)):
            g = gaussians(n, step)
            s = splats(g, grad=True)
            x, o = transient_state(s.position, s.position * 0.1, s.opacity, s.opacity + 0.1, s.opacity, 0.1 * step)
            dr.kernel_history_clear()
            frame = render_splats(
                Splats(x, s.rotation, s.scale, o, s.color), dataclasses.replace(cam, K=cam.K + np.diag([step, step, 0]))
            )
            dr.backward(sum(dr.sum(dr.square(c)) for c in frame.color))
            dr.eval(dr.grad(s.position), dr.grad(s.opacity))
            misses.append(sum(not k["cache_hit"] for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT))
            made.append(compiled_variants() if kernels == "native" else 0)
    assert misses[2:] == [0, 0, 0] and made[1:] == made[:1] * 4


def compiled_variants() -> int:
    """How many combinations of types the native kernels have been compiled for."""
    from gof.render.native import blending, lists

    kernels = [value for module in (blending, lists) for value in vars(module).values() if hasattr(value, "overloads")]
    return sum(len(kernel.overloads) for kernel in kernels)


def test_render_returns_numpy_and_separates_static_from_dynamic():
    n = 40
    g = gaussians(n)
    dynamic = np.arange(n) % 2 == 0
    tg = TransientGaussians(
        g["position"],
        np.full((n, 3), 0.1),
        np.zeros(n),
        np.where(dynamic, 0.1, np.inf),
        g["scale"],
        g["rotation"],
        g["opacity"],
        np.abs(g["color"]),
        dynamic,
    )
    cam = camera()
    out = render(tg, cam, 0.05, background=(1, 0, 0))
    assert out["color"].shape == (37, 50, 3) and out["alpha"].shape == out["depth"].shape == (37, 50)
    assert (out["dynamic_alpha"] <= out["alpha"] + 1e-6).all() and out["dynamic_alpha"].max() > 0.01
    x, o = tg.at(0.05)
    color, alpha, depth = reference.render(x, tg.rotation, tg.scale, o, tg.color, cam, (1, 0, 0))
    assert np.abs(out["color"] - color).max() < 1.7 / 255 and np.abs(out["alpha"] - alpha).max() < 1.7 / 255
    seen = alpha > 0.1
    np.testing.assert_allclose(out["depth"][seen], (depth / np.maximum(alpha, 1e-9))[seen], rtol=5e-3)
    late = render(tg, cam, 50.0)
    assert late["dynamic_alpha"].max() == 0 and late["alpha"].max() > 0.05
