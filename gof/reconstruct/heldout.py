"""Scores on pictures the optimisation never sees: held-out frames, and cameras kept for novel views (role "eval")."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from gof.core.cameras import Camera, sizes_px
from gof.core.gaussians import TransientGaussians
from gof.dataset import Dataset
from gof.evaluate.image import psnr, psnr_by_mask, ssim_by_mask
from gof.footage.flame_mask import flame_mask
from gof.host.threads import map_beside
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

        def compare(drawn: tuple[_HeldOutPicture, np.ndarray]) -> dict[str, float | None]:
            picture, image = drawn
            scores: dict[str, float | None] = {}
            for name, score in (("psnr", psnr_by_mask), ("ssim", ssim_by_mask)):
                found = score(image, picture.truth, [picture.counts, picture.flame])
                scores[name], scores[f"{name}_flame"] = found
            return scores

        scores = list(map_beside(compare, self._drawn(self._training, gaussians, plates)))
        values = {name: [each[name] for each in scores] for name in ("psnr", "ssim", "psnr_flame", "ssim_flame")}
        novel = self._drawn(() if plates else self._novel, gaussians, plates)
        values["psnr_flame_novel"] = [psnr(image, picture.truth, picture.flame) for picture, image in novel]
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
        drawn = [image for _, image in self._drawn(shown, gaussians, plates)]
        return np.vstack([np.hstack([picture.truth for picture in shown]), np.hstack(drawn)])

    def _drawn(
        self, pictures: Iterable[_HeldOutPicture], gaussians: TransientGaussians, plates: Sequence[np.ndarray]
    ) -> Iterator[tuple[_HeldOutPicture, np.ndarray]]:
        """Yield each with what the Gaussians make of it, (H, W, 3) display values in [0, 1]."""
        for picture in pictures:
            plate = plates[picture.number] if plates else None
            drawn = render(gaussians, picture.camera, picture.time_s, background=plate, near=self._near)
            yield picture, np.clip(drawn["color"], 0, 1)


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
