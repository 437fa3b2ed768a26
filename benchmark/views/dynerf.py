"""The folder of the Neural 3D Video data set (DyNeRF) in ``dynerf/``: ``poses_bounds.npy`` and ``camNN/images``.

Rows of ``poses_bounds.npy`` follow LLFF: a 3x5 matrix [down, right, backwards, position, (height, width, focal)],
then the near and far depth. Evaluation cameras come first, because readers of this layout hold out camera 0.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np

from gof.io.files import atomic_path

from .rig import Rig


def write(rig: Rig) -> None:
    order = sorted(range(len(rig.cameras)), key=lambda camera: rig.entries[camera].get("role", "train") != "eval")
    rows = []
    for number, camera in enumerate(order):
        lens, pose, depth = rig.cameras[camera], rig.opengl_pose(camera), rig.plate_depth(camera)
        right, up, back, centre = pose[:3].T
        size = np.array([lens.height, lens.width, lens.K[0, 0]])
        seen = depth[np.isfinite(depth)]
        near, far = (0.8 * seen.min(), 1.2 * seen.max()) if seen.size else (0.1, 100.0)
        rows.append([*np.stack([-up, right, back, centre, size], axis=1).ravel(), near, far])
        for frame in range(len(rig.times_s)):
            target = rig.root / "dynerf" / f"cam{number:02d}" / "images" / f"{frame:04d}.png"
            _link(rig.root / rig.file(camera, "rgb", frame), target)
    with atomic_path(rig.root / "dynerf" / "poses_bounds.npy") as path:
        np.save(path, np.array(rows))


def _link(source: Path, target: Path) -> None:
    """A second name for a file, or a copy where the file system has no hard links."""
    with atomic_path(target) as temporary:
        try:
            os.link(source, temporary)
        except OSError:
            shutil.copyfile(source, temporary)
