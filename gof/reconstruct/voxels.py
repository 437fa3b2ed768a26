"""The voxel grid a flame lives in: its box from the masks, and its hull."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix

from gof.core.cameras import Camera
from gof.core.errors import DataFormatError

MIN_VIEWS = 2  # whose masks must hold a voxel, where there are so many cameras
ROOM = 4.0  # voxels around the hull that flame Gaussians, which may move, are still sure to be in
ONE_SIDE = 0.2  # by which the rays' first principal value exceeds the second: cameras less far around see all sides
STEEP = np.sin(np.deg2rad(60))  # of the cameras' common direction
FARTHEST = 2.0**30  # px: no picture is so wide, and a whole number of 32 bits holds it
LAYERS_POOLED = 2.0  # std-dev in voxels: a flame's middle and width change slowly with height


@dataclass(frozen=True)
class FlameVoxels:
    """Voxels that at least one frame's masks leave standing.

    Attributes:
        center: (V, 3) world m.        voxel_size: m.
        index: (V, 3) int grid index;  resolution: (3,) int grid size.
        pixel: (C, V, 2) continuous image position per camera (NaN behind a camera, and behind what hides the voxel).
        jacobian: (C, V, 2, 3) d(pixel)/d(world), px/m.
        forward: (C, 3) unit vectors along the cameras' optical axes.
    """

    center: np.ndarray
    voxel_size: float
    index: np.ndarray
    resolution: np.ndarray
    pixel: np.ndarray
    jacobian: np.ndarray
    forward: np.ndarray

    @property
    def first_center(self) -> np.ndarray:
        """(3,) centre of the grid's first voxel, whether it is among these or not."""
        return self.center[0] - self.index[0] * self.voxel_size

    @cached_property
    def common_ray(self) -> np.ndarray | None:
        """(3,) the cameras' common direction; None where they stand all around, or look down steeply."""
        rays = np.cross(self.jacobian[:, :, 0], self.jacobian[:, :, 1])
        rays = np.where(np.isfinite(rays), rays, 0).sum(1)  # NaN: a voxel beside or behind the camera
        length = np.linalg.norm(rays, axis=1)
        rays = rays[length > 0] / length[length > 0, None]
        common, axes = np.linalg.eigh(rays.T @ rays / max(len(rays), 1))
        ahead = axes[:, 2]
        return None if common[2] - common[1] < ONE_SIDE or abs(ahead[2]) > STEEP else ahead

    def only(self, rows: np.ndarray) -> FlameVoxels:
        """Return some of the voxels, of the same grid. rows: indices, or (V,) bool."""
        parts = {name: getattr(self, name)[rows] for name in ("center", "index")}
        return replace(self, **parts, pixel=self.pixel[:, rows], jacobian=self.jacobian[:, rows])

    def sample(self, images: np.ndarray, outside=0) -> np.ndarray:
        """Nearest-pixel values of images (C, H, W, ...) at every voxel: (C, V, ...).

        `outside` where a voxel has no pixel.
        """
        height, width = images.shape[1:3]
        result = np.full((len(images), len(self.center), *images.shape[3:]), outside, images.dtype)
        for c, image in enumerate(images):
            column, row = self._whole_pixel[c]
            (inside,) = np.nonzero((column >= 0) & (row >= 0) & (column < width) & (row < height))
            result[c, inside] = image[row[inside], column[inside]]
        return result

    @cached_property
    def _whole_pixel(self) -> np.ndarray:
        """(C, 2, V) int32 column and row of the pixel that each voxel is in; negative where it has none.

        Found once, so places may not change any more.
        """
        self.pixel.setflags(write=False)
        with np.errstate(invalid="ignore"):
            place = np.where(self.pixel >= 0, np.minimum(self.pixel, FARTHEST), -1.0)  # NaN is not >= 0
        return np.ascontiguousarray(place.astype(np.int32).swapaxes(1, 2))


def share_among_pixels(place: np.ndarray, width: int, height: int) -> csr_matrix:
    """Return (height * width, V): how much of each point every pixel of a picture has, by bilinear weights.

    Args:
        place: (V, 2) continuous positions in the picture, px. A point at NaN is in no pixel, and what reaches beyond
            the edge is left out.
    """
    column, row = np.nan_to_num(place - 0.5, nan=-9.0).T
    x, y = np.floor(column).astype(np.int64), np.floor(row).astype(np.int64)
    across, down = column - x, row - y
    pixels, weights, points = [], [], []
    for dx, dy in ((0, 0), (1, 0), (0, 1), (1, 1)):
        (inside,) = np.nonzero((x + dx >= 0) & (x + dx < width) & (y + dy >= 0) & (y + dy < height))
        weight = (across if dx else 1 - across) * (down if dy else 1 - down)
        pixels.append(((y + dy) * width + x + dx)[inside])
        weights.append(weight[inside])
        points.append(inside)
    pixel, weight, point = map(np.concatenate, (pixels, weights, points))
    return coo_matrix((weight, (pixel, point)), (width * height, len(place))).tocsr()


def flame_box(cameras: list[Camera], masks: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a world box (min (3,), max (3,)) that surely holds the flame.

    The rays through the masks' centroids meet (least squares) at the flame; the masks' extent at that depth gives its
    size. A single camera cannot say how far away its flame is: that stands over the world's origin (+z is up).

    Args:
        masks: (C, H, W) bool, union over time.
    Raises:
        DataFormatError: one of several cameras alone sees flame, or none; their rays are parallel (condition number
            > 1e8), or that of a single one is upright.
    """
    seen = [c for c in range(len(cameras)) if masks[c].any()]
    if len(seen) < min(2, len(cameras)):
        raise DataFormatError(
            f"flame is visible in {len(seen)} of {len(cameras)} cameras; it cannot be placed in space"
        )
    A, b = np.zeros((3, 3)), np.zeros(3)
    if len(cameras) == 1:
        A += np.diag([1.0, 1.0, 0.0])  # the world's axis, x = y = 0, is the second ray
    extent = {}
    for c in seen:
        rows, columns = np.nonzero(masks[c])
        corner_min, corner_max = np.array([columns.min(), rows.min()]), np.array([columns.max(), rows.max()]) + 1
        extent[c] = np.abs(corner_max - corner_min)
        center = np.array([*(corner_min + corner_max) / 2, 1.0])
        R = cameras[c].world_to_camera[:3, :3]
        ray = R.T @ np.linalg.solve(cameras[c].K, center)
        ray = ray / np.linalg.norm(ray)
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


def carve(
    cameras: list[Camera],
    masks: np.ndarray,
    longest_side: int,
    blocked: np.ndarray | None = None,
    vetoes: bool = True,
) -> FlameVoxels:
    """Voxels whose image lies in the union-over-time mask of every camera that has them in view.

    At least MIN_VIEWS of those masks must hold it. A camera does not have in view what something hides from it. What
    a single camera sees is no deeper than it is wide.

    Args:
        cameras: C cameras.   masks: (F, C, H, W) bool.
        longest_side: voxels along the longest side of the flame's own box (sets the voxel size).
        blocked: (C, H, W) bool, where something stands before the flame (`occluders`); None: nowhere.
        vetoes: whether a camera's mask ends the hull; else MIN_VIEWS are enough (authors of the paper).
    Raises:
        DataFormatError: see `flame_box`; or the hull is empty (masks or poses disagree).
    """
    union, least = masks.any(0), min(MIN_VIEWS, len(cameras))
    low, high = flame_box(cameras, union)
    forward = np.stack([camera.world_to_camera[2, :3] for camera in cameras])
    for side in (48, longest_side):  # first coarse, for the flame's own box, then at the asked size
        voxel = (high - low).max() / side
        resolution = np.maximum(np.ceil((high - low) / voxel - 1e-6).astype(int), 1)
        index = np.stack(np.meshgrid(*map(np.arange, resolution), indexing="ij"), -1).reshape(-1, 3)
        center = low + (index + 0.5) * voxel
        pixel = np.stack([cam.project(center)[0] for cam in cameras])
        voxels = FlameVoxels(center, float(voxel), index, resolution, pixel, np.empty(0), forward)
        if blocked is not None:
            voxels = replace(voxels, pixel=np.where(voxels.sample(blocked)[..., None], np.nan, pixel))
        hit = voxels.sample(union.astype(np.int8), outside=-1)
        keep = (hit == 1).sum(0) >= least
        if vetoes:
            keep &= (hit != 0).all(0)
        if len(cameras) == 1 and keep.any():
            keep &= _no_deeper_than_wide(center, keep, forward[0])
        if not keep.any():
            raise DataFormatError(
                f"no voxel lies in the flame masks of {least} of {len(cameras)} cameras; check the masks and the "
                "camera poses"
            )
        low, high = center[keep].min(0) - voxel, center[keep].max(0) + voxel
    kept = center[keep]
    jacobian = np.stack([cam.projection_jacobian(kept) for cam in cameras])
    return FlameVoxels(kept, voxels.voxel_size, index[keep], resolution, voxels.pixel[:, keep], jacobian, forward)


def _no_deeper_than_wide(center: np.ndarray, seen: np.ndarray, forward: np.ndarray) -> np.ndarray:
    """(V,) bool: voxels as near to the world's axis along a camera's view, as what it sees reaches across it.

    Args:
        center: (V, 3).   seen: (V,) bool, some.   forward: (3,) optical axis, not upright.
    """
    depth = forward[:2] / np.linalg.norm(forward[:2])
    across = center[seen, :2] @ (depth[1], -depth[0])
    return np.abs(center[:, :2] @ depth) <= np.ptp(across) / 2
