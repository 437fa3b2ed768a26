"""The part of every camera's picture in which the flame can be: all that its Gaussians have to be drawn and scored in.

A flame fills a tenth of a picture of a real capture, and drawing, losses and the plates' pixels cost by the pixel.
Nothing is drawn outside, so nothing can be learned there: the plate stays as it was made.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gof.cameras import Camera
from gof.reconstruct.observation import Observation
from gof.reconstruct.voxels import ROOM, FlameVoxels
from gof.render.ssim import REACH


@dataclass(frozen=True)
class Windows:
    """Rectangles of one size, so that pictures stay arrays.

    Attributes:
        corner: (C, 2) int, the first column and row of each camera's.   width, height: px.
    """

    corner: np.ndarray
    width: int
    height: int

    @classmethod
    def whole(cls, cameras: list[Camera]) -> Windows:
        """The pictures themselves; all of one size."""
        return cls(np.zeros((len(cameras), 2), int), cameras[0].width, cameras[0].height)

    @classmethod
    def around(cls, voxels: FlameVoxels, cameras: list[Camera]) -> Windows:
        """The smallest that hold the flame's hull with `ROOM`, and what SSIM looks at; pictures all of one size.

        Whole pictures where a camera stands among the voxels or before some of them.
        """
        size = np.array([cameras[0].width, cameras[0].height])
        reach = ROOM * voxels.voxel_size * np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T
        low, high = [], []
        for camera in cameras:
            corners = np.concatenate([camera.project(voxels.center + step)[0] for step in reach])
            if not np.isfinite(corners).all():
                return cls.whole(cameras)
            low.append(np.floor(corners.min(0)) - REACH)
            high.append(np.ceil(corners.max(0)) + REACH)
        low, high = np.clip(low, 0, size).astype(int), np.clip(high, 0, size).astype(int)
        width, height = np.maximum((high - low).max(0), 1)
        return cls(np.minimum(low, size - (width, height)), int(width), int(height))

    def observed(self, observation: Observation) -> Observation:
        """The same, of these parts of the pictures alone; their cameras are cameras of their own."""
        if (self.width, self.height) == observation.image.shape[3:1:-1]:
            return observation

        def part(pictures: np.ndarray, axis: int) -> np.ndarray:  # the axis of the cameras; rows and columns follow
            parts = []
            for c, (x, y) in enumerate(self.corner):
                chosen = [slice(None)] * pictures.ndim
                chosen[axis] = c
                chosen[axis + 1 : axis + 3] = slice(y, y + self.height), slice(x, x + self.width)
                parts.append(pictures[tuple(chosen)])
            return np.stack(parts, axis=axis)

        cameras = observation.cameras
        later = [self._read_later_s(c, camera) for c, camera in enumerate(cameras)]
        corners = [(int(x), int(y)) for x, y in self.corner]
        return replace(
            observation,
            cameras=[k.cropped(x, y, self.width, self.height) for k, (x, y) in zip(cameras, corners, strict=True)],
            camera_time_s=observation.camera_time_s + np.array(later)[:, None],
            **{name: part(getattr(observation, name), 1) for name in ("image", "intensity", "mask", "allowed", "flow")},
            **{name: part(getattr(observation, name), 0) for name in ("static", "plate", "blocked")},
        )

    def plates(self, parts: list[np.ndarray], observation: Observation) -> list[np.ndarray]:
        """Plates of whole pictures (`Surroundings.result`) with these parts in their places; of none, none."""
        if not parts:
            return []
        whole = []
        for (x, y), part, plate, blocked in zip(
            self.corner, parts, observation.plate, observation.blocked, strict=True
        ):
            picture = np.concatenate([plate, blocked[..., None]], -1)[..., : part.shape[-1]].astype(np.float32)
            picture[y : y + self.height, x : x + self.width] = part
            whole.append(picture)
        return whole

    def _read_later_s(self, c: int, camera: Camera) -> float:
        """How much later than a camera's first line that of its window is read."""
        x, y = self.corner[c]
        lines = {
            "down": y,
            "up": camera.height - y - self.height,
            "right": x,
            "left": camera.width - x - self.width,
        }
        return camera.row_time_s * lines[camera.readout]
