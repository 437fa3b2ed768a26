"""Nerfstudio's ``transforms.json``: a pose and full intrinsics per picture, OpenGL camera axes, Z up.

``time`` is normalised to [0, 1], ``time_s`` is in seconds. Flame masks are ``flame_mask_path``: Nerfstudio's own
``mask_path`` would hide what the masks mark.
"""

from __future__ import annotations

from gof.core.files import write_json

from .source import ViewSource


def write(source: ViewSource) -> None:
    dataset = source.dataset
    frames, train, test = [], [], []
    for camera, frame, trains in source.pictures():
        lens = dataset.cameras[camera]
        file = dataset.name(camera, "rgb", frame)
        frames.append(
            {
                "file_path": file,
                "flame_mask_path": dataset.name(camera, "mask", frame),
                "transform_matrix": source.opengl_pose(camera).tolist(),
                "fl_x": lens.K[0, 0],
                "fl_y": lens.K[1, 1],
                "cx": lens.K[0, 2],
                "cy": lens.K[1, 2],
                "w": lens.width,
                "h": lens.height,
                "time": source.normalised_time(frame),
                "time_s": float(dataset.times_s[frame]),
            }
        )
        (train if trains else test).append(file)
    # Nerfstudio takes all lists or none, and lists must not be empty to be used.
    lists = {"train_filenames": train, "val_filenames": test, "test_filenames": test} if test else {}
    write_json(dataset.path / "transforms.json", {"camera_model": "OPENCV", **lists, "frames": frames})
