"""The layout of Nerfies and HyperNeRF in ``hypernerf/``: the one of 4DGS (Wu)'s readers that keeps held-out frames out.

``dataset.json`` says which pictures train, ``metadata.json`` the frame and the camera of each, ``camera/ID.json`` the
lens and the pose of the picture at twice its size: readers take ``rgb/2x/ID.png``. The clock is the frame's number
over the last one's, whatever is held out. ``points3D_downsample2.ply`` are the points to start from.
"""

from __future__ import annotations

import json

import numpy as np

from gof.core.errors import DataFormatError
from gof.core.files import atomic_path, path_in

from .dnerf import field_of_view
from .points import StartingPoints, write_ply
from .source import ViewSource, link

FOLDER = "hypernerf"
TIMES = 2  # readers halve the lenses


def write(source: ViewSource) -> None:
    """Write the view, as `write_nerfies`."""
    write_nerfies(source, FOLDER, TIMES, "points3D_downsample2.ply")


def write_nerfies(source: ViewSource, folder: str, times: int, points: str) -> None:
    """Write the files of Nerfies.

    Args:
        folder: in the dataset.   times: the size that lenses are written for, over that of the pictures.
        points: name of the file of points to start from.
    Raises:
        DataFormatError: lenses differ or are off centre (its readers have one), times that are not even, no held-out
            frame (its readers would choose some), or no flame to start from.
    """
    dataset = source.dataset
    field_of_view(dataset)
    steps = np.diff(dataset.times_s)
    if not np.allclose(steps, steps[:1], rtol=1e-3):
        raise DataFormatError(f"{dataset.path}: its frames are not evenly spaced, and this layout counts them")
    pictures = list(source.pictures())
    trains = [_name(camera, frame) for camera, frame, trains in pictures if trains]
    held_out = [_name(camera, frame) for camera, frame, trains in pictures if not trains]
    if not held_out:
        raise DataFormatError(
            f"{dataset.path}: holds out nothing; readers of this layout would choose frames themselves"
        )
    about = {}
    for camera, frame, _ in pictures:
        name = _name(camera, frame)
        link(dataset.file(camera, "rgb", frame), path_in(dataset.path, f"{folder}/rgb/{times}x/{name}.png"))
        _write_json(source, f"{folder}/camera/{name}.json", _camera(source, camera, times))
        about[name] = {"warp_id": frame, "appearance_id": frame, "time_id": frame, "camera_id": camera}
    _write_json(source, f"{folder}/metadata.json", about)
    ids = trains + held_out
    split = {"count": len(ids), "ids": ids, "train_ids": trains, "val_ids": held_out}
    _write_json(source, f"{folder}/dataset.json", split)
    _write_json(source, f"{folder}/scene.json", {"scale": 1.0, "center": [0.0, 0.0, 0.0], "near": 0.1, "far": 100.0})
    write_ply(path_in(dataset.path, f"{folder}/{points}"), StartingPoints.of(source).all())


def _name(camera: int, frame: int) -> str:
    return f"{camera:02d}_{frame:06d}"


def _camera(source: ViewSource, number: int, times: int) -> dict:
    """Return a camera as Nerfies writes it: the world seen from it is ``orientation (x - position)``, axes as
    OpenCV's."""
    lens = source.dataset.cameras[number]
    rotation, shift = lens.world_to_camera[:3, :3], lens.world_to_camera[:3, 3]
    return {
        "orientation": rotation.tolist(),
        "position": (-rotation.T @ shift).tolist(),
        "focal_length": times * float(lens.K[0, 0]),
        "principal_point": [times * float(lens.K[0, 2]), times * float(lens.K[1, 2])],
        "skew": 0.0,
        "pixel_aspect_ratio": 1.0,
        "radial_distortion": [0.0, 0.0, 0.0],
        "tangential_distortion": [0.0, 0.0],
        "image_size": [times * lens.width, times * lens.height],
    }


def _write_json(source: ViewSource, name: str, content: dict) -> None:
    with atomic_path(path_in(source.dataset.path, name)) as path:
        path.write_text(json.dumps(content), encoding="utf-8")
