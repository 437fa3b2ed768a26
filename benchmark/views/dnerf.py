"""D-NeRF's ``transforms_train.json``, ``_val`` and ``_test``: one field of view for all, ``time`` in [0, 1].

``time_s`` holds seconds. ``file_path`` has no suffix, because readers of this layout append ".png".
"""

from __future__ import annotations

import math

from gof.core.cameras import Camera
from gof.core.errors import DataFormatError
from gof.core.files import write_json
from gof.dataset import Dataset

from .source import ViewSource


def write(source: ViewSource) -> None:
    dataset = source.dataset
    angle = field_of_view(dataset)
    train, test = [], []
    for camera, frame, trains in source.pictures():
        picture = {
            "file_path": "./" + dataset.name(camera, "rgb", frame).removesuffix(".png"),
            "time": source.normalised_time(frame),
            "time_s": float(dataset.times_s[frame]),
            "rotation": 0.0,
            "transform_matrix": source.opengl_pose(camera).tolist(),
        }
        (train if trains else test).append(picture)
    for name, frames in (("train", train), ("test", test), ("val", test)):
        write_json(dataset.path / f"transforms_{name}.json", {"camera_angle_x": angle, "frames": frames})


def field_of_view(dataset: Dataset) -> float:
    """Return the horizontal field of view that all cameras share, radians. Raises DataFormatError: they do not share
    one."""
    first = dataset.cameras[0]
    for camera in dataset.cameras:
        if not (_same_lens(camera, first) and is_centred(camera)):
            raise DataFormatError(
                f"{dataset.path}: the D-NeRF layout has one centred field of view for all cameras; "
                f"'{camera.name}' differs"
            )
    return 2 * math.atan(first.width / (2 * first.K[0, 0]))


def _same_lens(a: Camera, b: Camera) -> bool:
    return abs(a.K - b.K).max() < 1e-6 and (a.width, a.height) == (b.width, b.height)


def is_centred(camera: Camera) -> bool:
    """Return whether the principal point is the picture's middle, and pixels are square."""
    K = camera.K
    off_centre = max(abs(K[0, 2] - camera.width / 2), abs(K[1, 2] - camera.height / 2))
    return off_centre < 1e-6 and abs(K[0, 0] - K[1, 1]) < 1e-6
