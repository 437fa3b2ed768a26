"""Emissive Gaussians over what lies behind them: the closed form, the plain twin, gradients, and hard cases."""

from dataclasses import replace

import drjit as dr
import numpy as np
import pytest

from gof.core.colour import add_light as add_light_plainly
from gof.core.colour import linear_to_srgb, srgb_to_linear
from gof.core.errors import DataFormatError
from gof.render import Splats, render, render_splats
from gof.render.backend import floats
from gof.render.light import add_light, show_before, sum_light, to_display
from gof.render.rasterizer import splats_at
from tests.conftest import random_gaussians
from tests.render.scenes import camera


def planes(values):
    return [floats(column) for column in values.T]


def numbers(drawn):
    return np.stack([plane.numpy() for plane in drawn], -1)


def some(n=200, seed=0):
    """Colours over black, opacities about as large as the brightest channel, backgrounds; the first are all 0 or 1."""
    rng = np.random.default_rng(seed)
    color, background = (rng.uniform(0, 0.95, (n, 3)).astype(np.float32) for _ in range(2))
    alpha = np.clip(color.max(1) + rng.normal(0, 0.1, n), 0, 1).astype(np.float32)
    color[:2], alpha[:2], background[:2] = 0, [0, 1], 0
    color[2:4], alpha[2:4], background[2:4] = 1, 1, [[0], [1]]
    return color, alpha, background


def test_light_is_added_in_linear_values():
    """By hand: 0.5 is 0.21404 of linear light, and twice that is the display value 0.68584 (IEC 61966-2-1)."""
    grey = np.full((1, 3), 0.5, np.float32)
    np.testing.assert_allclose(add_light_plainly(grey, grey[:, 0], grey), 0.68584, atol=2e-5)
    dark = np.zeros((1, 3), np.float32)
    smoke = add_light_plainly(dark, np.float32([0.5]), grey)  # half of the light passes: 0.10702
    np.testing.assert_allclose(smoke, 0.36078, atol=2e-5)
    np.testing.assert_allclose(add_light_plainly(grey, np.float32([0.2]), dark), grey, atol=1e-6)


def test_is_its_twin():
    color, alpha, background = some()
    drawn = numbers(add_light(planes(color), floats(alpha), planes(background)))
    np.testing.assert_allclose(drawn, add_light_plainly(color, alpha, background), atol=2e-6)


def test_summed_light_is_what_display_values_show():
    color, alpha, background = some()
    light = numbers(sum_light(planes(color), floats(alpha), planes(srgb_to_linear(background))))
    np.testing.assert_allclose(light, srgb_to_linear(add_light_plainly(color, alpha, background)), atol=1e-5)


def test_gradient_equals_central_differences():
    rng = np.random.default_rng(1)
    color, alpha, background = (values[4:60] for values in some(seed=1))
    far = np.abs(alpha - color.max(1)) > 5e-3  # where cover begins there is a kink, as where two channels are equal
    apart = np.sort(color, 1)[:, 2] - np.sort(color, 1)[:, 1] > 5e-3
    color, alpha, background = (values[far & apart].astype(np.float64) for values in (color, alpha, background))
    weight = rng.normal(size=color.shape)
    inputs = [*planes(color.astype(np.float32)), floats(alpha), *planes(background.astype(np.float32))]
    dr.enable_grad(inputs)
    drawn = add_light(inputs[:3], inputs[3], inputs[4:])
    dr.backward(sum(dr.sum(plane * floats(w)) for plane, w in zip(drawn, weight.T, strict=True)))
    values = np.column_stack([color, alpha, background])

    def loss(v):
        cover = np.maximum(v[:, 3] - v[:, :3].max(1), 0)[:, None]
        light = _linear(v[:, 4:]) * (1 - cover) + _linear(v[:, :3])
        return (_display(light) * weight).sum(1)

    for k, plane in enumerate(inputs):
        step = np.zeros(7)
        step[k] = 1e-6
        wanted = (loss(values + step) - loss(values - step)) / 2e-6
        np.testing.assert_allclose(dr.grad(plane).numpy(), wanted, rtol=2e-3, atol=2e-3)


@pytest.mark.parametrize("pictures", [1, 3])
def test_pictures_before_one_plate_are_each_before_it(pictures):
    """Values by the twin; gradients by those of `add_light`, which central differences hold: a plate's add up."""
    rng = np.random.default_rng(5)
    drawn = [some(seed=k)[:2] for k in range(pictures)]
    color, alpha = (np.concatenate(values) for values in zip(*drawn, strict=True))
    plate = srgb_to_linear(some(seed=9)[2])
    weight = rng.normal(size=color.shape).astype(np.float32)

    def differentiated(show, behind):
        inputs = [*planes(color), floats(alpha), *planes(behind)]
        dr.enable_grad(inputs)
        shown = show(inputs[:3], inputs[3], inputs[4:])
        dr.backward(sum(dr.sum(plane * floats(w)) for plane, w in zip(shown, weight.T, strict=True)))
        return numbers(shown), [dr.grad(plane).numpy() for plane in inputs]

    shown, found = differentiated(lambda c, a, b: show_before(c, a, b, pictures), plate)
    again = np.tile(plate, (pictures, 1))
    np.testing.assert_allclose(shown, add_light_plainly(color, alpha, linear_to_srgb(again)), atol=5e-6)
    one_by_one = lambda c, a, b: [to_display(light) for light in sum_light(c, a, b)]  # noqa: E731
    _, wanted = differentiated(one_by_one, again)
    for k in range(4):
        np.testing.assert_allclose(found[k], wanted[k], rtol=1e-5, atol=1e-6)
    for k in range(4, 7):
        np.testing.assert_allclose(found[k], wanted[k].reshape(pictures, -1).sum(0), rtol=1e-4, atol=1e-5)
    assert all(np.isfinite(gradient).all() for gradient in found)
    inputs = [*planes(color), floats(alpha), *planes(plate)]
    dr.enable_grad(inputs)
    dr.backward(dr.sum(show_before(inputs[:3], inputs[3], inputs[4:], pictures)[1]))  # two channels have no gradient
    assert not inputs[4].grad.numpy().any() and inputs[5].grad.numpy().any() and len(inputs[5].grad) == len(plate)


def _linear(x):
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)


def _display(x):
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.abs(x) ** (1 / 2.4) - 0.055)


def test_nothing_and_white_have_finite_gradients():
    color, alpha, background = (values[:4] for values in some())
    inputs = [*planes(color), floats(alpha), *planes(background)]
    dr.enable_grad(inputs)
    drawn = add_light(inputs[:3], inputs[3], inputs[4:])
    dr.backward(sum(dr.sum(plane) for plane in drawn))
    assert np.isfinite(numbers(drawn)).all()
    assert all(np.isfinite(dr.grad(plane).numpy()).all() for plane in inputs)


def test_a_flame_keeps_the_blue_of_the_wall_behind_it():
    g = replace(random_gaussians(60), color=np.tile(np.float32([1, 0.4, 0]), (60, 1)), dynamic=np.ones(60, bool))
    view, wall = camera(), (0.3, 0.3, 0.35)
    over_black = render(g, view, 0.0)
    lit = render(replace(g, emissive=True), view, 0.0, background=wall)["color"]
    blended = render(g, view, 0.0, background=wall)["color"]
    flame = over_black["alpha"] > 0.3
    assert flame.any(), "otherwise nothing is tested"
    np.testing.assert_allclose(lit[flame, 2], 0.35, atol=1e-3)
    assert (blended[flame, 2] < 0.26).all()
    wanted = add_light_plainly(over_black["color"], over_black["alpha"], np.broadcast_to(np.float32(wall), lit.shape))
    np.testing.assert_allclose(lit, wanted, atol=1e-5)
    np.testing.assert_array_equal(render(replace(g, emissive=True), view, 0.0)["color"], over_black["color"])


def test_emissive_gaussians_have_three_channels():
    s = splats_at(random_gaussians(3), camera(), 0.0)
    one = Splats(s.position, s.rotation, s.scale, s.opacity, s.color[:1])
    with pytest.raises(DataFormatError, match="red, green, blue"):
        render_splats(one, camera(), [0.0], emissive=True)
