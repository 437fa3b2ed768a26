"""Bands, repeatable gradients, ties, crowded blocks, thresholds, energy, harmonics and the rolling shutter."""

import dataclasses

import numpy as np
import pytest

dr = pytest.importorskip("drjit")

from gof.core.gaussians import TransientGaussians  # noqa: E402
from gof.render import reference, render, render_splats, shutter_delay  # noqa: E402
from gof.render.backend import Array3f, Float, floats  # noqa: E402
from gof.render.scene import columns  # noqa: E402
from tests.render.drawing import gradients, image, loss_weights, splats, weighted_sum  # noqa: E402
from tests.render.scenes import camera, gaussians  # noqa: E402

pytestmark = pytest.mark.usefixtures("kernels")


def draw(g, cam, **kwargs):
    s = splats(g, grad=True)
    frame = render_splats(s, cam, [0.2, 0.3, 0.4], depth=True, **kwargs)
    dr.backward(weighted_sum(frame, *loss_weights(cam, 3)))
    return frame, image([*frame.color, frame.alpha], cam), gradients(s)


@pytest.mark.parametrize("deterministic", [False, True])
def test_bands_change_nothing_but_the_memory(deterministic):
    cam, g = camera(60, 50), gaussians(500, 2, 0.06)
    whole, image_whole, grad_whole = draw(g, cam, deterministic=deterministic)
    banded, image_banded, grad_banded = draw(g, cam, deterministic=deterministic, pair_budget=2000)
    assert whole.trace.bands == 1 and banded.trace.bands > 3
    assert banded.intersections == whole.intersections
    assert np.array_equal(image_whole, image_banded)
    for name in grad_whole:
        np.testing.assert_allclose(grad_banded[name], grad_whole[name], atol=1e-5 * np.abs(grad_whole[name]).max())


def test_deterministic_mode_repeats_bit_for_bit_and_agrees_with_the_fast_mode():
    cam, g = camera(60, 50), gaussians(3000, 2, 0.06)
    runs = [draw(g, cam, deterministic=True) for _ in range(4)]
    fast = draw(g, cam)
    for name, value in runs[0][2].items():
        assert all(np.array_equal(value, r[2][name]) for r in runs[1:]), name
        np.testing.assert_allclose(fast[2][name], value, atol=2e-5 * np.abs(value).max(), err_msg=name)
    assert all(np.array_equal(runs[0][1], r[1]) for r in (*runs[1:], fast))


def test_deterministic_mode_does_not_depend_on_the_number_of_threads():
    cam, g, threads = camera(60, 50), gaussians(3000, 2, 0.06), dr.thread_count()
    one, two = [], []
    for runs, count in ((one, 1), (two, 2)):
        dr.set_thread_count(count)
        try:
            runs += draw(g, cam, deterministic=True)[1:]
        finally:
            dr.set_thread_count(threads)
    assert np.array_equal(one[0], two[0])
    assert all(np.array_equal(value, two[1][name]) for name, value in one[1].items())


def test_equal_depths_are_drawn_in_index_order():
    cam, n = camera(16, 16), 40
    g = gaussians(n, 0, 0.3, spread=0)
    g["opacity"][:] = 0.3
    color, _, _ = reference.render(*g.values(), cam)
    np.testing.assert_allclose(image(render_splats(splats(g), cam).color, cam), color, atol=2e-5)
    flipped = {k: v[::-1].copy() for k, v in g.items()}
    assert np.abs(image(render_splats(splats(flipped), cam).color, cam) - color).max() > 0.05


def test_a_hundred_thousand_gaussians_in_one_block():
    """Faint ones all pass; opaque ones stop early. Sum of geometric weights is known."""
    cam, n = camera(8, 8), 100_000
    axis = cam.world_to_camera[2, :3]
    u = (np.array([4.0, 4.0]) - cam.K[:2, 2]) / np.diag(cam.K)[:2]
    ray = np.array([*u, 1.0]) @ cam.world_to_camera[:3, :3]
    depth = 2 + np.arange(n) * 1e-5
    g = {
        "position": cam.position + depth[:, None] * ray,
        "rotation": np.tile([1.0, 0, 0, 0], (n, 1)),
        "scale": np.full((n, 3), 10.0),
        "opacity": np.full(n, 0.005),
        "color": np.ones((n, 3)),
    }
    assert axis @ ray == pytest.approx(1)
    frame, picture, grads = draw(g, cam)
    assert frame.intersections == n * 4
    assert picture[..., 3].min() == pytest.approx(1 - 1e-4, abs=1e-6)  # stops just above the smallest transmittance
    assert all(np.isfinite(v).all() for v in grads.values())
    drawn = np.flatnonzero(grads["opacity"])
    assert drawn.max() == pytest.approx(np.log(1e-4) / np.log(1 - 0.005), abs=30)


def test_alpha_and_transmittance_add_up_to_one():
    cam, g = camera(40, 30), gaussians(200, 1, 0.1)
    white = g | {"color": np.ones((200, 3))}
    frame = render_splats(splats(white), cam, [1.0, 1.0, 1.0])
    np.testing.assert_allclose(image(frame.color, cam), 1, atol=3e-6)  # sum w_i + T = 1


def test_the_1_255_threshold_is_the_only_jump():
    """Central differences across it see a jump of at most 1/255 x colour; the derivative is of the smooth part."""
    cam = camera(9, 9)
    g = gaussians(1, 0, 0.02, spread=0)
    g["position"] = (cam.position + 2 * cam.world_to_camera[2, :3])[None]
    g["color"][:] = 1.0
    values = []
    for opacity in (0.99 / 255, 1.01 / 255):
        values.append(image(render_splats(splats(g | {"opacity": np.array([opacity])}), cam).color, cam).max())
    peak = reference.render(*(g | {"opacity": np.array([1.01 / 255])}).values(), cam)[0].max()
    assert values[0] == 0 and values[1] == pytest.approx(peak, rel=1e-4) and peak <= 1.02 / 255
    smooth = [
        reference.render(*(g | {"opacity": np.array([o])}).values(), cam, min_alpha=0)[0]
        for o in (0.99 / 255, 1.01 / 255)
    ]
    assert np.abs(smooth[1] - smooth[0]).max() < 1e-4  # without the threshold there is no jump


@pytest.mark.long
def test_stopping_and_clamp_gradients_equal_central_differences():
    """Opaque stacks: alpha above 0.99 is clamped (gradient 0), pixels stop at 1e-4."""
    cam, g = camera(12, 12), gaussians(30, 7, 0.3, spread=0.1)
    g["opacity"] = np.where(np.arange(30) % 3 == 0, 1.0, 0.9)
    weights, extra = loss_weights(cam, 3)
    s = splats(g, grad=True)
    dr.backward(weighted_sum(render_splats(s, cam, depth=True), weights, extra))
    got = gradients(s)
    errors, sizes = [], []
    for i in range(30):
        ends = []
        for sign in (1, -1):
            moved = g["opacity"].copy()
            moved[i] += sign * 1e-7
            color, alpha, depth = reference.render(*(g | {"opacity": moved}).values(), cam)
            ends.append((color * weights).sum() + (alpha * extra[0]).sum() + (depth * extra[1]).sum())
        errors.append(abs(got["opacity"][i] - (ends[0] - ends[1]) / 2e-7))
        sizes.append(abs(got["opacity"][i]))
    assert max(errors) < 5e-3 * max(sizes)


@pytest.mark.long
def test_random_scenes_stay_within_a_stated_bound_of_float64():
    """Away from threshold flips (a pixel may gain or lose pairs of alpha 1/255), float32 is within 2e-5 of float64."""
    flips, pixels = 0, 0
    for seed in range(12):
        cam = camera(32, 24)
        r = np.random.default_rng(seed)
        g = gaussians(int(r.integers(1, 250)), seed, float(np.exp(r.uniform(np.log(0.003), np.log(0.5)))))
        got = image(render_splats(splats(g), cam).color, cam)
        error = np.abs(got - reference.render(*g.values(), cam)[0]).max(-1)
        assert error.max() < 2 * 1.7 / 255
        flips += (error > 2e-5).sum()
        pixels += error.size
    assert flips / pixels < 5e-3


def transient(g, velocity, dynamic=True):
    n = len(g["position"])
    return TransientGaussians(
        g["position"],
        np.broadcast_to(velocity, (n, 3)),
        np.zeros(n),
        np.full(n, np.inf),
        g["scale"],
        g["rotation"],
        g["opacity"],
        np.abs(g["color"]),
        np.full(n, dynamic),
    )


@pytest.mark.parametrize("readout", ["down", "up", "right", "left"])
@pytest.mark.parametrize("exact", [True, False])
def test_shutter_delay_equals_twin_and_is_differentiable(readout, exact):
    cam = camera(48, 36, row_time_s=2e-4, readout=readout)
    r = np.random.default_rng(1)
    x, v = r.normal(0, 0.3, (30, 3)), r.normal(0, 4, (30, 3))
    X, V = columns(x, Array3f), columns(v, Array3f)
    dr.enable_grad(X, V)
    delay = shutter_delay(X, V, cam, exact=exact)
    w = r.normal(size=30)
    dr.backward(dr.sum(delay * floats(w)))
    np.testing.assert_allclose(delay.numpy(), reference.shutter_delay(x, v, cam, exact), rtol=1e-4, atol=1e-8)
    for param, ad in ((x, X), (v, V)):
        got = np.stack([np.broadcast_to(dr.grad(c).numpy(), 30) for c in ad], -1)
        for pick in ((0, 0), (3, 1), (7, 2), (11, 0)):
            moved, ends = param.copy(), []
            for sign in (1, -1):
                moved[pick] = param[pick] + sign * 1e-5
                args = (moved, v) if param is x else (x, moved)
                ends.append((reference.shutter_delay(*args, cam, exact) * w).sum())
            assert got[pick] == pytest.approx((ends[0] - ends[1]) / 2e-5, rel=2e-3, abs=1e-7)


def test_shutter_delay_solves_the_capture_equation():
    """Exact form: at the delay, the (linearised) image position is being read. First order: off by grad t . v."""
    cam = camera(48, 36, row_time_s=1e-4, readout="right")
    x, v = np.array([[0.1, 0.2, 0.05]]), np.array([[3.0, 0.0, 0.0]])
    pixel, _ = cam.project(x)
    speed = (cam.projection_jacobian(x) @ v[..., None])[0, 0, 0]
    t = float(shutter_delay(columns(x, Array3f), columns(v, Array3f), cam)[0])
    assert t == pytest.approx(cam.row_time_s * (pixel[0, 0] + t * speed - 0.5), rel=1e-4)
    first = float(shutter_delay(columns(x, Array3f), columns(v, Array3f), cam, exact=False)[0])
    assert first == pytest.approx(cam.row_time_s * (pixel[0, 0] - 0.5), rel=1e-4)


def test_shutter_limits_are_finite():
    cam = camera(48, 36, row_time_s=1e-3, readout="right")
    x = np.array([[0, 0, 0], cam.position, cam.position - [0, 5, 0], [50.0, 0, 0], [0, 0, 0]])
    v = np.array([[1e4, 0, 0], [1, 1, 1], [1, 1, 1], [0, 0, 0], [-1e4, 0, 0]])
    X, V = columns(x, Array3f), columns(v, Array3f)
    dr.enable_grad(X, V)
    delay = shutter_delay(X, V, cam)
    dr.backward(dr.sum(delay))
    assert np.isfinite(delay.numpy()).all() and (np.abs(delay.numpy()) <= 10 * 2 * 48 * 1e-3).all()
    assert all(np.isfinite(dr.grad(c).numpy()).all() for c in (*X, *V))
    assert delay[1] == 0 and delay[2] == 0


def test_rolling_shutter_shears_a_moving_flame_and_leaves_static_ones():
    still, g = camera(60, 40), gaussians(60, 3, 0.03)
    rolling = dataclasses.replace(still, row_time_s=1e-3, readout="down")
    moving = transient(g, [1.0, 0.0, 0.0])
    a, b = render(moving, still, 0.0)["color"], render(moving, rolling, 0.0)["color"]
    assert np.abs(a - b).max() > 0.05
    assert np.array_equal(render(moving, rolling, 0.0, shutter="global")["color"], a)
    fixed = transient(g, [1.0, 0.0, 0.0], dynamic=False)
    np.testing.assert_allclose(render(fixed, rolling, 0.0)["color"], render(fixed, still, 0.0)["color"], atol=1e-6)
    x, o = moving.at(0.0)
    delay = reference.shutter_delay(x, moving.velocity, rolling)
    want = reference.render(
        x + delay[:, None] * moving.velocity, moving.rotation, moving.scale, o, moving.color, rolling
    )[0]
    assert (np.abs(b - want) > 1e-3).mean() < 5e-3


def test_harmonics_through_render():
    cam, g = camera(40, 30), gaussians(30, 3, 0.08)
    tg = transient(g, [0.0, 0, 0])
    tg.color = np.random.default_rng(0).normal(0, 0.3, (30, 16, 3)).astype(np.float32)
    color = reference.harmonics_color(tg.color, tg.position, cam.position, 3)
    want = reference.render(tg.position, tg.rotation, tg.scale, tg.opacity, color, cam)[0]
    assert (np.abs(render(tg, cam, 0.0)["color"] - want) > 1e-4).mean() < 5e-3


def test_speed_of_1e4_metres_per_second_leaves_the_image():
    g = gaussians(20, 1, 0.05)
    out = render(transient(g, [1e4, 0, 0]), camera(), 0.5)
    assert all(np.isfinite(v).all() for v in out.values()) and out["alpha"].max() == 0


def test_dynamic_alpha_counts_only_flagged_gaussians():
    cam, g = camera(30, 30), gaussians(10, 1, 0.1)
    frame = render_splats(splats(g), cam, dynamic=Float([1.0, 0.0] * 5))
    none = render_splats(splats(g), cam, dynamic=Float([0.0] * 10))
    assert 0 < frame.dynamic_alpha.numpy().max() <= frame.alpha.numpy().max() and not none.dynamic_alpha.numpy().any()


@pytest.mark.long
def test_memory_of_a_crowded_image_is_bounded_by_the_budget():
    """1500 Gaussians over the whole image are 2.9 million pairs; a budget of a tenth lowers peak memory."""
    cam, g = camera(176, 176), gaussians(1500, 1, 3.0)
    g["opacity"][:] = 0.02
    peaks = []
    for budget in (1 << 24, 1 << 18):
        dr.flush_malloc_cache()
        dr.detail.malloc_clear_statistics()
        frame, _, grads = draw(g, cam, pair_budget=budget)
        peaks.append(dr.detail.malloc_watermark(dr.backend_v(Float)))
        assert all(np.isfinite(v).all() for v in grads.values())
        assert frame.intersections > 2.5e6
    assert peaks[1] < 0.35 * peaks[0], peaks
