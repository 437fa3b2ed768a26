"""A dataset seen at fewer pixels, for presets that trade sharpness for time."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from gof.core.cameras import Camera
from gof.dataset import Dataset


@dataclass(frozen=True)
class _Shrunk(Dataset):
    full: Dataset
    longest_side: int

    def evaluation_view(self) -> Dataset | None:
        view = self.full.evaluation_view()
        return None if view is None else shrink(view, self.longest_side)

    def image(self, camera: int, frame: int) -> np.ndarray:
        return self._resized(self.full.image(camera, frame), camera)

    def static(self, camera: int) -> np.ndarray:
        return self._resized(self.full.static(camera), camera)

    def mask(self, camera: int, frame: int) -> np.ndarray | None:
        mask = self.full.mask(camera, frame)
        return None if mask is None else self._resized(mask, camera)

    def board_weight(self, camera: int) -> np.ndarray | None:
        weight = self.full.board_weight(camera)
        return None if weight is None else self._resized(weight, camera)

    def _resized(self, image: np.ndarray, camera: int) -> np.ndarray:
        # Every new pixel is the mean of the old ones it covers.
        size = self.cameras[camera].width, self.cameras[camera].height
        return cv2.resize(image, size, interpolation=cv2.INTER_AREA)


def shrink(dataset: Dataset, longest_side: int) -> Dataset:
    """Return the dataset with pictures and cameras, those for novel views too, of at most `longest_side` pixels.

    The same dataset when all its cameras' pictures fit already.
    """
    if all(max(entry.width, entry.height) <= longest_side for entry in dataset.description.cameras):
        return dataset
    cameras = [_fitting(camera, longest_side) for camera in dataset.cameras]
    return _Shrunk(dataset.path, dataset.description, cameras, dataset.times_s, dataset, longest_side)


def _fitting(camera: Camera, longest_side: int) -> Camera:
    factor = min(1.0, longest_side / max(camera.width, camera.height))
    return camera.scaled(max(1, round(camera.width * factor)), max(1, round(camera.height * factor)))
