"""What every view needs of a dataset: cameras, times and splits, for training and for evaluation."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gof.cameras import Camera
from gof.dataset import Dataset
from gof.errors import DataFormatError

FAR = 1e6  # metres; Blender writes 1e10 where nothing is


@dataclass(frozen=True)
class Rig:
    root: Path
    cameras: list[Camera]
    entries: list[dict]  # of dataset.json, beside `cameras`
    times_s: np.ndarray
    test_frames: set[int]

    @classmethod
    def open(cls, root: Path) -> Rig:
        """Raises DataFormatError if the folder holds no finished dataset."""
        dataset = Dataset.open(root)
        entries = dataset.meta["cameras"]
        cameras = [Camera.from_dict(entry, f"{root}/dataset.json") for entry in entries]
        return cls(dataset.path, cameras, entries, dataset.times_s, set(dataset.test_frames))

    def pictures(self) -> Iterator[tuple[int, int, bool]]:
        """(camera, frame, whether a method may train on it), frame by frame."""
        for frame in range(len(self.times_s)):
            for camera, entry in enumerate(self.entries):
                yield camera, frame, entry.get("role", "train") == "train" and frame not in self.test_frames

    def file(self, camera: int, kind: str, frame: int = 0) -> str:
        """Path of a file relative to the dataset."""
        return self.entries[camera][kind].format(frame=frame)

    def normalised_time(self, frame: int) -> float:
        """0 at the first frame, 1 at the last; 0 for a single frame."""
        span = self.times_s[-1] - self.times_s[0]
        return float((self.times_s[frame] - self.times_s[0]) / span) if span > 0 else 0.0

    def opengl_pose(self, camera: int) -> np.ndarray:
        """(4, 4) camera to world with x right, y up, z backward, as Nerfstudio, NeRF and Blender write it."""
        return np.linalg.inv(self.cameras[camera].world_to_camera) @ np.diag([1.0, -1.0, -1.0, 1.0])

    def plate_depth(self, camera: int) -> np.ndarray:
        """(H, W) float32 camera depth of the fire-free view, metres; inf where nothing is."""
        import OpenEXR

        path = (self.root / self.file(camera, "static")).with_suffix(".exr")
        try:
            with OpenEXR.File(str(path), separate_channels=True) as file:
                depth = np.array(file.channels()["Z"].pixels, np.float32)
        except (OSError, RuntimeError, KeyError) as error:
            raise DataFormatError(f"{path}: holds no readable depth 'Z' ({error})") from error
        return np.where(depth < FAR, depth, np.inf)
