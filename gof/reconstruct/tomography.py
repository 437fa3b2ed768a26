"""How brightly each voxel of a flame shines: tomography of one frame from a few views."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from gof.reconstruct.voxels import LAYERS_POOLED, FlameVoxels

SMOOTH = 0.6  # voxels, std-dev by which a compact flame is smoothed between two iterations
POWER = 1.15  # that draws its light together in each; 1 leaves the hull's streaks along the rays
WIDER = 1.3  # times a round flame's width: so wide it starts, as it is drawn together
FAINTEST = 40.0  # squared distances in std-devs beyond this are all the same; nothing in the hull is ruled out


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

    Of all that agree with a few views, plain EM keeps what its start has, streaks along the rays, and fits noise by
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
    """Return (V,) in (0, 1]: a flame with a round Gaussian cross-section in every layer, as wide as the views say.

    Emission that reproduces the views has the right mean and variance across every viewing direction, whatever its
    shape along it; the mean over the views of those variances is the round flame's, and its middle is the emission's:
    views from nearly one side hardly say how far away that is, and the hull is all that bounds it. Layers lie along
    the rays (`_upright`): in level ones, light that is drawn out along steep rays would be at wrong heights. A single
    view does not say where its middle is along the rays: as near to the world's axis as can be, in level layers. All 1
    where fewer than two of several views are from the side.
    """
    rays = np.cross(voxels.jacobian[:, :, 0], voxels.jacobian[:, :, 1])
    rays = np.where(np.isfinite(rays), rays, 0).sum(1)  # NaN: a voxel beside or behind the camera
    length = np.linalg.norm(rays, axis=1)
    rays = rays[length > 0] / length[length > 0, None]
    if not len(rays):
        return np.ones(len(emission))
    up = _upright(rays) if len(rays) > 1 else np.array([0.0, 0.0, 1.0])
    across = np.cross(up, rays)
    side = np.linalg.norm(across, axis=-1) > 0.1
    if side.sum() < min(2, len(side)):
        return np.ones(len(emission))
    from scipy.ndimage import gaussian_filter1d  # here: it takes long to load

    across = across[side] / np.linalg.norm(across[side], axis=-1, keepdims=True)
    height = voxels.center @ up
    layer = np.round((height - height.min()) / voxels.voxel_size).astype(np.int64)

    def per_layer(values: np.ndarray) -> np.ndarray:
        return gaussian_filter1d(np.bincount(layer, emission * values), LAYERS_POOLED, mode="nearest")

    weight = np.maximum(per_layer(np.ones(len(emission))), np.finfo(np.float32).tiny)
    place = voxels.center @ across.T
    mean = np.stack([per_layer(x) for x in place.T]) / weight
    variance = np.stack([per_layer(x**2) for x in place.T]) / weight - mean**2
    one = len(across) == 1
    middle = mean.T @ across if one else np.stack([per_layer(x) for x in voxels.center.T], -1) / weight[:, None]
    width2 = np.maximum(variance.mean(0), voxels.voxel_size**2)
    away = voxels.center - middle[layer]
    distance2 = (away**2).sum(-1) - (away @ up) ** 2
    return np.exp(-0.5 * np.minimum(distance2 / width2[layer], FAINTEST))


def _upright(rays: np.ndarray) -> np.ndarray:
    """Return (3,), +z turned in the mean ray's upright plane until it is square to the rays (C, 3), of length 1.

    The less, the further around the flame the cameras stand; not at all where they stand all around it.
    """
    level = rays[:, :2] / np.maximum(np.linalg.norm(rays[:, :2], axis=1, keepdims=True), np.finfo(float).tiny)
    alike = np.linalg.norm(level.mean(0))  # 1 where all look the same way, 0 from all around
    climb = np.arcsin(np.clip(rays[:, 2], -1, 1)).mean() * alike
    forward = level.mean(0) / max(alike, np.finfo(float).tiny)
    return np.array([*(-np.sin(climb) * forward), np.cos(climb)])


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
