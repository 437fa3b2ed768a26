"""The voxel grid a flame lives in: its box from the masks, its hull, and its emission by tomography."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d

from gof.cameras import Camera
from gof.errors import DataFormatError

LAYERS_POOLED = 2.0  # std-dev in voxels: a flame's middle and width change slowly with height
FAINTEST = 40.0  # squared distances in std-devs beyond this are all the same; nothing in the hull is ruled out


@dataclass
class FlameVoxels:
    """Voxels that at least one frame's masks leave standing.

    Attributes:
        center: (V, 3) world m.        voxel_size: m.
        index: (V, 3) int grid index;  resolution: (3,) int grid size.
        pixel: (C, V, 2) continuous image position per camera (NaN behind a camera).
        jacobian: (C, V, 2, 3) d(pixel)/d(world), px/m.
    """

    center: np.ndarray
    voxel_size: float
    index: np.ndarray
    resolution: np.ndarray
    pixel: np.ndarray
    jacobian: np.ndarray

    def sample(self, images: np.ndarray, outside=0) -> np.ndarray:
        """Nearest-pixel values of images (C, H, W, ...) at every voxel: (C, V, ...); `outside` where a voxel has no pixel."""
        height, width = images.shape[1:3]
        result = np.full((len(images), len(self.center), *images.shape[3:]), outside, images.dtype)
        for c, image in enumerate(images):
            with np.errstate(invalid="ignore"):
                inside = ((self.pixel[c] >= 0) & (self.pixel[c] < (width, height))).all(-1)
            column, row = self.pixel[c][inside].astype(np.int64).T
            result[c, inside] = image[row, column]
        return result


def flame_box(cameras: list[Camera], masks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A world box (min (3,), max (3,)) that surely holds the flame.

    The rays through the masks' centroids meet (least squares) at the flame; the masks' extent at that depth gives its size.

    Args:
        cameras: at least 2.
        masks: (C, H, W) bool, union over time.
    Raises:
        DataFormatError: fewer than 2 cameras see flame, or their rays are parallel (condition number > 1e8).
    """
    seen = [c for c in range(len(cameras)) if masks[c].any()]
    if len(seen) < 2:
        raise DataFormatError(f"flame is visible in {len(seen)} cameras; at least 2 are needed to place it in space")
    A, b = np.zeros((3, 3)), np.zeros(3)
    extent = {}
    for c in seen:
        rows, columns = np.nonzero(masks[c])
        corner_min, corner_max = np.array([columns.min(), rows.min()]), np.array([columns.max(), rows.max()]) + 1
        extent[c] = np.abs(corner_max - corner_min)
        center = np.array([*(corner_min + corner_max) / 2, 1.0])
        R = cameras[c].world_to_camera[:3, :3]
        ray = R.T @ np.linalg.solve(cameras[c].K, center)
        ray /= np.linalg.norm(ray)
        projector = np.eye(3) - np.outer(ray, ray)
        A, b = A + projector, b + projector @ cameras[c].position
    if np.linalg.cond(A) > 1e8:
        raise DataFormatError("the cameras look at the flame along parallel rays; it cannot be placed in space")
    center = np.linalg.solve(A, b)
    size = 0.0
    for c in seen:
        depth = cameras[c].to_camera(center[None])[0, 2]
        if depth <= 0:
            raise DataFormatError(
                f"the flame would lie behind camera '{cameras[c].name}'; are the poses OpenCV world-to-camera?"
            )
        size = max(size, float((extent[c] / np.diag(cameras[c].K)[:2]).max()) * depth)
    return center - 0.75 * size, center + 0.75 * size


def carve(cameras: list[Camera], masks: np.ndarray, voxels_along_height: int, min_views: int = 2) -> FlameVoxels:
    """Voxels whose image lies in the union-over-time mask of every camera that has them in view, and of at least `min_views`.

    Args:
        cameras: C cameras.   masks: (F, C, H, W) bool.
        voxels_along_height: voxels along the longest side of the flame's own box (sets the voxel size).
    Raises:
        DataFormatError: see `flame_box`; or the hull is empty (masks or poses disagree).
    """
    union = masks.any(0)
    low, high = flame_box(cameras, union)
    for side in (48, None):  # first coarse, for the flame's own box, then at the asked size
        voxel = (high - low).max() / (side or voxels_along_height)
        resolution = np.maximum(np.ceil((high - low) / voxel - 1e-6).astype(int), 1)
        index = np.stack(np.meshgrid(*map(np.arange, resolution), indexing="ij"), -1).reshape(-1, 3)
        center = low + (index + 0.5) * voxel
        voxels = FlameVoxels(
            center, float(voxel), index, resolution, np.stack([cam.project(center)[0] for cam in cameras]), np.empty(0)
        )
        hit = voxels.sample(union.astype(np.int8), outside=-1)
        keep = ((hit == 1).sum(0) >= min_views) & (hit != 0).all(0)
        if not keep.any():
            raise DataFormatError(
                "no voxel lies in the flame masks of two cameras; check the masks and the camera poses"
            )
        low, high = center[keep].min(0) - voxel, center[keep].max(0) + voxel
    kept = center[keep]
    jacobian = np.stack([cam.projection_jacobian(kept) for cam in cameras])
    return FlameVoxels(kept, voxels.voxel_size, index[keep], resolution, voxels.pixel[:, keep], jacobian)


def tomography(
    voxels: FlameVoxels, intensity: np.ndarray, mask: np.ndarray, rounded: bool = True, iterations: int = 12
) -> np.ndarray:
    """Emission per voxel of one frame by multiplicative expectation maximisation (Shepp & Vardi 1982).

    Few views leave the shape along the rays open; EM fills it with the product closest to its start that the views agree on, and
    is never negative. From an even start that is the whole hull, with its corners that no camera looks past. A flame is about as
    deep as it is wide, so it is done again from a round one (`round_flame`; +z is up). Pixels are pooled to about the
    voxel's own size, so every voxel meets one cell per view.

    Args:
        intensity: (C, H, W) linear light >= 0.   mask: (C, H, W) bool.   rounded: do it again from a round flame.
    Returns:
        (V,) float64 emission >= 0, mean 1 over the voxels of the frame's hull, 0 outside it; all 0 for an empty mask.
    """
    hit = voxels.sample(mask.astype(np.int8), outside=-1)
    hull = (hit != 0).all(0) & (hit == 1).any(0)
    if not hull.any():
        return np.zeros(len(hull))
    views = _pooled_views(voxels, intensity, hit == 1)
    emission = _maximise(hull.astype(np.float64), views, iterations)
    if rounded and emission.any():
        emission = _maximise(hull * round_flame(voxels, emission), views, iterations)
    total = emission.sum()
    return emission * (np.count_nonzero(emission) / total) if total > 0 else np.zeros_like(emission)


def round_flame(voxels: FlameVoxels, emission: np.ndarray) -> np.ndarray:
    """(V,) in (0, 1]: a flame with a round Gaussian cross-section at every height, as wide as the views say it is.

    Emission that reproduces the views has the right mean and variance across every viewing direction, whatever its shape
    along it; the mean over the views of those variances is the round flame's. All 1 where fewer than two views are from the side.
    """
    layer, layers = voxels.index[:, 2], int(voxels.resolution[2])
    axis = np.cross(voxels.jacobian[:, :, 0], voxels.jacobian[:, :, 1]).mean(1)  # viewing directions, any length
    across = np.stack([axis[:, 1], -axis[:, 0]], -1)
    side = np.linalg.norm(across, axis=-1) > 0.1 * np.linalg.norm(axis, axis=-1)
    if side.sum() < 2:
        return np.ones(len(emission))
    across = across[side] / np.linalg.norm(across[side], axis=-1, keepdims=True)

    def per_layer(values: np.ndarray) -> np.ndarray:
        return gaussian_filter1d(np.bincount(layer, emission * values, layers), LAYERS_POOLED, mode="nearest")

    weight = np.maximum(per_layer(np.ones(len(emission))), np.finfo(np.float32).tiny)
    place = voxels.center[:, :2] @ across.T
    mean = np.stack([per_layer(x) for x in place.T]) / weight
    variance = np.stack([per_layer(x**2) for x in place.T]) / weight - mean**2
    middle = np.linalg.lstsq(across, mean, rcond=None)[0].T
    width2 = np.maximum(variance.mean(0), voxels.voxel_size**2)
    distance2 = ((voxels.center[:, :2] - middle[layer]) ** 2).sum(-1)
    return np.exp(-0.5 * np.minimum(distance2 / width2[layer], FAINTEST))


def _pooled_views(voxels: FlameVoxels, intensity: np.ndarray, seen: np.ndarray) -> list[tuple]:
    """Per view: voxels with flame behind them (V,) bool, the cell each of those falls into, the light of every cell."""
    footprint = max(1, int(np.ceil(voxels.voxel_size * float(np.nanmedian(np.abs(voxels.jacobian).max((-1, -2)))))))
    cells_per_row = intensity.shape[2] // footprint + 1
    rows, columns = (np.arange(n) // footprint for n in intensity.shape[1:])
    pixel_cell = (rows[:, None] * cells_per_row + columns[None]).ravel()
    pixels = np.maximum(np.bincount(pixel_cell), 1)
    views = []
    for c in range(len(intensity)):
        column, row = (voxels.pixel[c][seen[c]] // footprint).astype(np.int64).T
        views.append((seen[c], row * cells_per_row + column, np.bincount(pixel_cell, intensity[c].ravel()) / pixels))
    return views


def _maximise(emission: np.ndarray, views: list[tuple], iterations: int) -> np.ndarray:
    for _ in range(iterations):
        ratio, count = np.zeros_like(emission), np.zeros_like(emission)
        for seen, cell, light in views:
            projected = np.bincount(cell, emission[seen], len(light))
            # A cell without any standing voxel explains nothing and asks for nothing.
            ratio[seen] += (light / np.where(projected > 0, projected, np.inf))[cell]
            count[seen] += 1
        emission = emission * ratio / np.maximum(count, 1)
    return emission
