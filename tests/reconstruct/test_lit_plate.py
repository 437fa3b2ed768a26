"""The plate in the fire's light, against scenes whose light is known."""

import numpy as np

from gof.reconstruct.lit_plate import lit_plate

HEIGHT, WIDTH, FRAMES = 96, 60, 12


def flame_in_a_lit_room(flicker=0.0, frames=FRAMES):
    """A white block that wanders sideways before a textured wall, which it lights warm and more strongly below."""
    static = 0.1 + 0.2 * np.random.default_rng(0).random((HEIGHT, WIDTH, 3))
    light = np.linspace(0.0, 0.2, HEIGHT)[:, None, None] * np.array([1.0, 0.6, 0.3])
    images, masks = [], []
    for k in range(frames):
        mask = np.zeros((HEIGHT, WIDTH), bool)
        mask[30:80, 10 + 2 * k : 24 + 2 * k] = True
        strength = 1 + flicker * np.sin(2 * np.pi * k / frames)
        images.append(np.where(mask[..., None], 0.95, static + strength * light))
        masks.append(mask)
    return static, static + light, np.stack(images), np.stack(masks)


def test_light_that_stands_still_is_found_exactly():
    static, truth, images, masks = flame_in_a_lit_room()
    plate = lit_plate(static, images, masks)
    assert np.abs(plate - truth).max() < 1e-6
    assert np.abs(static - truth).max() > 0.19, "otherwise the test says nothing"


def test_flicker_leaves_the_middle():
    static, truth, images, masks = flame_in_a_lit_room(flicker=0.3)
    error = np.abs(lit_plate(static, images, masks) - truth)
    assert error.mean() < 0.25 * 0.3 * (truth - static).mean()


def test_what_is_always_behind_the_flame_gets_the_light_around_it():
    static, truth, images, masks = flame_in_a_lit_room()
    masks[:, 40:50, 30:36] = True
    hidden = masks.all(0)
    images[:, hidden] = 0.95
    plate = lit_plate(static, images, masks)
    assert np.abs(plate - truth)[hidden].mean() < 0.1 * (truth - static)[hidden].mean()
    assert np.abs(plate - truth)[~hidden].max() < 1e-6


def test_without_anything_to_see_the_plate_stays_as_it_is():
    static, _, images, masks = flame_in_a_lit_room()
    assert np.allclose(lit_plate(static, images, np.ones_like(masks)), static, atol=1e-6)
    one = lit_plate(static, images[:1], masks[:1])  # a single picture has no median
    assert np.allclose(one, static, atol=1e-6)
    assert np.isfinite(lit_plate(np.ones_like(static), images, masks)).all()
