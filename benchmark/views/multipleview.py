"""The "multiple view" layout of 4DGS (Wu) in ``multipleview/``: what its reader takes for clips of any picture size.

``camNN/frame_KKKKK.jpg`` (from 1), COLMAP's binary model in ``sparse_``, ``poses_bounds_multipleview.npy`` for its
video, ``points3D_multipleview.ply`` to start from. The pictures keep their lossless PNG bytes under the name that the
reader wants; it opens them by content. Its clock is the number of the picture over the number of pictures.

The layout has no held-out frames: its reader trains on every picture there is, and a frame left out would shift the
clock of those after it. So pictures of held-out frames are in it, and a row trained on it must say so.
"""

from __future__ import annotations

import struct

import numpy as np

from gof.core.files import atomic_path, path_in
from gof.core.rotations import quaternions_wxyz

from .dnerf import field_of_view
from .dynerf import poses_bounds
from .points import StartingPoints, write_ply
from .source import ViewSource, link

FOLDER = "multipleview"
PINHOLE = 1


def write(source: ViewSource) -> None:
    """Write the view. Raises DataFormatError: lenses differ or are off centre (the layout has one focal length), or no
    flame."""
    dataset = source.dataset
    field_of_view(dataset)
    numbers = [number for number, trains in enumerate(source.trains) if trains]
    folder = path_in(dataset.path, FOLDER)
    for place, number in enumerate(numbers, start=1):
        for frame in range(len(dataset.times_s)):
            target = path_in(folder, f"cam{place:02d}/frame_{frame + 1:05d}.jpg")
            link(dataset.file(number, "rgb", frame), target)
    _write_model(source, numbers)
    with atomic_path(path_in(folder, "poses_bounds_multipleview.npy")) as path:
        np.save(path, np.array([poses_bounds(source, number) for number in numbers]))
    write_ply(path_in(folder, "points3D_multipleview.ply"), StartingPoints.of(source).all())


def _write_model(source: ViewSource, numbers: list[int]) -> None:
    """sparse_/cameras.bin and images.bin: one camera, a picture ``imageN.png`` for camera N."""
    first = source.dataset.cameras[numbers[0]]
    K = first.K
    lens = struct.pack("<QiiQQ4d", 1, 1, PINHOLE, first.width, first.height, K[0, 0], K[1, 1], K[0, 2], K[1, 2])
    pictures = [struct.pack("<Q", len(numbers))]
    for place, number in enumerate(numbers, start=1):
        pose = source.dataset.cameras[number].world_to_camera
        head = struct.pack("<i7di", place, *quaternions_wxyz(pose[:3, :3]), *pose[:3, 3], 1)
        pictures.append(head + f"image{place}.png".encode() + b"\0" + struct.pack("<Q", 0))
    for name, content in (("cameras", lens), ("images", b"".join(pictures))):
        with atomic_path(path_in(source.dataset.path, f"{FOLDER}/sparse_/{name}.bin")) as path:
            path.write_bytes(content)
