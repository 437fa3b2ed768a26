"""The plate in the fire's light, against scenes whose light is known."""

import warnings

import cv2
import numpy as np

from gof.footage.flame_mask import flame_mask
from gof.reconstruct.lit_plate import faint_flame, lit_plate

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


def faint_beside_bright(noise=0.0, frames=24):
    """The block of `flame_in_a_lit_room`, and a flame left of it that is no brighter than the light on the wall."""
    static, truth, images, bright = flame_in_a_lit_room(frames=frames)
    faint = np.zeros_like(bright)
    for k in range(frames):
        faint[k, 60 + k : 70 + k, 2:9] = True
    images = np.where((faint & ~bright)[..., None], images + [0.18, 0.08, 0.0], images)
    images = images + noise * np.random.default_rng(1).normal(size=images.shape)
    return static, truth, images, bright, faint & ~bright


def test_faint_flame_is_found_and_thrown_light_is_not():
    static, truth, images, bright, faint = faint_beside_bright()
    unseen = np.zeros((len(images), 1, 1), bool)
    masks, plate = faint_flame(static, images, bright, unseen)
    near = np.stack([cv2.dilate(mask.astype(np.uint8), np.ones((9, 9))) > 0 for mask in bright | faint])
    assert masks[faint].all() and masks[bright].all() and not masks[~near].any()
    assert np.abs(plate - truth).max() < 1e-6
    dark = np.stack([flame_mask(image, static) for image in images])
    assert not dark[faint].all(), "otherwise the test says nothing"
    low = np.stack([flame_mask(image, static, 0.06, 0.12) for image in images])
    assert low[~near].any(), "a lower threshold alone takes the wall for flame"


def test_noise_is_no_faint_flame():
    """Grain of 0.04, with which single pixels rise by more than the threshold of quiet pictures."""
    static, _, images, bright, faint = faint_beside_bright(noise=0.04)
    masks, _ = faint_flame(static, images, bright, np.zeros((len(images), 1, 1), bool))
    near = np.stack([cv2.dilate(mask.astype(np.uint8), np.ones((9, 9))) > 0 for mask in bright | faint])
    assert masks[~near].mean() < 1e-3
    assert (
        np.mean([flame_mask(image, static, 0.06, 0.12)[~n].mean() for image, n in zip(images, near, strict=True)]) > 0.2
    )


def test_where_thrown_light_is_unknown_bright_flame_is_all():
    static, _, images, bright, _ = faint_beside_bright()
    masks, plate = faint_flame(static, images[:1], bright[:1], np.zeros((1, 1, 1), bool))
    assert np.array_equal(masks, bright[:1]) and np.allclose(plate, static)
    unseen = np.ones((len(images), 1, 1), bool)
    masks, plate = faint_flame(static, images, bright, unseen)
    assert np.array_equal(masks, bright) and np.allclose(plate, static)


def test_noise_is_read_off_pictures_that_were_delivered():
    """Where those that would be taken are none: no NaN, no warning, the same masks for the others."""
    static, _, images, bright, faint = faint_beside_bright()
    unseen = (np.arange(len(images)) % 2 == 0)[:, None, None]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        masks, plate = faint_flame(static, images, bright, unseen)
    assert np.isfinite(plate).all() and masks[1::2][faint[1::2]].all()
