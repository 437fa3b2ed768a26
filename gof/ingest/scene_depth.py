"""Depth of the whole still scene: stereo between the plates, completed, as a map per camera and one cloud of points."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gof.core.cameras import Camera
from gof.core.files import atomic_path, path_in
from gof.ingest.depth import back_project, whole_depth, write_points
from gof.ingest.stereo import stereo_depth
from gof.ingest.stored import StoredView


@dataclass(frozen=True)
class SceneDepth:
    """Depth of the scene without fire.

    Attributes:
        maps: (H, W) float32 camera depth in m per stored view, everywhere.
        points, colors: (N, 3) world m and (N, 3) uint8, all pixels of all maps.
        stereo_share: of each view's pixels, the others are filled.
    """

    maps: list[np.ndarray]
    points: np.ndarray
    colors: np.ndarray
    stereo_share: tuple[float, ...]


def scene_depth(
    full_plates: list[np.ndarray],
    cameras: list[Camera],
    points: np.ndarray,
    stored: list[StoredView],
    weights: Path | None,
) -> SceneDepth:
    """Stereo between the plates at full size, completed at the stored size.

    Args:
        cameras: of the plates at full size.   points: (N, 3) sparse, for the range of depths.
    """
    import cv2

    maps, clouds, share = [], [], []
    for view, partial in zip(stored, stereo_depth(full_plates, cameras, points), strict=True):
        # Nearest: a mean of two surfaces is a place where nothing is.
        partial = cv2.resize(partial, view.plate.shape[1::-1], interpolation=cv2.INTER_NEAREST)
        whole = whole_depth(partial, view.plate, weights)
        maps.append(whole)
        clouds.append(back_project(whole, view.plate, view.camera))
        share.append(round(float(np.isfinite(partial).mean()), 3))
    cloud, colors = (np.concatenate(parts) for parts in zip(*clouds, strict=True))
    return SceneDepth(maps, cloud, colors, tuple(share))


def write_depth(out: Path, stored: list[StoredView], scene: SceneDepth) -> None:
    """depth/CAMERA.npy and points.ply."""
    for view, depth in zip(stored, scene.maps, strict=True):
        with atomic_path(path_in(out, view.depth)) as temporary:
            np.save(temporary, depth)
    write_points(out / "points.ply", scene.points, scene.colors)
