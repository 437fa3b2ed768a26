"""A dataset as every view needs it: cameras, times and splits, for training and for evaluation."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gof.core.errors import DataFormatError
from gof.core.files import atomic_path, path_in
from gof.dataset import Dataset
from gof.host import extras

FAR = 1e6  # metres; Blender writes 1e10 where nothing is


@dataclass(frozen=True)
class ViewSource:
    """A finished dataset seen by all its cameras.

    Attributes:
        dataset: its cameras are those for training and those for evaluation, in file order.
        trains: whether a method may train on the camera, per camera.
    """

    dataset: Dataset
    trains: tuple[bool, ...]

    @classmethod
    def open(cls, root: Path) -> ViewSource:
        """Open it. Raises DataFormatError if the folder holds no finished dataset."""
        dataset = Dataset.open(root)
        entries = [entry for entry in dataset.description.cameras if entry.role != "around"]  # they miss most frames
        all_cameras = replace(dataset, cameras=dataset.description.cameras_from(dataset.datum, "train", "eval"))
        return cls(all_cameras, tuple(entry.role == "train" for entry in entries))

    def pictures(self) -> Iterator[tuple[int, int, bool]]:
        """Yield (camera, frame, whether a method may train on it), frame by frame."""
        for frame in range(len(self.dataset.times_s)):
            for camera, trains in enumerate(self.trains):
                yield camera, frame, trains and frame not in self.dataset.test_frames

    def normalised_time(self, frame: int) -> float:
        """0 at the first frame, 1 at the last; 0 for a single frame."""
        times = self.dataset.times_s
        span = times[-1] - times[0]
        return float((times[frame] - times[0]) / span) if span > 0 else 0.0

    def opengl_pose(self, camera: int) -> np.ndarray:
        """Return (4, 4) camera to world with x right, y up, z backward, as Nerfstudio, NeRF and Blender write it."""
        return np.linalg.inv(self.dataset.cameras[camera].world_to_camera) @ np.diag([1.0, -1.0, -1.0, 1.0])

    def plate_depth(self, camera: int) -> np.ndarray:
        """Return (H, W) float32 camera depth of the fire-free view, metres; inf where nothing is."""
        OpenEXR = extras.load("OpenEXR", "generate", "reading depth")
        plate = Path(self.dataset.name(camera, "static"))
        path = path_in(self.dataset.path, plate.with_suffix(".exr").as_posix())
        try:
            with OpenEXR.File(str(path), separate_channels=True) as file:
                depth = np.array(file.channels()["Z"].pixels, np.float32)
        except (OSError, RuntimeError, KeyError) as error:
            raise DataFormatError(f"{path}: holds no readable depth 'Z' ({error})") from error
        return np.where(depth < FAR, depth, np.inf)


# ----------------------------------------------------------------
# A second name for a file, where a layout insists on its own names.


def link(source: Path, target: Path) -> None:
    """Link a second name to a file, or copy it where the file system has no hard links."""
    with atomic_path(target) as temporary:
        try:
            os.link(source, temporary)
        except OSError:
            shutil.copyfile(source, temporary)
