"""Depth of the whole still scene: stereo between a dataset's plates, completed, as a map per camera and one cloud."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gof.core.errors import GofError
from gof.core.files import atomic_path, only_run_in, path_in
from gof.dataset import Dataset
from gof.dataset.leaks import refuse_leaks
from gof.dataset.poses import Poses
from gof.ingest.depth import back_project, whole_depth, write_points
from gof.ingest.stereo import stereo_depth

POINTS = "points.ply"


def depth_name(camera: str) -> str:
    """Name in the dataset of the depth map of a camera's plate."""
    return f"depth/{camera}.npy"


def write_plate_depths(dataset: Dataset, weights: Path | None = None, overwrite: bool = False) -> list[Path]:
    """Write DATASET/depth/CAMERA.npy, (H, W) float32 camera z in m, and DATASET/points.ply, all their pixels.

    They were made from the frames that the plates were made from, which the dataset says.

    Args:
        weights: folder of the checkpoint for `gof.ingest.depth.monocular`; None: see `complete` there.
        overwrite: replace maps that are there.
    Returns:
        the files.
    Raises:
        GofError: a file is there already, or the dataset has a single camera; see `whole_depth`.
        LeakError: the plates were made from a held-out frame.
    """
    if len(dataset.cameras) < 2:
        raise GofError(f"{dataset.path}: one camera has no stereo; two or more have")
    files = [path_in(dataset.path, depth_name(camera.name)) for camera in dataset.cameras]
    cloud = path_in(dataset.path, POINTS)
    for file in (*files, cloud):
        if file.exists() and not overwrite:
            raise GofError(f"{file}: is there already; replace it with --overwrite")
    refuse_leaks(dataset)
    poses = Poses.read(dataset.path)
    sparse = np.zeros((0, 3)) if poses is None else poses.points_array() - dataset.datum.position
    plates = [np.uint8(np.rint(255 * dataset.static(c))) for c in range(len(dataset.cameras))]
    found = stereo_depth(plates, dataset.cameras, sparse)
    maps = [whole_depth(partial, plate, weights) for partial, plate in zip(found, plates, strict=True)]
    clouds = [
        back_project(depth, plate, camera) for depth, plate, camera in zip(maps, plates, dataset.cameras, strict=True)
    ]
    points, colors = (np.concatenate(parts) for parts in zip(*clouds, strict=True))
    with only_run_in(dataset.path):
        for file, depth in zip(files, maps, strict=True):
            file.parent.mkdir(exist_ok=True)
            with atomic_path(file) as temporary:
                np.save(temporary, depth)
        write_points(cloud, points + dataset.datum.position, colors)
    return [*files, cloud]
