"""The Neural 3D Video data set as it is published, in ``n3v/``: ``camNN.mp4`` and ``poses_bounds.npy``.

Readers of it take every clip for 2704x2028 and every picture for 4:3, whatever is in the files. So pictures are padded
with black to 4:3 about their middle, and lenses are written for a width of 2704: a reader that resizes to 1352x1014
(4DGS of Wu) then has the right field of view. Pixels are doubled, because the codec keeps colours at half the size.
Camera 0 is the one that readers hold out: the first evaluation camera, or, without one, a copy of the first training
camera. No frame can be held out; pictures of held-out frames are in it.
"""

from __future__ import annotations

import cv2
import numpy as np

from gof.core.errors import DataFormatError
from gof.core.files import atomic_path, path_in
from gof.footage.pictures import read_picture

from .dnerf import field_of_view
from .dynerf import poses_bounds
from .points import StartingPoints, write_ply
from .source import ViewSource

FOLDER = "n3v"
WIDTH, HEIGHT = 2704, 2028  # what readers believe
TIMES = 2  # each pixel, along both sides
FPS = 30.0  # of the file; readers count frames


def write(source: ViewSource) -> None:
    """Write the view. Raises DataFormatError: lenses differ or are off centre, a video cannot be written, or no flame
    to start from."""
    dataset = source.dataset
    field_of_view(dataset)
    numbers = [number for number, trains in enumerate(source.trains) if trains]
    held_out = next((number for number, trains in enumerate(source.trains) if not trains), numbers[0])
    rows = []
    for place, number in enumerate([held_out, *numbers]):
        size = padded(dataset.cameras[number].width, dataset.cameras[number].height)
        row = poses_bounds(source, number)
        row[[4, 9]] = HEIGHT, WIDTH
        row[14] *= TIMES * WIDTH / size[0]
        rows.append(row)
        _write_video(source, number, size, f"{FOLDER}/cam{place:02d}.mp4")
    with atomic_path(path_in(dataset.path, f"{FOLDER}/poses_bounds.npy")) as path:
        np.save(path, np.array(rows))
    write_ply(path_in(dataset.path, f"{FOLDER}/points3D_downsample2.ply"), StartingPoints.of(source).all())


def padded(width: int, height: int) -> tuple[int, int]:
    """Return the smallest 4:3 of whole eights that holds a doubled picture, px: codecs want even sides."""
    eighths = -(-max(TIMES * width, -(-4 * TIMES * height // 3)) // 8)
    return 8 * eighths, 6 * eighths


def _write_video(source: ViewSource, camera: int, size: tuple[int, int], name: str) -> None:
    dataset = source.dataset
    lens = dataset.cameras[camera]
    across, down = (size[0] - TIMES * lens.width) // 2, (size[1] - TIMES * lens.height) // 2
    with atomic_path(path_in(dataset.path, name)) as path:
        writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), FPS, size)
        if not writer.isOpened():
            raise DataFormatError(f"{path_in(dataset.path, name)}: OpenCV here has no MPEG-4 encoder")
        for frame in range(len(dataset.times_s)):
            picture = read_picture(dataset.file(camera, "rgb", frame), size=(lens.width, lens.height))
            doubled = picture.repeat(TIMES, 0).repeat(TIMES, 1)
            writer.write(cv2.copyMakeBorder(doubled, down, down, across, across, cv2.BORDER_CONSTANT))
        writer.release()
