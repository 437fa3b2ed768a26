"""A dataset seen at fewer pixels, for presets that trade sharpness for time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gof.dataset import Dataset


@dataclass(frozen=True)
class _Shrunk(Dataset):
    full: Dataset

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
        import cv2

        # Every new pixel is the mean of the old ones it covers.
        size = self.cameras[camera].width, self.cameras[camera].height
        return cv2.resize(image, size, interpolation=cv2.INTER_AREA)


def shrink(dataset: Dataset, longest_side: int) -> Dataset:
    """The dataset with pictures and cameras of at most `longest_side` pixels; the same dataset when they fit already."""
    cameras = []
    for camera in dataset.cameras:
        factor = min(1.0, longest_side / max(camera.width, camera.height))
        cameras.append(camera.scaled(max(1, round(camera.width * factor)), max(1, round(camera.height * factor))))
    if all(a.width == b.width and a.height == b.height for a, b in zip(cameras, dataset.cameras, strict=True)):
        return dataset
    return _Shrunk(dataset.path, dataset.meta, cameras, dataset.times_s, dataset)
