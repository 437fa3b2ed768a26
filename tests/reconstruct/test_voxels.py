"""Hull carving and tomography on shapes whose truth is known."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from gof.core.errors import DataFormatError
from gof.reconstruct import tomography as tomography_module
from gof.reconstruct.tomography import (
    TAIL,
    TURNS,
    _inner_radius,
    _pool_view,
    cut_tails,
    find_emission,
    round_flame,
    tomography,
    turn_around,
)
from gof.reconstruct.voxels import carve, flame_box
from tests.conftest import arc, look_at


def ball(cameras, center=(0, 0, 1.0), radius=0.25):
    """Masks (C, H, W) and path lengths (C, H, W) of a ball, by exact ray-sphere intersection."""
    lengths = []
    for cam in cameras:
        x, y = np.meshgrid(np.arange(cam.width) + 0.5, np.arange(cam.height) + 0.5)
        rays = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(cam.K).T
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        c = cam.to_camera(np.array([center]))[0]
        b = rays @ c
        lengths.append(2 * np.sqrt(np.maximum(radius**2 - (c @ c - b**2), 0)))
    lengths = np.stack(lengths)
    return lengths > 0, lengths


def test_box_holds_the_flame_and_is_not_huge():
    cameras = arc(3)
    masks, _ = ball(cameras, center=(0.1, -0.1, 1.1))
    low, high = flame_box(cameras, masks)
    assert (low < np.array([0.1, -0.1, 1.1]) - 0.25).all() and (high > np.array([0.1, -0.1, 1.1]) + 0.25).all()
    assert (high - low).max() < 1.2


def test_hull_of_a_ball():
    cameras = arc(3)
    masks, _ = ball(cameras)
    voxels = carve(cameras, masks[None], 24)
    distance = np.linalg.norm(voxels.center - [0, 0, 1], axis=1)
    inside = 4 / 3 * np.pi * 0.25**3
    volume = len(distance) * voxels.voxel_size**3
    assert inside * 0.95 < volume < inside * 2.0, "the hull holds the ball; three views in an arc leave some extra"
    assert distance.max() < 0.6


def test_tomography_finds_the_ball_inside_its_hull():
    cameras = arc(3)
    masks, lengths = ball(cameras)
    # Carve with a larger mask so that the hull is no help.
    voxels = carve(cameras, np.ones_like(masks)[None], 24)
    emission = tomography(voxels, lengths, np.ones_like(masks))
    inside = np.linalg.norm(voxels.center - [0, 0, 1], axis=1) < 0.25
    assert emission[inside].sum() / emission.sum() > 0.6
    assert inside.mean() < 0.15, "otherwise the test says nothing"
    assert (emission >= 0).all() and np.isfinite(emission).all()
    assert emission[emission > 0].mean() == pytest.approx(1)


find_turned = partial(find_emission, turns=TURNS)


def depth_and_width(voxels, emission, camera, middle):
    """Standard deviations of the emission along and across a camera's viewing direction, m."""
    forward = camera.world_to_camera[2, :3]
    offset = voxels.center - middle
    along = offset @ forward
    across = offset @ np.cross(forward, [0, 0, 1])
    return [float(np.sqrt(np.average(x**2, weights=emission))) for x in (along, across)]


def test_a_flame_is_about_as_deep_as_it_is_wide(monkeypatch):
    cameras, middle, radius = arc(3), np.array([0.12, -0.08, 1.05]), 0.25
    masks, lengths = ball(cameras, middle, radius)
    voxels = carve(cameras, masks[None], 32)
    emission = tomography(voxels, lengths, masks)
    depth, width = depth_and_width(voxels, emission, cameras[1], middle)
    assert width == pytest.approx(radius / np.sqrt(5), rel=0.05)
    assert depth == pytest.approx(radius / np.sqrt(5), rel=0.1)
    depth_of_best = voxels.center[round_flame(voxels, emission) > 0.99] @ cameras[1].world_to_camera[2, :3]
    found = depth_of_best - middle @ cameras[1].world_to_camera[2, :3]
    assert np.abs(found).max() < 2 * voxels.voxel_size, "its middle is found, off the centre"
    monkeypatch.setattr(tomography_module, "round_flame", lambda v, emission: np.ones(len(emission)))
    depth, width = depth_and_width(voxels, tomography(voxels, lengths, masks), cameras[1], middle)
    assert depth > 1.08 * width, "an even start stretches it along the view"


@pytest.mark.parametrize("find", [find_emission, find_turned])
def test_a_flame_seen_from_nearly_one_side_and_above_is_no_deeper_than_wide(find):
    """Three cameras 9 degrees apart that look down by 21: a ball's light is known, off the origin."""
    middle, radius, climb = np.array([0.1, 0.15, 1.05]), 0.25, np.deg2rad(21)
    cameras = []
    for k, angle in enumerate(np.deg2rad([-9, 0, 9])):
        out = np.array([np.sin(angle) * np.cos(climb), -np.cos(angle) * np.cos(climb), np.sin(climb)])
        cameras.append(look_at(f"cam_{k}", middle + 3 * out + [0.02, 0, 0], middle + [0.02, 0, 0]))
    masks, lengths = ball(cameras, middle, radius)
    voxels = carve(cameras, masks[None], 40)
    emission = find(voxels, lengths, masks)
    assert np.average(voxels.center, axis=0, weights=emission) == pytest.approx(middle, abs=0.02)
    depth, width = depth_and_width(voxels, emission, cameras[1], middle)
    assert width == pytest.approx(radius / np.sqrt(5), rel=0.1)
    assert 0.8 * width < depth < 1.22 * width, "never a needle along the rays"


def test_the_disc_that_fits_into_an_outline():
    """A bar 9 px high holds discs of radius 4.5, its thin end of 3 px smaller ones; nothing outside."""
    shape = np.zeros((40, 60), bool)
    shape[10:19, 5:35] = shape[13:16, 35:55] = True
    radius = _inner_radius(shape)
    assert (radius[~shape] == 0).all() and (radius[shape] > 0).all()
    assert radius[14, 15] == pytest.approx(4.5, abs=0.5) and radius[14, 50] == pytest.approx(1.5, abs=0.5)
    assert not _inner_radius(np.zeros((4, 5), bool)).any()


def test_round_flame_needs_views_from_one_side():
    cameras = arc(3)
    masks, _ = ball(cameras)
    voxels = carve(cameras, masks[None], 12)
    even = np.ones(len(voxels.center))
    assert (round_flame(voxels, even) < 1).any()
    behind = voxels.jacobian.copy()
    behind[2, : len(even) // 3] = np.nan  # of voxels behind a camera
    np.testing.assert_allclose(round_flame(replace(voxels, jacobian=behind), even), round_flame(voxels, even), atol=0.1)
    assert (round_flame(replace(voxels, jacobian=np.full_like(behind, np.nan)), even) == 1).all()
    above = np.zeros_like(voxels.jacobian)
    above[:, :, 0, 0] = above[:, :, 1, 1] = 100.0  # x and y move the pixel, z does not: seen from above
    assert (round_flame(replace(voxels, jacobian=above), even) == 1).all()
    turned = [voxels.jacobian[1] @ np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]]), voxels.jacobian[1]]
    all_around = replace(voxels, jacobian=np.stack(turned))
    assert (round_flame(all_around, even) == 1).all(), "a quarter turn apart, they see all sides"


def test_the_flame_of_a_single_camera_stands_over_the_origin_as_deep_as_it_is_wide():
    """A ball over the origin: its radius is known, and its light is within it."""
    camera, middle, radius = arc(3)[2:], np.array([0.0, 0.0, 1.05]), 0.25
    masks, lengths = ball(camera, middle, radius)
    voxels = carve(camera, masks[None], 32)
    emission = tomography(voxels, lengths, masks)
    depth, width = depth_and_width(voxels, emission, camera[0], middle)
    assert [depth, width] == pytest.approx([radius / np.sqrt(5)] * 2, rel=0.1)
    found = np.average(voxels.center, axis=0, weights=emission)
    assert np.abs(found - middle).max() < voxels.voxel_size
    assert np.abs((voxels.center - middle) @ voxels.forward[0]).max() < radius + 3 * voxels.voxel_size


def test_a_single_camera_that_looks_straight_down_cannot_place_its_flame():
    camera = arc(1)[0]
    down = np.eye(4)
    down[:3, :3], down[:3, 3] = np.diag([1.0, -1.0, -1.0]), [0, 0, 3]
    masks = np.ones((1, camera.height, camera.width), bool)
    with pytest.raises(DataFormatError, match="parallel"):
        carve([replace(camera, world_to_camera=down)], masks[None], 8)


def test_tomography_with_nothing_to_see():
    cameras = arc(2)
    masks, lengths = ball(cameras)
    voxels = carve(cameras, masks[None], 10)
    assert (tomography(voxels, lengths, masks & False) == 0).all()
    assert np.isfinite(tomography(voxels, lengths * 0, masks)).all()


@pytest.mark.parametrize("find", [find_emission, find_turned])
def test_a_camera_with_the_flame_behind_it_changes_nothing(find):
    cameras = arc(3)
    masks, lengths = ball(cameras)
    away = replace(cameras[1], world_to_camera=np.diag([-1.0, 1, -1, 1]) @ cameras[1].world_to_camera)
    blind = np.concatenate([masks, masks[:1] & False]), np.concatenate([lengths, lengths[:1] * 0])
    voxels, with_it = carve(cameras, masks[None], 16), carve([*cameras, away], blind[0][None], 16)
    np.testing.assert_allclose(with_it.center, voxels.center)
    found = find(with_it, blind[1], blind[0])
    np.testing.assert_allclose(found, find(voxels, lengths, masks), rtol=0.05, atol=0.02 * found.max())


def test_a_camera_that_lost_the_flame_does_not_carve_everything_but_one_view_is_not_enough():
    cameras = arc(3)
    masks, _ = ball(cameras)
    with pytest.raises(DataFormatError, match="visible in 1 of 3 cameras"):
        carve(cameras, (masks & np.array([True, False, False])[:, None, None])[None], 10)
    with pytest.raises(DataFormatError, match="visible in 0 of 3 cameras"):
        carve(cameras, (masks & False)[None], 10)


def test_parallel_and_disagreeing_cameras_are_named():
    a, b = arc(2)
    same = [a, a]
    masks, _ = ball(same)
    with pytest.raises(DataFormatError, match="parallel"):
        carve(same, masks[None], 10)
    masks, _ = ball([a, b])
    masks[1] = np.roll(masks[1], 30, axis=0)  # flame seen at another height: no common voxel
    masks[1, :34] = False
    masks[0, 30:] = False
    with pytest.raises(DataFormatError, match="no voxel|behind"):
        carve([a, b], masks[None], 10)


# ---- a flame turned around its axis ----------------------------------------------------------------------------------


def two_balls(count, apart=0.5, radius=0.12):
    """Pictures of two equal balls beside each other across the middle view, and where they are: cameras, masks,
    lengths (C, H, W), middles (2, 3)."""
    cameras = arc(count)
    middles = np.array([[-apart / 2, 0.0, 1.0], [apart / 2, 0.0, 1.0]])
    seen = [ball(cameras, middle, radius) for middle in middles]
    return cameras, seen[0][0] | seen[1][0], seen[0][1] + seen[1][1], middles, radius


def share_in_balls(voxels, emission, middles, radius):
    away = np.linalg.norm(voxels.center[:, None] - middles, axis=-1).min(1)
    return emission[away < radius + voxels.voxel_size].sum() / emission.sum()


@pytest.mark.parametrize("count", [2, 3])
def test_light_is_where_two_balls_are(count):
    """Each is as deep as it is wide itself; a start as deep as both are wide together leaves a part of it outside. Two
    views leave some where rays of both cross."""
    cameras, masks, lengths, middles, radius = two_balls(count)
    voxels = carve(cameras, masks[None], 40)
    even, plain, turned = (
        share_in_balls(voxels, find(voxels, lengths, masks), middles, radius)
        for find in (partial(find_emission, rounded=False), find_emission, find_turned)
    )
    assert min(plain, turned) > max(0.95 if count > 2 else 0.9, even + 0.01)


@pytest.mark.parametrize("find", [find_emission, find_turned])
@pytest.mark.parametrize("side", [24, 31, 40])
def test_a_flame_has_no_bands(find, side):
    """An even ball's layers, by closed form: the light of each is its area, whatever the pixels in a voxel."""
    cameras, middle, radius = arc(3), np.array([0.0, 0.0, 1.0]), 0.25
    masks, lengths = ball(cameras, middle, radius)
    voxels = carve(cameras, masks[None], side)
    found = np.bincount(voxels.index[:, 2], find(voxels, lengths, masks))
    height = voxels.first_center[2] + np.arange(len(found)) * voxels.voxel_size - middle[2]
    true = np.maximum(radius**2 - height**2, 0)
    well_inside = np.abs(height) < 0.7 * radius
    ratio = found[well_inside] / true[well_inside]
    assert np.ptp(ratio) / ratio.mean() < 0.16, ratio / ratio.mean()


def test_a_hollow_flame_is_found_hollow():
    """A shell of light between two balls, by exact path lengths: its core is dark, which a round start fills."""
    cameras, middle, outer, inner = arc(3), np.array([0.05, -0.1, 1.0]), 0.25, 0.18
    masks, lengths = ball(cameras, middle, outer)
    lengths = lengths - ball(cameras, middle, inner)[1]
    voxels = carve(cameras, masks[None], 40)
    away = np.linalg.norm(voxels.center - middle, axis=1)
    true = ((away < outer) & (away > inner)).astype(float)
    core = away < inner - voxels.voxel_size

    def judge(find):
        found = find(voxels, lengths, masks)
        found /= found.sum()
        return np.linalg.norm(found - true / true.sum()) / np.linalg.norm(true / true.sum()), found[core].sum()

    (off, filled), (near, hollow) = judge(find_emission), judge(find_turned)
    assert near < 0.9 * off and hollow < 0.7 * filled, (off, near, filled, hollow)


def test_the_mean_all_around_is_of_each_flame_alone():
    """Two columns a metre apart, one of them lit on one side only: its light goes all around it, none to the other."""
    cameras, masks, _, middles, radius = two_balls(3)
    voxels = carve(cameras, masks[None], 40)
    away = np.linalg.norm(voxels.center[:, None] - middles, axis=-1)
    hull = (away < radius).any(1)
    light = hull * np.where((away[:, 0] < radius) & (voxels.center[:, 1] > middles[0, 1]), 1.0, 0.5)
    turned = np.zeros(len(hull))
    turned[hull] = turn_around(voxels.only(hull), light[hull])
    assert turned.sum() == pytest.approx(light.sum(), rel=0.05)
    for near in away.T < radius:
        assert turned[near].sum() == pytest.approx(light[near].sum(), rel=0.05)
    front, back = ((away[:, 0] < radius) & (sign * (voxels.center[:, 1] - middles[0, 1]) > 0) for sign in (1, -1))
    assert turned[front].mean() / turned[back].mean() < 1.25, "2 before"


def test_light_smeared_along_the_rays_comes_back_less_deep():
    """An ellipsoid three times as deep as wide, by closed form: its views say how wide it is, a mean over rings does
    not. Cameras all around know how deep it is, and nothing is taken from what they say."""
    cameras, middle, radius = arc(3), np.array([0.05, -0.1, 1.0]), 0.12
    masks, _ = ball(cameras, middle, 3 * radius)
    voxels = carve(cameras, masks[None], 72)
    offset = voxels.center - middle
    along = offset @ cameras[1].world_to_camera[2, :3]
    away2 = ((offset**2).sum(1) - along**2) / radius**2 + (along / (3 * radius)) ** 2
    light = np.where(away2 < 1, 1.0, 0.0)
    quarter = voxels.jacobian[1] @ np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    everywhere = replace(voxels, jacobian=np.stack([quarter, voxels.jacobian[1]]))
    mean = turn_around(everywhere, light)
    assert np.divide(*depth_and_width(voxels, mean, cameras[1], middle)) == pytest.approx(1, rel=0.02)
    depth, width = depth_and_width(voxels, turn_around(voxels, light), cameras[1], middle)
    assert depth < 0.8 * width, "its width is for the next iteration, which meets the views"


def test_a_flame_that_is_seen_to_be_deep_stays_deep():
    """An ellipsoid twice as deep as wide, path lengths by closed form: views 35 degrees apart see how deep it is."""
    middle, cameras = np.array([0.05, -0.1, 1.0]), []
    for k, angle in enumerate(np.deg2rad([-35, 0, 35])):
        cameras.append(look_at(f"cam_{k}", middle + 3 * np.array([np.sin(angle), -np.cos(angle), 0]), middle))
    across, along = 0.12, 0.24
    forward = cameras[1].world_to_camera[2, :3]
    to_ball = np.eye(3) / across + np.outer(forward, forward) * (1 / along - 1 / across)
    lengths = []
    for camera in cameras:
        rows, columns = np.mgrid[: camera.height, : camera.width] + 0.5
        pixels = np.stack([columns, rows, np.ones_like(rows)], -1)
        rays = pixels @ np.linalg.inv(camera.K).T @ camera.world_to_camera[:3, :3]
        start = to_ball @ (camera.position - middle)
        turned = rays / np.linalg.norm(rays, axis=-1, keepdims=True) @ to_ball
        square, half = (turned**2).sum(-1), turned @ start
        lengths.append(2 * np.sqrt(np.maximum(half**2 - square * (start @ start - 1), 0)) / square)
    lengths = np.stack(lengths)
    voxels = carve(cameras, (lengths > 0)[None], 60)
    emission = find_turned(voxels, lengths, lengths > 0)
    depth, width = depth_and_width(voxels, emission, cameras[1], middle)
    assert 1.6 < depth / width < 2.1


def pooled_views(voxels, pictures):
    everywhere = np.ones(len(voxels.center), bool)
    return [_pool_view(voxels, c, picture, everywhere) for c, picture in enumerate(pictures)]


def test_dim_tails_along_the_rays_are_cut_and_balls_are_kept():
    """A ball whose middle is smeared along its ray, at a twentieth of its light; and two balls behind each other."""
    cameras, middle = arc(3), np.array([0.05, -0.1, 1.0])
    masks, lengths = ball(cameras, middle, 0.6)
    voxels = carve(cameras, masks[None], 96)
    views = pooled_views(voxels, lengths)
    offset = voxels.center - middle
    along = offset @ cameras[1].world_to_camera[2, :3]
    beside = np.sqrt(np.maximum((offset**2).sum(1) - along**2, 0))
    near, far = ((beside**2 + (along - depth) ** 2) < 0.15**2 for depth in (0.0, 0.4))
    tail = (beside < 0.04) & ~near & (np.abs(along) > 0.4)
    assert tail.sum() > 20 and near.sum() > 1000, "otherwise the test says nothing"
    smeared = near + 0.05 * (beside < 0.04)
    cut = cut_tails(voxels, smeared, views[1:2])
    assert not cut[tail].any() and (cut[near] == smeared[near]).all()
    both = (near | far) * 1.0
    assert (cut_tails(voxels, both, views) == both).all(), "far apart along the rays, and as bright"
    assert (cut_tails(voxels, 0 * both, views) == 0).all(), "no light, no brightest part of it"


@pytest.mark.parametrize("dim", [0.15, 0.3, 1.0])
def test_a_dim_flame_behind_a_bright_one_is_kept(dim):
    """Two balls behind each other, as the middle camera sees them; those beside it see both. By exact path lengths."""
    middle, gap, radius = np.array([0.0, 0.0, 1.0]), 0.6, 0.12
    cameras = []
    for k, angle in enumerate(np.deg2rad([-35, 0, 35])):
        cameras.append(look_at(f"cam_{k}", middle + 3 * np.array([np.sin(angle), -np.cos(angle), 0]), middle))
    ahead = cameras[1].world_to_camera[2, :3]
    places = middle - gap / 2 * ahead, middle + gap / 2 * ahead
    lengths = sum(light * ball(cameras, place, radius)[1] for light, place in zip((1, dim), places, strict=True))
    voxels = carve(cameras, (lengths > 0)[None], 72)
    uncut, cut = (find_emission(voxels, lengths, lengths > 0, turns=TURNS, tail=tail) for tail in (0.0, TAIL))
    assert cut.sum() == pytest.approx(uncut.sum(), rel=1e-3), "no light is lost"
    far = np.linalg.norm(voxels.center - places[1], axis=1) < radius + voxels.voxel_size
    assert cut[far].sum() / cut.sum() > 0.75 * dim / (1 + dim)


def test_light_in_a_single_voxel_is_turned_without_a_hole():
    """The bad point of the quotient: heights without any light, and a mean that is 0 beside them."""
    cameras = arc(3)
    voxels = carve(cameras, ball(cameras)[0][None], 12)
    light = np.zeros(len(voxels.center))
    light[len(light) // 2] = 1.0
    turned = turn_around(voxels, light)
    assert np.isfinite(turned).all() and (turned >= 0).all() and turned.any()


def test_turned_light_is_in_the_views_own_unit():
    """Twice the light is twice the emission, and a frame's emission is that of its pictures, as plain EM has it."""
    cameras, masks, lengths, _, _ = two_balls(3)
    voxels = carve(cameras, masks[None], 24)
    once, twice = (find_turned(voxels, n * lengths, masks) for n in (1, 2))
    assert twice == pytest.approx(2 * once, rel=1e-9)
    assert once.sum() == pytest.approx(find_emission(voxels, lengths, masks).sum(), rel=0.05)


def test_turned_light_of_nothing_is_nothing():
    cameras = arc(2)
    masks, lengths = ball(cameras)
    voxels = carve(cameras, masks[None], 10)
    assert (find_turned(voxels, lengths, masks & False) == 0).all()
    assert (find_turned(voxels, lengths * 0, masks) == 0).all()
    for times in (1e-310, 1e-30, 1e30):
        assert np.isfinite(find_turned(voxels, lengths * times, masks)).all()
