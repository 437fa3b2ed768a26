"""The part of every camera's picture in which the flame can be: all that its Gaussians have to be drawn and scored in.

A flame fills a tenth of a picture of a real capture, and drawing, losses and the plates' pixels cost by the pixel.
Nothing is drawn outside, so nothing can be learned there: the plate stays as it was made.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gof.core.cameras import Camera
from gof.reconstruct.voxels import ROOM, FlameVoxels
from gof.render.bins import BLOCK
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
        """Return the pictures themselves; all of one size."""
        return cls(np.zeros((len(cameras), 2), int), cameras[0].width, cameras[0].height)

    @classmethod
    def around(cls, voxels: FlameVoxels, cameras: list[Camera]) -> Windows:
        """Return the smallest that hold the flame's hull with `ROOM`, and what SSIM looks at; pictures all of one size.

        Whole pictures where a camera stands among the voxels or before some of them.
        """
        size = np.array([cameras[0].width, cameras[0].height])
        reach = ROOM * voxels.voxel_size * np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T
        lows, highs = [], []
        for camera in cameras:
            corners = np.concatenate([camera.project(voxels.center + step)[0] for step in reach])
            if not np.isfinite(corners).all():
                return cls.whole(cameras)
            lows.append(np.floor(corners.min(0)) - REACH)
            highs.append(np.ceil(corners.max(0)) + REACH)
        low, high = np.clip(lows, 0, size).astype(int), np.clip(highs, 0, size).astype(int)
        # Whole blocks, as long as the picture has them: others are drawn larger and cut, which costs more than drawing.
        width, height = np.minimum(-(-np.maximum((high - low).max(0), 1) // BLOCK) * BLOCK, size)
        return cls(np.minimum(low, size - (width, height)), int(width), int(height))

    def cut(self, camera: int, picture: np.ndarray) -> np.ndarray:
        """Return the part (height, width, ...) of a camera's picture (H, W, ...); a view."""
        x, y = self.corner[camera]
        return picture[y : y + self.height, x : x + self.width]

    def cameras(self, cameras: list[Camera]) -> list[Camera]:
        """Those of the parts."""
        corners = self.corner.tolist()
        return [camera.cropped(x, y, self.width, self.height) for camera, (x, y) in zip(cameras, corners, strict=True)]

    def read_later_s(self, cameras: list[Camera]) -> np.ndarray:
        """(C,) how much later than its picture's first line that of each camera's part is read."""
        return np.array([camera.row_time_s * self._lines_before(c, camera) for c, camera in enumerate(cameras)])

    def plates(self, parts: list[np.ndarray], plates: np.ndarray, blocked: np.ndarray) -> list[np.ndarray]:
        """Plates of whole pictures with these parts in their places; of none, none.

        Args:
            parts: C x (height, width, 3 or 4), see `Surroundings.result`.
            plates: (C, H, W, 3) display values, as they were made.   blocked: (C, H, W) bool.
        """
        whole = []
        for c, part in enumerate(parts):
            before = blocked[c, ..., None].astype(np.float32)
            picture = np.concatenate([plates[c], before], -1)[..., : part.shape[-1]]
            self.cut(c, picture)[...] = part
            whole.append(picture)
        return whole

    def _lines_before(self, c: int, camera: Camera) -> int:
        x, y = self.corner[c].tolist()
        lines = {
            "down": y,
            "up": camera.height - y - self.height,
            "right": x,
            "left": camera.width - x - self.width,
        }
        return lines[camera.readout]
