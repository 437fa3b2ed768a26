"""The folder of the Neural 3D Video data set (DyNeRF) in ``dynerf/``: ``poses_bounds.npy`` and ``camNN/images``.

Rows of ``poses_bounds.npy`` follow LLFF: a 3x5 matrix [down, right, backwards, position, (height, width, focal)],
then the near and far depth. Evaluation cameras come first, because readers of this layout hold out camera 0.
"""

from __future__ import annotations

import numpy as np

from gof.core.files import atomic_path, path_in

from .source import ViewSource, link


def write(source: ViewSource) -> None:
    dataset = source.dataset
    order = sorted(range(len(dataset.cameras)), key=lambda camera: source.trains[camera])
    rows = []
    for number, camera in enumerate(order):
        rows.append(poses_bounds(source, camera))
        link_pictures(source, camera, number)
    with atomic_path(path_in(dataset.path, "dynerf/poses_bounds.npy")) as path:
        np.save(path, np.array(rows))


def link_pictures(source: ViewSource, camera: int, number: int) -> None:
    """Give a camera's pictures the names of camera `number` in this layout.

    Raises:
        DataFormatError: a picture or a name leads out of the dataset.
    """
    dataset = source.dataset
    for frame in range(len(dataset.times_s)):
        target = path_in(dataset.path, f"dynerf/cam{number:02d}/images/{frame:04d}.png")
        link(dataset.file(camera, "rgb", frame), target)


def poses_bounds(source: ViewSource, camera: int) -> np.ndarray:
    """Return (17,) row of a camera: the 3x5 matrix and the near and far depth, m."""
    lens = source.dataset.cameras[camera]
    right, up, back, centre = source.opengl_pose(camera)[:3].T
    size = np.array([lens.height, lens.width, lens.K[0, 0]])
    depth = source.plate_depth(camera)
    seen = depth[np.isfinite(depth)]
    near, far = (0.8 * seen.min(), 1.2 * seen.max()) if seen.size else (0.1, 100.0)
    return np.array([*np.stack([-up, right, back, centre, size], axis=1).ravel(), near, far])
