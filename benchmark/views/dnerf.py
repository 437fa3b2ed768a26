"""D-NeRF's ``transforms_train.json``, ``_val`` and ``_test``: one field of view for all, ``time`` in [0, 1].

``time_s`` holds seconds. ``file_path`` has no suffix, because readers of this layout append ".png".
"""

from __future__ import annotations

import math

from gof.errors import DataFormatError
from gof.io.files import write_json

from .rig import Rig


def write(rig: Rig) -> None:
    first = rig.cameras[0]
    for camera in rig.cameras:
        same = abs(camera.K - first.K).max() < 1e-6 and (camera.width, camera.height) == (first.width, first.height)
        centred = abs(camera.K[0, 2] - camera.width / 2) < 1e-6 and abs(camera.K[1, 2] - camera.height / 2) < 1e-6
        if not (same and centred and abs(camera.K[0, 0] - camera.K[1, 1]) < 1e-6):
            raise DataFormatError(
                f"{rig.root}: the D-NeRF layout has one centred field of view for all cameras; '{camera.name}' differs"
            )
    angle = 2 * math.atan(first.width / (2 * first.K[0, 0]))
    splits = {"train": [], "test": []}
    for camera, frame, trains in rig.pictures():
        splits["train" if trains else "test"].append(
            {
                "file_path": "./" + rig.file(camera, "rgb", frame).removesuffix(".png"),
                "time": rig.normalised_time(frame),
                "time_s": float(rig.times_s[frame]),
                "rotation": 0.0,
                "transform_matrix": rig.opengl_pose(camera).tolist(),
            }
        )
    for name, frames in (splits | {"val": splits["test"]}).items():
        write_json(rig.root / f"transforms_{name}.json", {"camera_angle_x": angle, "frames": frames})
