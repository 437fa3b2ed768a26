"""The layout of FreeTimeGsVanilla in ``freetimegs/``: ``images/CAMERA/KKKKKK.png``, ``sparse/0``, ``triangulation``.

Its trainer holds out the first camera in the order of names, whatever one says. So the first is one for that: the
dataset's first evaluation camera, or, without one, a copy of the first training camera. Held-out frames are left out
of the training cameras' folders; its loader skips them and keeps the clock.

``triangulation/points3d_frameKKKKKK.npy`` and ``colors_frameKKKKKK.npy`` are what its script
``combine_frames_fast_keyframes.py`` makes the starting points of: in its own pipeline points matched by a network.
Here they are the still points, and points of the flame's hull drawn anew in every frame: the velocities that the
script finds between nearest neighbours are zero for the first and no motion of the gas for the second.
"""

from __future__ import annotations

import numpy as np

from gof.core.errors import DataFormatError
from gof.core.files import atomic_path, path_in

from .colmap import write_model
from .points import StartingPoints
from .source import ViewSource, link

FOLDER = "freetimegs"
VALIDATION = "00_validation"


def write(source: ViewSource) -> None:
    """Write the view. Raises DataFormatError: a camera's name comes before that of the held-out one, or no flame to
    start from."""
    dataset = source.dataset
    numbers = [number for number, trains in enumerate(source.trains) if trains]
    held_out = next((number for number, trains in enumerate(source.trains) if not trains), numbers[0])
    names = [dataset.cameras[number].name for number in numbers]
    if min(names) <= VALIDATION:
        raise DataFormatError(
            f"{dataset.path}: camera '{min(names)}' must sort after '{VALIDATION}', which the trainer holds out"
        )
    folder = path_in(dataset.path, FOLDER)
    for frame in range(len(dataset.times_s)):
        link(dataset.file(held_out, "rgb", frame), path_in(folder, f"images/{VALIDATION}/{frame:06d}.png"))
        for number, name in zip(numbers, names, strict=True):
            if frame not in dataset.test_frames:
                link(dataset.file(number, "rgb", frame), path_in(folder, f"images/{name}/{frame:06d}.png"))
    pictures = [f"{name}/000000.png" for name in (VALIDATION, *names)]
    write_model(source, path_in(folder, "sparse/0"), [held_out, *numbers], pictures)
    points = StartingPoints.of(source)
    for frame, flame in points.flame.items():
        together = points.still.and_also(flame)
        for name, values in (("points3d", together.position), ("colors", together.colour)):
            with atomic_path(path_in(folder, f"triangulation/{name}_frame{frame:06d}.npy")) as path:
                np.save(path, values.astype(np.float32))
