"""A dataset seen at fewer pixels, for presets that trade sharpness for time."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from gof.core.cameras import Camera
from gof.core.gaussians import TransientGaussians
from gof.dataset import Dataset
from gof.render.project import ProjectionOptions


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


def enlarge(gaussians: TransientGaussians, dataset: Dataset) -> TransientGaussians:
    """Return Gaussians that were fitted to a `shrink`ed dataset's pictures as they look in full-size ones.

    Every pixel blurs what it shows (`ProjectionOptions.dilation`), and a smaller picture's blurs more of the world.
    Gaussians have learned to be thinner by that much: drawn larger, they would be hairs with gaps between them. So
    dynamic ones are widened by the blur that full-size pixels lack, as the cameras see it at their place, on average.
    """
    if not isinstance(dataset, _Shrunk):
        return gaussians
    lacking = np.zeros(len(gaussians))  # m^2
    for small, full in zip(dataset.cameras, dataset.full.cameras, strict=True):
        depth = np.maximum(small.to_camera(gaussians.position)[:, 2], 0)
        lacking += depth**2 * (1 / small.K[0, 0] ** 2 - 1 / full.K[0, 0] ** 2) / len(dataset.cameras)
    variance = gaussians.scale.astype(np.float64) ** 2 + ProjectionOptions.dilation * lacking[:, None]
    wider = np.where(gaussians.dynamic[:, None], np.sqrt(variance), gaussians.scale)
    return replace(gaussians, scale=wider.astype(np.float32))


def fitting_px(width: int, height: int, longest_side: int) -> tuple[int, int]:
    """Return width and height of a picture that is shrunk to at most `longest_side` pixels, where it is larger."""
    factor = min(1.0, longest_side / max(width, height))
    return max(1, round(width * factor)), max(1, round(height * factor))


def _fitting(camera: Camera, longest_side: int) -> Camera:
    return camera.scaled(*fitting_px(camera.width, camera.height, longest_side))
