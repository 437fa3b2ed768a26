"""Views from where no camera stood, and a flame over plates that were not filmed."""

from dataclasses import replace

import cv2
import drjit as dr
import numpy as np
import pytest

from gof.reconstruct import unseen
from gof.reconstruct.observation import Observation
from gof.reconstruct.optimize import halve, look_up, measure_beyond, over_plain
from gof.reconstruct.parameters import from_raw, splats, to_raw
from gof.reconstruct.unseen import OFTEN, cameras_around, find_flame_emission, imagine_views, unsaturated_light
from gof.reconstruct.voxels import carve
from gof.render import render_splats
from gof.render.backend import Float, floats, opaque
from tests.conftest import arc, look_at
from tests.reconstruct.test_surroundings import CAMERA, cloud
from tests.reconstruct.test_voxels import ball

MIDDLE, RADIUS = np.array([0.1, -0.05, 1.0]), 0.25


def shown(linear):
    """Display values of linear light by the standard's formula (IEC 61966-2-1)."""
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0) ** (1 / 2.4) - 0.055)


def seen(thickness, color, plate=0.02):
    """(F, C, H, W, 3) display values of a flame that takes nothing away: 1 - (1 - plate) exp(-thickness color)."""
    return shown(1 - (1 - plate) * np.exp(-thickness[..., None] * np.array(color))).astype(np.float32)


def observation(thickness, cameras, color, plate=0.02, delivered=True):
    image = seen(thickness, color, plate)
    frames, count, height, width = thickness.shape
    plates = np.full((count, height, width, 3), shown(np.float64(plate)), np.float32)
    return Observation(
        cameras=cameras,
        frames=np.arange(frames),
        time_s=0.1 + 0.01 * np.arange(frames),
        camera_time_s=np.tile(0.1 + 0.01 * np.arange(frames), (count, 1)),
        image=image,
        static=plates,
        plate=plates,
        intensity=np.zeros(thickness.shape, np.float32),
        mask=thickness > 0,
        allowed=thickness > 0,
        flow=np.zeros((*thickness.shape, 2), np.float32),
        delivered=np.broadcast_to(np.array(delivered), (frames, count)).copy(),
        blocked=np.zeros((count, height, width), bool),
    )


def imagined(observed):
    return imagine_views(find_flame_emission(observed, 48), observed)


def ball_observation(color=(3.0, 1.0, 0.05), frames=2, **kwargs):
    """A ball of even fire, by exact path lengths (m), seen by three cameras."""
    cameras = arc(3)
    lengths = ball(cameras, MIDDLE, RADIUS)[1]
    return observation(np.stack([4 * lengths] * frames), cameras, color, **kwargs)


@pytest.mark.parametrize("reach", [3, 5])
def test_a_mask_that_reaches_beyond_the_flame_does_not_glow(reach):
    """Around the ball the masks hold pixels whose red differs from the plate by 0.06, and no flame."""
    observed = ball_observation()
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1, 2 * reach + 1))
    wide = np.array([[cv2.dilate(m.astype(np.uint8), disc) > 0 for m in frame] for frame in observed.mask])
    image = observed.image.copy()
    image[wide & ~observed.mask, 0] = shown(np.float32(0.02 + 0.06))
    loose = replace(observed, mask=wide, allowed=wide, image=image)
    views = imagined(loose)
    for v, camera in enumerate(views.cameras):
        _, lengths = ball([camera], MIDDLE, RADIUS)
        near = cv2.dilate((lengths[0] > 0).astype(np.uint8), np.ones((7, 7))) > 0
        light = views.view([1], v).light[0].reshape(camera.height, camera.width)
        assert light[~near].max() < 0.02, "a third of what the masks' rim has"


def test_a_ball_is_a_ball_from_everywhere():
    observed = ball_observation()
    views = imagined(observed)
    assert views.thickness.shape[:2] == (2, len(views.cameras)) and views.time_s.tolist() == pytest.approx([0.1, 0.11])
    for v, camera in enumerate(views.cameras):
        _, lengths = ball([camera], MIDDLE, RADIUS)
        light = views.view([1], v).light[1].reshape(camera.height, camera.width)
        true = 0.98 * (1 - np.exp(-4 * lengths[0]))  # above a plate of 0.02
        assert np.abs(light - true).mean() < 0.2 * true.mean() and light.max() == pytest.approx(true.max(), rel=0.03)
        assert light.mean() == pytest.approx(true.mean(), rel=0.08)
        assert light[lengths[0] == 0].mean() < 0.05 * true.max(), "there is hardly anything beside it"


def test_they_stand_around_the_flame_and_above_it_and_have_all_of_it_in_view():
    cameras = arc(3)
    masks, _ = ball(cameras, MIDDLE, RADIUS)
    voxels = carve(cameras, masks[None], 24)
    *around, above = cameras_around(voxels, cameras, 8)
    middle = (voxels.center.min(0) + voxels.center.max(0)) / 2
    offset = np.stack([camera.position for camera in around]) - middle
    given = np.stack([camera.position for camera in cameras]) - middle
    assert np.linalg.norm(offset, axis=1) == pytest.approx(np.linalg.norm(given, axis=1).mean())
    turned = np.diff(np.unwrap(np.arctan2(offset[:, 1], offset[:, 0])))
    assert turned == pytest.approx(np.pi / 4)
    assert all(camera.world_to_camera[1, 2] < 0 for camera in around), "up is up"
    np.testing.assert_allclose(above.world_to_camera[2, :3], [0, 0, -1], atol=1e-12, err_msg="it looks straight down")
    np.testing.assert_allclose(
        above.position - middle, [0, 0, np.linalg.norm(offset[0])], atol=1e-9, err_msg="as far away"
    )
    for camera in (*around, above):
        pixel, depth = camera.project(voxels.center)
        assert (depth > 0).all() and (pixel > 0).all() and (pixel < [camera.width, camera.height]).all()
        rotation = camera.world_to_camera[:3, :3]
        assert rotation @ rotation.T == pytest.approx(np.eye(3)) and np.linalg.det(rotation) == pytest.approx(1)
    beside = np.array(
        [middle, middle + voxels.voxel_size * np.cross(offset[0], [0, 0, 1]) / np.linalg.norm(offset[0, :2])]
    )
    assert np.linalg.norm(np.diff(around[0].project(beside)[0], axis=0)) == pytest.approx(1, rel=0.02), (
        "a voxel, a pixel"
    )


def test_a_given_camera_in_the_flame_makes_no_huge_picture():
    cameras = arc(3)
    masks, _ = ball(cameras, MIDDLE, RADIUS)
    voxels = carve(cameras, masks[None], 24)
    inside = [look_at("a", MIDDLE + 0.05 * np.array([np.sin(a), -np.cos(a), 0.1]), MIDDLE) for a in (0.0, 0.3)]
    extent = np.ptp(voxels.center, axis=0).max() / voxels.voxel_size
    for camera in cameras_around(voxels, inside):
        assert max(camera.width, camera.height) < 4 * extent
        pixel, depth = camera.project(voxels.center)
        assert (depth > 0).all() and (pixel > 0).all() and (pixel < [camera.width, camera.height]).all()


@pytest.mark.parametrize(
    "color, told", [((60.0, 1.0, 0.05), 1), ((1.6, 0.5, 0.02), 0), ((1.0, 0.3, 0.02), 0), ((0.1, 0.2, 0.9), 2)]
)
def test_thickness_is_told_by_the_brightest_channel_that_is_not_white(color, told):
    observed = ball_observation(color)
    thickness = unsaturated_light(observed)
    true = 4 * ball(observed.cameras, MIDDLE, RADIUS)[1] * color[told]
    saturated = (seen(true[None] / color[told], color)[..., told] > 0.97)[0]
    assert saturated.mean() < OFTEN
    np.testing.assert_allclose(thickness[0][~saturated], true[~saturated], atol=0.02)


def test_light_of_a_thickness_is_its_mean_in_the_clip():
    """Three frames of one ball, whose blue differs: by exact path lengths, in two 0.02 of its thickness, in one 0.4."""
    observed = ball_observation((1.0, 0.3, 0.02), frames=3)
    lengths = 4 * ball(observed.cameras, MIDDLE, RADIUS)[1]
    image = observed.image.copy()
    image[2] = seen(lengths[None], (1.0, 0.3, 0.4))[0]
    view = imagined(replace(observed, image=image)).view([0], 0)
    red, _, blue = view.light
    thick = red > 0.6
    through = 1 - red[thick] / 0.98
    mean = 0.98 * np.mean([1 - through**share for share in (0.02, 0.02, 0.4)], axis=0)
    assert thick.sum() > 20
    np.testing.assert_allclose(blue[thick], mean, rtol=0.1)
    usual = 0.98 * (1 - through**0.02)
    np.testing.assert_allclose(view.spread[2][thick], mean - usual, rtol=0.15, err_msg="two of three are so far off")
    assert view.spread[0][thick].max() < 0.08 * red.max(), "red is the same in all, but for the voxels' noise"
    assert not view.spread[:, view.light[0] == 0].any(), "where nothing is, nothing may be"


def test_white_pictures_and_white_plates_are_finite():
    observed = ball_observation()
    for image, plate in ((1.0, 0.0), (1.0, 1.0), (0.0, 1.0), (0.0, 0.0)):
        dull = replace(observed, image=np.full_like(observed.image, image), plate=np.full_like(observed.plate, plate))
        assert np.isfinite(unsaturated_light(dull)).all()
        views = imagined(dull)
        assert views is None or np.isfinite(views.view([0], 0).light).all()


def test_a_camera_with_another_exposure_is_brought_to_the_others():
    """Exact path lengths of one ball, by cameras at three distances: one of them has a quarter of the light, or all."""
    away = (2.5, 3.0, 3.6)
    cameras = [replace(arc(3, radius=r)[k], name=f"cam_{k}") for k, r in enumerate(away)]
    masks, lengths = ball(cameras, MIDDLE, RADIUS)
    voxels = carve(cameras, masks[None], 32)
    for part, expected in ((0.25, 4.0), (1.0, 1.0), (0.8, 1.0)):
        light = np.stack([lengths * np.reshape([1, part, 1], (3, 1, 1))] * 2)
        gains = unseen.find_gains(voxels, light, np.stack([masks] * 2))
        assert gains == pytest.approx([1, expected, 1], rel=0.1)
    assert unseen.find_gains(voxels, 0 * light, np.stack([masks] * 2)).tolist() == [1, 1, 1]
    seen_in_part = replace(cameras[1], height=cameras[1].height // 2)  # its picture ends in the middle of the ball
    cut = np.where(np.arange(lengths.shape[1])[:, None] < seen_in_part.height, lengths, 0)
    voxels = carve([cameras[0], seen_in_part, cameras[2]], masks[None], 32)
    outside = voxels.pixel[1, :, 1] >= seen_in_part.height
    voxels.pixel[1, outside] = np.nan
    light = np.stack([np.stack([lengths[0], cut[1], lengths[2]])] * 2)
    assert outside.mean() > 0.3
    assert unseen.find_gains(voxels, light, np.stack([masks] * 2)).tolist() == [1, 1, 1], "a cut-off flame is not dim"
    one_dark = light * np.reshape([1, 0, 1], (3, 1, 1))
    assert unseen.find_gains(voxels, one_dark, np.stack([masks] * 2)).tolist() == [1, 1, 1]


def test_light_far_beside_the_flame_is_none_of_it(monkeypatch):
    """A speck of light half a metre beside a ball, in all three cameras' masks, and no flame there."""
    cameras = arc(3)
    far = MIDDLE + [0.45, 0.2, 0.1]
    lengths = ball(cameras, MIDDLE, 0.12)[1] + ball(cameras, far, 0.03)[1]
    seen = observation(np.stack([4 * lengths] * 2), cameras, (3.0, 1.0, 0.05))

    def share(place, radius):
        light = find_flame_emission(seen, 96)
        within = np.linalg.norm(light.voxels.center - place, axis=1) < radius
        return light.emission[:, within].sum() / light.emission.sum()

    assert share(far, 0.2) < 0.001 and share(MIDDLE, 0.15) > 0.9
    with monkeypatch.context() as wider:
        wider.setattr(unseen, "FAR", 100.0)
        assert share(far, 0.2) > 0.005
    monkeypatch.setattr(unseen, "ANOTHER", 0.005)
    assert share(far, 0.2) > 0.005, "so bright, it is another flame"


def test_lit_ground_behind_the_flame_is_none_of_it_and_fire_beside_it_is():
    """A round flame, and a hundredth of its light 4.5 of its std-devs away, along the cameras' rays or across."""
    cameras, deviation = arc(3), 0.1
    voxels = carve(cameras, ball(cameras, MIDDLE, 0.6)[0][None], 40)
    offset = voxels.center - MIDDLE
    ahead = cameras[1].world_to_camera[2, :3]
    flame = np.exp(-0.5 * (offset**2).sum(1) / deviation**2)
    flame *= (offset**2).sum(1) < (2.5 * deviation) ** 2
    for direction, kept in ((ahead, False), (-ahead, False), (np.cross(ahead, [0, 0, 1]), True)):
        patch = np.linalg.norm(offset - 4.5 * deviation * direction, axis=1) < 0.05
        light = flame + patch * 0.01 * flame.sum() / patch.sum()
        near = unseen._is_near(voxels, light)
        assert near[flame > 0].all() and (near[patch].all() if kept else not near[patch].any())


@pytest.mark.parametrize("side", [16, 24, 30])
def test_light_is_pooled_in_coarser_voxels(side):
    """A ball's light keeps its sum and its place, and even light stays even, whatever the ratio of the voxels."""
    observed = ball_observation()
    light = find_flame_emission(observed, 48)
    coarse = carve(observed.cameras, observed.mask, side)
    pooled = light.pool(coarse)
    assert np.average(coarse.center, axis=0, weights=pooled[1]) == pytest.approx(MIDDLE, abs=0.01)
    assert pooled.sum() == pytest.approx(light.emission.sum(), rel=0.05), "hardly any is outside the coarser hull"
    deep = np.linalg.norm(coarse.center - MIDDLE, axis=1) < RADIUS - 2 * coarse.voxel_size
    even = replace(light, emission=np.ones_like(light.emission)).pool(coarse)[0]
    assert deep.any()
    assert even[deep] == pytest.approx((coarse.voxel_size / light.voxels.voxel_size) ** 3, rel=1e-3)


def test_frames_that_a_camera_did_not_take_are_left_out():
    observed = ball_observation(frames=3)
    observed.delivered[1, 2] = False
    views = imagined(observed)
    assert views.time_s.tolist() == pytest.approx([0.1, 0.12])
    rng = np.random.default_rng(0)
    found = [views.choose(frames, rng) for frames in ([0], [1], [2], [0, 2], [0, 1])]
    times = [None if view is None else view.time_s.tolist() for view in found]
    assert times == [pytest.approx([0.1]), None, pytest.approx([0.12]), pytest.approx([0.1, 0.12]), None]
    single, both = found[0], found[3]
    assert single is not None and both is not None
    pixels = single.camera.width * single.camera.height
    assert len(both.thickness) == 2 * pixels
    np.testing.assert_array_equal(views.view([0], 3).thickness, views.view([0, 1], 3).thickness[:pixels])
    observed.delivered[:] = False
    assert imagined(observed) is None


# ---------------------------------------------------------------- light over plates


def test_fire_adds_light_to_a_plain_plate():
    plain, light = np.array([0.3, 0.2, 0.1]), np.array([[0.3], [0.1], [0.0]], np.float32)
    behind = ((plain + 0.055) / 1.055) ** 2.4
    drawn = [p.numpy()[0] for p in over_plain([floats(plane) for plane in light], plain)]
    np.testing.assert_allclose(drawn, shown(behind + light[:, 0]), atol=1e-5)
    white = [p.numpy()[0] for p in over_plain([floats(plane + 3) for plane in light], plain)]
    np.testing.assert_allclose(white, 1, atol=1e-6)  # a screen shows no more


@pytest.mark.parametrize("count", [2, 3, 17, 48])
def test_curves_are_looked_up_as_numpy_does(count):
    """Below the first level and beyond the last they are even; equal levels divide by nothing."""
    rng = np.random.default_rng(count)
    levels = np.sort(rng.uniform(0.1, 5, count))
    levels[-2:] = levels[-1] if count > 3 else levels[-2:]
    curves = rng.random((count, 6))
    x = np.concatenate([[0, 100], levels[:-2], rng.uniform(0, 6, 300)]).astype(np.float32)
    found = np.stack([plane.numpy() for plane in look_up(floats(x), levels, curves)], -1)
    expected = np.stack([np.interp(x, levels.astype(np.float32), curve) for curve in curves.T], -1)
    np.testing.assert_allclose(found, expected, atol=2e-5)


def test_finer_pixels_are_averaged():
    fine = np.random.default_rng(0).random((6, 10)).astype(np.float32)
    plane = Float(fine.ravel())
    dr.enable_grad(plane)
    coarse = halve(plane, 5, 3)
    expected = cv2.resize(fine, (5, 3), interpolation=cv2.INTER_AREA)
    np.testing.assert_allclose(dr.detach(coarse).numpy(), expected.ravel(), rtol=1e-6)
    weight = np.arange(15, dtype=np.float32)
    dr.backward(dr.sum(coarse * Float(weight)))
    each = np.kron(weight.reshape(3, 5), np.full((2, 2), 0.25))
    np.testing.assert_allclose(dr.grad(plane).numpy(), each.ravel(), rtol=1e-6)


def test_gaussians_are_free_within_the_spread():
    seen, least, most = (Float(np.float32(x)) for x in ([0.1, 0.4, 0.5, 0.9], [0.3] * 4, [0.5] * 4))
    dr.enable_grad(seen)
    loss = measure_beyond([seen], [least], [most])
    assert float(loss.array[0]) == pytest.approx((0.2 + 0.4) / 4)
    dr.backward(loss)
    np.testing.assert_allclose(dr.grad(seen).numpy(), [-0.25, 0, 0, 0.25])


# ---------------------------------------------------------------- colours of light


def colored(color):
    return replace(cloud(0.0, n=len(color)), color=np.array(color, np.float32), dynamic=np.ones(len(color), bool))


def test_colors_keep_their_hue_and_the_brightest_channel_is_1():
    color = [[0.1, 0.5, 0.9], [0.02, 1.0, 0.3], [-0.2, 1.3, 0.65], [0.0, 0.0, 0.0]]
    raw = to_raw(colored(color), 0.1, 0.0)
    hue = [[1 / 9, 5 / 9, 1], [0.02, 1, 0.3], [0, 1, 0.65], [1, 1, 1]]  # a display shows none above 1
    np.testing.assert_allclose(from_raw(raw, 0.1, 0.0).color, hue, atol=2e-3)
    for far in (1e4, 1e30):
        raw["color_logit"] = type(raw["color_logit"])(*[far * (c - 0.5) for c in raw["color_logit"]])
        found = from_raw(raw, 0.1, 0.0).color
        assert np.isfinite(found).all() and (found >= 0).all() and (found <= 1).all()
        assert (found[:3].max(1) == 1).all() and (found[3] == 0).all(), "black alone, of -5000, stays black"
    free = from_raw(to_raw(colored(color), 0.1, 0.0, color_of_light=False), 0.1, 0.0)
    np.testing.assert_allclose(free.color, color, atol=1e-6)


@pytest.mark.parametrize("channel", [0, 1, 2])
def test_their_gradient_is_that_of_differences_and_finite_far_away(channel):
    raw = to_raw(colored([[0.2, 0.6, 0.9]] * 3), 0.1, 0.0)
    raw["opacity"] = Float([-200.0, 0.0, 200.0])

    def total(logit):
        logits = [logit if k == channel else x[0] for k, x in enumerate(raw["color_logit"])]
        now = raw | {"color_logit": type(raw["color_logit"])(*[dr.repeat(Float(x), 3) for x in logits])}
        planes = render_splats(splats(now, 0.1, 0.0, CAMERA), CAMERA).color
        return dr.sum(planes[0]) + 2 * dr.sum(planes[1]) + 3 * dr.sum(planes[2])

    for value in (-2.0, 0.5):  # darker than the brightest of the others, and the brightest of all
        logit = Float(value)
        dr.enable_grad(logit)
        dr.backward(total(logit))
        step = 0.05
        difference = (total(Float(value + step)) - total(Float(value - step)))[0] / (2 * step)
        assert dr.grad(logit)[0] == pytest.approx(difference, rel=2e-2)
    for value in (-500.0, 500.0):
        logit = opaque(value)
        dr.enable_grad(logit)
        dr.backward(total(logit))
        assert np.isfinite(dr.grad(logit)[0])
