"""Scores on pictures the optimisation never sees: held-out frames, and cameras kept for novel views (role "eval")."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gof.core.cameras import Camera, sizes_px
from gof.core.gaussians import TransientGaussians
from gof.dataset import Dataset
from gof.evaluate.image import psnr, ssim
from gof.footage.flame_mask import flame_mask
from gof.reconstruct.curve import HeldOutScores
from gof.render import render


@dataclass(frozen=True)
class _HeldOutPicture:
    camera: Camera
    number: int  # of the camera in its dataset
    time_s: float
    truth: np.ndarray  # (H, W, 3) display sRGB
    flame: np.ndarray  # (H, W) weight of each pixel for the flame's scores
    counts: np.ndarray | None  # (H, W) weight of each pixel, 0 on the sync board; None = all


class HeldOut:
    """The pictures of a dataset's test frames, read once.

    A picture's flame is the dataset's own mask; where there is none (a real capture), the motion mask of that picture.
    Pixels of the sync board do not count. Novel views are scored for whole scenes only, because they have no plate.
    """

    def __init__(self, dataset: Dataset, static: Sequence[np.ndarray], near: float):
        """
        Args:
            dataset: at the size that is scored; its cameras for novel views come with it.
            static: C x (H, W, 3) display sRGB, the views of its training cameras without fire.
            near: m, Gaussians closer to a camera are not drawn.
        """
        self._near = near
        self._cameras = len(dataset.cameras)
        self._training = _pictures(dataset, static)
        novel = dataset.evaluation_view()
        self._novel = [] if novel is None else _pictures(novel, [novel.static(c) for c in range(len(novel.cameras))])

    def score(self, gaussians: TransientGaussians, plates: Sequence[np.ndarray]) -> HeldOutScores:
        """Means over the held-out pictures.

        Args:
            plates: what the Gaussians are drawn over, see `gof.reconstruct.surroundings`; none for a whole scene.
        """
        names = ("psnr", "ssim", "psnr_flame", "ssim_flame", "psnr_flame_novel")
        values: dict[str, list[float | None]] = {name: [] for name in names}
        for picture in self._training:
            image = self._draw(picture, gaussians, plates)
            for name, score in (("psnr", psnr), ("ssim", ssim)):
                values[name].append(score(image, picture.truth, picture.counts))
                values[f"{name}_flame"].append(score(image, picture.truth, picture.flame))
        for picture in self._novel if not plates else ():
            image = self._draw(picture, gaussians, plates)
            values["psnr_flame_novel"].append(psnr(image, picture.truth, picture.flame))
        sizes = sizes_px(picture.camera for picture in self._training)
        return HeldOutScores(**{name: _mean(found) for name, found in values.items()}, sizes_px=sizes)

    def side_by_side(self, gaussians: TransientGaussians, plates: Sequence[np.ndarray]) -> np.ndarray | None:
        """(2 H, C W, 3): a held-out frame in the middle of the clip, above what the Gaussians make of it.

        None when no frame is held out. Args as `score`.
        """
        if not self._training:
            return None
        frames = len(self._training) // self._cameras
        shown = [self._training[c * frames + frames // 2] for c in range(self._cameras)]
        if len({picture.truth.shape for picture in shown}) > 1:  # cameras of different sizes do not make a grid
            shown = shown[:1]
        drawn = [self._draw(picture, gaussians, plates) for picture in shown]
        return np.vstack([np.hstack([picture.truth for picture in shown]), np.hstack(drawn)])

    def _draw(
        self, picture: _HeldOutPicture, gaussians: TransientGaussians, plates: Sequence[np.ndarray]
    ) -> np.ndarray:
        """(H, W, 3) display values in [0, 1]."""
        plate = plates[picture.number] if plates else None
        drawn = render(gaussians, picture.camera, picture.time_s, background=plate, near=self._near)
        return np.clip(drawn["color"], 0, 1)


def _pictures(dataset: Dataset, static: Sequence[np.ndarray]) -> list[_HeldOutPicture]:
    """Those of a camera one after the other."""
    pictures = []
    for c, camera in enumerate(dataset.cameras):
        times = dataset.camera_times_s(c)
        counts = dataset.board_weight(c)
        for k in dataset.test_frames:
            truth = dataset.image(c, k)
            flame = dataset.mask(c, k)
            if flame is None:
                flame = flame_mask(truth, static[c]).astype(np.float32)
            if counts is not None:
                flame = flame * counts
            pictures.append(_HeldOutPicture(camera, c, float(times[k]), truth, flame, counts))
    return pictures


def _mean(scores: list[float | None]) -> float | None:
    finite = [score for score in scores if score is not None and np.isfinite(score)]
    return round(float(np.mean(finite)), 4) if finite else None
