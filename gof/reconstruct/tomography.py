"""How brightly each voxel of a flame shines: tomography of one frame from a few views."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from gof.reconstruct.voxels import FlameVoxels

SMOOTH = 0.6  # voxels, std-dev by which a compact flame is smoothed between two iterations
POWER = 1.15  # that draws its light together in each; 1 leaves the hull's streaks along the rays
WIDER = 2.0  # times a round flame's depth: so deep it starts, as it is drawn together
NEAR = 3.0  # voxels, std-dev: light so near to each other has its middle at the same depth
OUTLINE = 0.15  # of the light around it: what is darker is outside a lick's outline
FAINTEST = 40.0  # squared distances in std-devs beyond this are all the same; nothing in the hull is ruled out
ONE_SIDE = 0.2  # by which the rays' first principal value exceeds the second: cameras less far around see all sides
STEEP = np.sin(np.deg2rad(60))  # of the cameras' common direction


def tomography(
    voxels: FlameVoxels, intensity: np.ndarray, mask: np.ndarray, rounded: bool = True, iterations: int = 12
) -> np.ndarray:
    """Return how brightly each voxel of one frame shines, relative to the others: see `find_emission`.

    Returns:
        (V,) float64 emission >= 0, mean 1 over the voxels of the frame's hull, 0 outside it; all 0 for an empty mask.
    """
    emission = find_emission(voxels, intensity, mask, rounded, iterations)
    total = emission.sum()
    return emission * (np.count_nonzero(emission) / total) if total > 0 else emission


def find_emission(
    voxels: FlameVoxels, intensity: np.ndarray, mask: np.ndarray, rounded: bool = True, iterations: int = 12
) -> np.ndarray:
    """Emission per voxel of one frame by multiplicative expectation maximisation (Shepp & Vardi 1982).

    Few views leave the shape along the rays open; EM fills it with the product closest to its start that the views
    agree on, and is never negative. From an even start that is the whole hull, with its corners that no camera looks
    past. A flame is about as deep as it is wide, so it is done again from a round one (`round_flame`; +z is up). Pixels
    are pooled to about the voxel's own size, so every voxel meets one cell per view.

    Args:
        intensity: (C, H, W) linear light >= 0.   mask: (C, H, W) bool.   rounded: do it again from a round flame.
    Returns:
        (V,) float64 >= 0, in one unit for all frames of a clip; 0 outside the frame's hull; all 0 for an empty mask.
    """
    hull, views = _hull_and_views(voxels, intensity, mask)
    emission = _maximise(hull.astype(np.float64), views, iterations)
    if rounded and emission.any():
        emission = _maximise(hull * round_flame(voxels, emission), views, iterations)
    return emission


def find_compact_emission(
    voxels: FlameVoxels,
    intensity: np.ndarray,
    mask: np.ndarray,
    smooth: float = SMOOTH,
    power: float = POWER,
    wider: float = WIDER,
    iterations: int = 12,
) -> np.ndarray:
    """Emission per voxel of one frame, smooth and no longer along the rays than the views ask for.

    Many lights agree with a few views. Plain EM keeps the streaks of its start along the rays, and fits noise by
    thin ones. So light is smoothed between its iterations (Silverman, Jones, Wilson & Nychka 1990), and raised to a
    power a little above 1, which draws it together: where views from several sides support each other it grows, and
    what lies along one ray alone dies out. Figures of each choice: `python -m gof_benchmark.evidence.tomography`.

    Args and returns: as `find_emission`; smooth, power, wider: see above.
    """
    from scipy.ndimage import gaussian_filter  # here: it takes long to load

    hull, views = _hull_and_views(voxels, intensity, mask)
    emission = _maximise(hull.astype(np.float64), views, iterations)
    if not emission.any():
        return emission
    emission = hull * round_flame(voxels, emission) ** (1 / wider**2)
    cells, grid = tuple(voxels.index.T), np.zeros(voxels.resolution)
    for _ in range(iterations):
        grid[cells] = _maximise(emission, views, 1) ** power
        emission = hull * gaussian_filter(grid, smooth, mode="constant")[cells]
    return _in_unit(emission, views)


def _hull_and_views(
    voxels: FlameVoxels, intensity: np.ndarray, mask: np.ndarray
) -> tuple[np.ndarray, list[_PooledView]]:
    """(V,) bool, voxels that the frame's masks leave standing, and the frame's pooled views."""
    hit = voxels.sample(mask.astype(np.int8), outside=-1)
    return (hit != 0).all(0) & (hit == 1).any(0), _pooled_views(voxels, intensity, hit == 1)


def _in_unit(emission: np.ndarray, views: list[_PooledView]) -> np.ndarray:
    """Return the same emission, as bright in all views together as these are where it may be."""
    seen = sum(view.light[np.unique(view.cell)].sum() for view in views)
    shown = sum(emission[view.seen].sum() for view in views)
    return emission * (seen / shown) if shown > 0 else emission


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
    rays = np.cross(voxels.jacobian[:, :, 0], voxels.jacobian[:, :, 1])
    rays = np.where(np.isfinite(rays), rays, 0).sum(1)  # NaN: a voxel beside or behind the camera
    length = np.linalg.norm(rays, axis=1)
    rays = rays[length > 0] / length[length > 0, None]
    common, axes = np.linalg.eigh(rays.T @ rays / max(len(rays), 1))
    ahead = axes[:, 2]
    if common[2] - common[1] < ONE_SIDE or abs(ahead[2]) > STEEP:
        return np.ones(len(emission))
    from scipy.ndimage import gaussian_filter  # here: it takes long to load

    right = np.cross(ahead, [0.0, 0.0, 1.0]) / np.hypot(*ahead[:2])
    place = voxels.center @ np.stack([right, np.cross(right, ahead)], -1) / voxels.voxel_size
    across, up = np.round(place - place.min(0)).astype(np.int64).T
    shape = across.max() + 1, up.max() + 1
    column = across * shape[1] + up
    depth = voxels.center @ ahead

    def look(values: np.ndarray) -> np.ndarray:
        return np.bincount(column, values, shape[0] * shape[1]).reshape(shape)

    light = look(emission)
    around = np.maximum(gaussian_filter(light, NEAR), np.finfo(np.float32).tiny)
    middle = (gaussian_filter(look(emission * depth), NEAR) / around).ravel()[column]
    away = depth - middle if len(rays) > 1 else voxels.center[:, :2] @ ahead[:2] / np.hypot(*ahead[:2])
    width = gaussian_filter(_inner_radius(light > OUTLINE * gaussian_filter(light, 2 * NEAR)), 1.0) / 2
    away2 = (away / (np.maximum(width, 1) * voxels.voxel_size).ravel()[column]) ** 2
    return np.exp(-0.5 * np.minimum(away2, FAINTEST))


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
    seen: np.ndarray  # (V,) bool, voxels with flame behind them
    cell: np.ndarray  # the cell that each of those falls into
    light: np.ndarray  # of every cell


def _pooled_views(voxels: FlameVoxels, intensity: np.ndarray, seen: np.ndarray) -> list[_PooledView]:
    """The views of one frame, their pixels pooled to cells of about a voxel's size. seen: (C, V) bool."""
    pixels_per_m = float(np.nanmedian(np.abs(voxels.jacobian).max((-1, -2))))
    footprint = max(1, int(np.ceil(voxels.voxel_size * pixels_per_m)))
    cells_per_row = intensity.shape[2] // footprint + 1
    rows, columns = (np.arange(n) // footprint for n in intensity.shape[1:])
    pixel_cell = (rows[:, None] * cells_per_row + columns[None]).ravel()
    pixels = np.maximum(np.bincount(pixel_cell), 1)
    views = []
    for c in range(len(intensity)):
        column, row = (voxels.pixel[c][seen[c]] // footprint).astype(np.int64).T
        light = np.bincount(pixel_cell, intensity[c].ravel()) / pixels
        views.append(_PooledView(seen[c], row * cells_per_row + column, light))
    return views


def _maximise(emission: np.ndarray, views: list[_PooledView], iterations: int) -> np.ndarray:
    for _ in range(iterations):
        ratio = np.zeros_like(emission)
        count = np.zeros_like(emission)
        for view in views:
            projected = np.bincount(view.cell, emission[view.seen], len(view.light))
            # A cell without any standing voxel explains nothing and asks for nothing.
            ratio[view.seen] += (view.light / np.where(projected > 0, projected, np.inf))[view.cell]
            count[view.seen] += 1
        emission = emission * ratio / np.maximum(count, 1)
    return emission
