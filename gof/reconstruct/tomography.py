"""How brightly each voxel of a flame shines: tomography of one frame from a few views."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import csc_matrix, csr_matrix

from gof.reconstruct.voxels import FlameVoxels, share_among_pixels

UP = np.array([0.0, 0.0, 1.0])
TURNS = 3  # times that a flame is found again from what it is on the average all around its axis
ITERATIONS = 12
POOLED = 1.5  # layers, std-dev over which its middle is found
BETWEEN = (0.7, 0.5)  # layers and rings, std-dev over which their means are smoothed: a grid's rings are jagged
COARSE = 4.0  # voxels, std-dev: finer than that, a flame's sides have licks of their own
TAIL, AROUND = 0.3, 8.0  # of the brightest along a ray, of light over so many voxels around (std-dev): less is smeared
DIMMEST, FACTORS = 1e-3, (0.05, 4.0)  # of the brightest, below which a mean tells nothing; by which it may be changed
NEAR = 3.0  # voxels, std-dev: light so near to each other has its middle at the same depth
OUTLINE = 0.15  # of the light around it: what is darker is outside a lick's outline
FAINTEST = 40.0  # squared distances in std-devs beyond this are all the same; nothing in the hull is ruled out
DARK = 1e-300  # light, below which a pixel explains nothing: what divides by less may overflow


def tomography(voxels: FlameVoxels, intensity: np.ndarray, mask: np.ndarray, rounded: bool = True) -> np.ndarray:
    """Return how brightly each voxel of one frame shines, relative to the others: see `find_emission`.

    Returns:
        (V,) float64 emission >= 0, mean 1 over the voxels of the frame's hull, 0 outside it; all 0 for an empty mask.
    """
    emission = find_emission(voxels, intensity, mask, rounded)
    total = emission.sum()
    return emission * (np.count_nonzero(emission) / total) if total > 0 else emission


def find_emission(
    voxels: FlameVoxels,
    intensity: np.ndarray,
    mask: np.ndarray,
    rounded: bool = True,
    turns: int = 0,
    iterations: int = ITERATIONS,
    tail: float = TAIL,
) -> np.ndarray:
    """Emission per voxel of one frame by multiplicative expectation maximisation (Shepp & Vardi 1982).

    Few views leave the shape along the rays open; EM fills it with the product closest to its start that the views
    agree on, and is never negative. From an even start that is the whole hull, with its corners that no camera looks
    past. A flame is about as deep as it is wide, so it is done again from a round one (`round_flame`; +z is up), and
    from what the flame is on the average all around its axis (`turn_around`): whether it is filled or hollow, and how
    it fades outward, its views say for the sides that they do not see. Each bright pixel then still shines all along
    its ray: so the rays' dim tails are cut off (`cut_tails`), and their light goes to where the flame is. Figures of
    each choice: `python -m gof_benchmark.evidence.tomography`.

    Args:
        intensity: (C, H, W) linear light >= 0.   mask: (C, H, W) bool.   rounded: do it again from a round flame.
        turns: so often from the flame all around, then without tails.   iterations: of each.   tail: see `cut_tails`.
    Returns:
        (V,) float64 >= 0, in one unit for all frames of a clip; 0 outside the frame's hull; all 0 for an empty mask.
    """
    hit = voxels.sample(mask.astype(np.int8), outside=-1)
    hull = (hit != 0).all(0) & (hit == 1).any(0)
    found = np.zeros(len(hull))
    if not hull.any():
        return found
    part = voxels.only(hull)  # of a clip's voxels, most are dark in a frame
    views = [_pool_view(part, c, picture, hit[c, hull] == 1) for c, picture in enumerate(intensity)]
    emission = _maximise(np.ones(len(part.center)), views, iterations)
    if rounded and emission.any():
        emission = _maximise(round_flame(part, emission), views, iterations)
    if turns and emission.any():
        for _ in range(turns):
            emission = _maximise(turn_around(part, emission), views, iterations)
        emission = _maximise(cut_tails(part, emission, views, tail), views, iterations)
    found[hull] = emission
    return found


def turn_around(voxels: FlameVoxels, emission: np.ndarray) -> np.ndarray:
    """Return (V,) the mean emission of each ring around a flame's middle, drawn to be as deep as wide (+z is up).

    Flames that burn side by side have a middle each; that of a flame may wander from height to height. Cameras see
    past most of a wide ring, which is dark there, and so likely is the rest of it, as far as flames are round. So this
    is the geometric mean of two means: over the ring's part in the hull, and over all of it. Where all cameras look
    from one side, a flame's outline as they see it, coarsely, is that of the other side, too (`_match_front`).

    Args:
        emission: (V,) >= 0, some of it > 0.
    """
    from scipy.ndimage import gaussian_filter, gaussian_filter1d  # here: it takes long to load

    from gof.reconstruct.spots import part_flames

    flame, layer = part_flames(voxels, emission, UP), voxels.index[:, 2]
    size = flame.max() + 1, layer.max() + 1, int(np.hypot(*voxels.resolution[:2])) + 2

    def pool(values: np.ndarray) -> np.ndarray:
        sums = np.bincount(flame * size[1] + layer, values, size[0] * size[1]).reshape(size[:2])
        return gaussian_filter1d(sums, POOLED, axis=1, mode="constant")

    light = np.maximum(pool(emission), np.finfo(np.float64).tiny)
    middle = np.stack([pool(emission * place) / light for place in voxels.center[:, :2].T], -1)
    offset = (voxels.center[:, :2] - middle[flame, layer]) / voxels.voxel_size
    ring = np.minimum(np.rint(np.linalg.norm(offset, axis=1)).astype(np.int64), size[2] - 1)
    place = np.ravel_multi_index((flame, layer, ring), size)

    def smoothed(sums: np.ndarray) -> np.ndarray:
        return gaussian_filter(sums.reshape(size), (0, *BETWEEN)).ravel()[place]

    both = (np.bincount(place, values, np.prod(size)) for values in (emission, np.ones(len(place))))
    shone, within = map(smoothed, both)
    mean = shone / within
    if len(voxels.forward) > 1:  # a single view's hull is no deeper than wide (`carve`)
        radius = np.arange(size[2])
        whole = 2 * np.pi * np.where(radius > 0, radius, 1 / 8)  # voxels of a ring; the innermost has a diameter of one
        mean *= np.sqrt(within / smoothed(np.broadcast_to(whole, size)))
    ahead = voxels.common_ray
    if ahead is None:
        return mean
    level = ahead[:2] / np.hypot(*ahead[:2])
    return mean * _match_front(flame, layer, offset @ [-level[1], level[0]], offset @ level, emission, mean)


def _match_front(
    flame: np.ndarray, layer: np.ndarray, across: np.ndarray, along: np.ndarray, emission: np.ndarray, mean: np.ndarray
) -> np.ndarray:
    """Return (V,) factors that draw a mean all around to what its flame is from the front, coarsely and mirrored.

    They compare the front with the mean as it is from the front, where the hull cuts it off, and from the side, where
    its tail is: the geometric mean of both. Figures of each: notebook/reconstruction.md.

    Args:
        flame, layer: (V,) int.   across, along: (V,) voxels from the flame's middle, across and along the rays.
        emission: (V,) >= 0, as cameras see it.   mean: (V,) >= 0, of it all around.
    """
    from scipy.ndimage import gaussian_filter  # here: it takes long to load

    half = int(np.ceil(max(np.abs(across).max(), np.abs(along).max()))) + 1
    shape = flame.max() + 1, layer.max() + 1, 2 * half + 1
    from_front, from_side = (
        np.ravel_multi_index((flame, layer, np.rint(distance).astype(np.int64) + half), shape)
        for distance in (across, along)
    )

    def look(column: np.ndarray, values: np.ndarray) -> np.ndarray:
        profile = np.bincount(column, values, np.prod(shape)).reshape(shape)
        return gaussian_filter(profile + profile[..., ::-1], (0, COARSE, COARSE))

    even = np.sqrt(look(from_front, mean) * look(from_side, mean))
    tells = even > DIMMEST * even.max()
    factor = np.where(tells, look(from_front, emission) / np.where(tells, even, 1), 0)
    return np.clip(factor, *FACTORS).ravel()[from_side]


def round_flame(voxels: FlameVoxels, emission: np.ndarray) -> np.ndarray:
    """Return (V,) in (0, 1]: light is near its middle along the rays, no further away than it is wide there.

    Cameras on one side leave open how far light reaches along their common direction. Each lick and each sheet
    is about as deep as the disc that fits into its outline is wide (its std-dev: half the disc's radius), and where its
    middle is, emission that reproduces the views says, as the mean along the rays over a few voxels around. A single
    view does not say where that is: as near to the world's axis as can be. All 1 where the cameras stand all around, or
    look down steeply: a flame may be higher than wide.

    Args:
        emission: (V,) >= 0, that reproduces the views.
    """
    ahead = voxels.common_ray
    if ahead is None:
        return np.ones(len(emission))
    from scipy.ndimage import gaussian_filter  # here: it takes long to load

    right = np.cross(ahead, UP) / np.hypot(*ahead[:2])
    place = voxels.center @ np.stack([right, np.cross(right, ahead)], -1) / voxels.voxel_size
    across, up = np.round(place - place.min(0)).astype(np.int64).T
    shape = across.max() + 1, up.max() + 1
    column = across * shape[1] + up
    depth = voxels.center @ ahead

    def look(values: np.ndarray) -> np.ndarray:
        return np.bincount(column, values, shape[0] * shape[1]).reshape(shape)

    light = look(emission)
    around = np.maximum(gaussian_filter(light, NEAR, mode="constant"), np.finfo(np.float32).tiny)
    middle = (gaussian_filter(look(emission * depth), NEAR, mode="constant") / around).ravel()[column]
    away = depth - middle if len(voxels.forward) > 1 else voxels.center[:, :2] @ ahead[:2] / np.hypot(*ahead[:2])
    width = gaussian_filter(_inner_radius(light > OUTLINE * gaussian_filter(light, 2 * NEAR, mode="constant")), 1.0) / 2
    away2 = (away / (np.maximum(width, 1) * voxels.voxel_size).ravel()[column]) ** 2
    return np.exp(-0.5 * np.minimum(away2, FAINTEST))


def cut_tails(voxels: FlameVoxels, emission: np.ndarray, views: list[_PooledView], tail: float = TAIL) -> np.ndarray:
    """Return the emission (V,) without the dim tails of rays, 0 there.

    A bright pixel's light is smeared along its ray, in front of the flame and behind it, where hardly any other light
    is. Coarsely, over a few voxels around, that is a tail: in every view that has it, below a part `tail` of the
    brightest along the ray. A dim flame behind a bright one stays, where any view looks past the bright one.
    """
    from scipy.ndimage import gaussian_filter  # here: it takes long to load

    cells = tuple((voxels.index - voxels.index.min(0)).T)
    dense = np.zeros([cell.max() + 1 for cell in cells], np.float32)
    dense[cells] = emission / max(emission.max(), DARK)
    coarse = gaussian_filter(dense, AROUND, mode="constant")[cells]
    bright = np.zeros(len(coarse), bool)
    for share, back, weight, _ in views:
        (seen,) = np.nonzero(np.diff(share.indptr))
        brightest = np.zeros(share.shape[0])
        brightest[seen] = np.maximum.reduceat(coarse[share.indices], share.indptr[seen]) if len(seen) else 0
        bright |= weight * coarse > tail * (back @ brightest)
    return np.where(bright, emission, 0)


def _inner_radius(shape: np.ndarray) -> np.ndarray:
    """(H, W) radius, px, of the largest disc within a shape (H, W) bool that holds each of its pixels; 0 outside."""
    import cv2  # here: it takes long to load

    padded = np.pad(shape, 1).astype(np.uint8)
    inside = cv2.distanceTransform(padded, cv2.DIST_L2, 5)
    found = np.zeros_like(inside)
    for radius in range(1, int(np.ceil(inside.max())) + 1):
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius - 1, 2 * radius - 1))
        found[cv2.dilate((inside >= radius - 0.5).astype(np.uint8), disc) > 0] = radius - 0.5
    return found[1:-1, 1:-1]


class _PooledView(NamedTuple):
    share: csr_matrix  # (P, V): how much of each voxel every pixel has
    back: csc_matrix  # (V, P) the same, from the voxels
    weight: np.ndarray  # (V,) how much of each all pixels have
    light: np.ndarray  # (P,) of every pixel


def _pool_view(voxels: FlameVoxels, c: int, picture: np.ndarray, seen: np.ndarray) -> _PooledView:
    """Return camera c's view of one frame, in pixels of about a voxel's size.

    Each voxel is shared by the four pixels around it. Were it all in the nearest one, some pixels would have two layers
    of voxels and others one or none, and the flame dark bands.

    Args:
        picture: (H, W).   seen: (V,) bool, voxels with flame behind them.
    """
    import cv2  # here: it takes long to load

    per_metre = np.abs(voxels.jacobian[c, seen]).max((-1, -2))
    pixels_per_voxel = voxels.voxel_size * float(np.median(per_metre)) if len(per_metre) else 1.0
    size = np.maximum(np.round(np.array(picture.shape[::-1]) / pixels_per_voxel), 1).astype(int)
    pooled = cv2.resize(picture.astype(np.float64), size.tolist(), interpolation=cv2.INTER_AREA)
    place = np.where(seen[:, None], voxels.pixel[c] * (size / picture.shape[::-1]), np.nan)
    share = share_among_pixels(place, *size)
    return _PooledView(share, share.T, share.sum(axis=0).A1, pooled.ravel())


def _maximise(emission: np.ndarray, views: list[_PooledView], iterations: int) -> np.ndarray:
    count = np.maximum(sum(view.weight for view in views), np.finfo(np.float64).tiny)
    for _ in range(iterations):
        ratio = np.zeros_like(emission)
        for view in views:
            projected = view.share @ emission
            # A pixel without any shining voxel explains nothing and asks for nothing.
            ratio += view.back @ np.where(projected > DARK, view.light / np.maximum(projected, DARK), 0)
        emission = emission * ratio / count
    return emission
