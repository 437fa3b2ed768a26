"""Nerfstudio's ``transforms.json``: a pose and full intrinsics per picture, OpenGL camera axes, Z up.

``time`` is normalised to [0, 1], ``time_s`` is in seconds. Flame masks are ``flame_mask_path``: Nerfstudio's own
``mask_path`` would hide what the masks mark.
"""

from __future__ import annotations

from gof.io.files import write_json

from .rig import Rig


def write(rig: Rig) -> None:
    frames, train, test = [], [], []
    for camera, frame, trains in rig.pictures():
        lens = rig.cameras[camera]
        file = rig.file(camera, "rgb", frame)
        frames.append(
            {
                "file_path": file,
                "flame_mask_path": rig.file(camera, "mask", frame),
                "transform_matrix": rig.opengl_pose(camera).tolist(),
                "fl_x": lens.K[0, 0],
                "fl_y": lens.K[1, 1],
                "cx": lens.K[0, 2],
                "cy": lens.K[1, 2],
                "w": lens.width,
                "h": lens.height,
                "time": rig.normalised_time(frame),
                "time_s": float(rig.times_s[frame]),
            }
        )
        (train if trains else test).append(file)
    # Nerfstudio takes all lists or none, and lists must not be empty to be used.
    lists = {"train_filenames": train, "val_filenames": test, "test_filenames": test} if test else {}
    write_json(rig.root / "transforms.json", {"camera_model": "OPENCV", **lists, "frames": frames})
