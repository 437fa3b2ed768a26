"""Scores on pictures the optimisation never sees: held-out frames, and cameras kept for novel views (role "eval")."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gof.cameras import Camera
from gof.dataset import Dataset
from gof.evaluate.image import psnr, ssim
from gof.gaussians import TransientGaussians
from gof.reconstruct.motion import flame_mask
from gof.reconstruct.shrink import shrink


@dataclass(frozen=True)
class _Picture:
    camera: Camera
    number: int | None  # of the training camera; None for a camera kept for novel views
    time_s: float
    truth: np.ndarray
    plate: np.ndarray
    mask: np.ndarray  # of the flame
    counts: np.ndarray | None  # (H, W) weight of each pixel, 0 on the sync board; None = all

    def draw(self, gaussians: TransientGaussians, plates: list[np.ndarray], near: float) -> np.ndarray:
        """(H, W, 3) display values in [0, 1]; args as `HeldOut.score`."""
        from gof.render import render

        plate = self.plate if self.number is None else plates[self.number]
        return np.clip(render(gaussians, self.camera, self.time_s, background=plate, near=near)["color"], 0, 1)


class HeldOut:
    """The pictures of a dataset's test frames, read once.

    A picture's flame is the dataset's own mask; where there is none (a real capture), the motion mask of that picture. Pixels of
    the sync board do not count.
    """

    def __init__(self, dataset: Dataset, longest_side: int):
        self.pictures = _pictures(shrink(dataset, longest_side), training=True)
        kept = [Camera.from_dict(entry) for entry in dataset.meta["cameras"] if entry.get("role") == "eval"]
        if kept:
            self.pictures += _pictures(shrink(replace(dataset, cameras=kept), longest_side), training=False)

    def score(self, gaussians: TransientGaussians, plates: list[np.ndarray], near: float) -> dict[str, float | None]:
        """Means over the held-out pictures.

        Args:
            plates: C x (H, W, 3) display values of the training cameras, what the Gaussians are drawn over.
            near: m, Gaussians closer to a camera are not drawn.
        Returns:
            "psnr", "ssim", "psnr_flame", "ssim_flame" of the training cameras, and "psnr_flame_novel" of cameras with role
            "eval"; None without such pictures.
        """
        values = {name: [] for name in ("psnr", "ssim", "psnr_flame", "ssim_flame", "psnr_flame_novel")}
        for p in self.pictures:
            image = p.draw(gaussians, plates, near)
            if p.number is None:
                values["psnr_flame_novel"].append(psnr(image, p.truth, p.mask))
                continue
            for name, score in (("psnr", psnr), ("ssim", ssim)):
                values[name].append(score(image, p.truth, p.counts))
                values[f"{name}_flame"].append(score(image, p.truth, p.mask))
        finite = {name: [x for x in v if x is not None and np.isfinite(x)] for name, v in values.items()}
        return {name: round(float(np.mean(v)), 4) if v else None for name, v in finite.items()}

    def side_by_side(self, gaussians: TransientGaussians, plates: list[np.ndarray], near: float) -> np.ndarray | None:
        """(2 H, C W, 3): a held-out frame in the middle of the clip, above what the Gaussians make of it. None without one."""
        training = [p for p in self.pictures if p.number is not None]
        if not training:
            return None
        frames = len(training) // len(plates)
        shown = [training[c * frames + frames // 2] for c in range(len(plates))]
        if len({p.truth.shape for p in shown}) > 1:  # cameras of different sizes do not make a grid
            shown = shown[:1]
        drawn = [p.draw(gaussians, plates, near) for p in shown]
        return np.vstack([np.hstack([p.truth for p in shown]), np.hstack(drawn)])


def _pictures(dataset: Dataset, training: bool) -> list[_Picture]:
    result = []
    for c, camera in enumerate(dataset.cameras):
        plate, times, counts = dataset.static(c), dataset.camera_times_s(c), dataset.board_weight(c)
        for k in dataset.test_frames:
            truth, mask = dataset.image(c, k), dataset.mask(c, k)
            mask = flame_mask(truth, plate).astype(np.float32) if mask is None else mask
            mask = mask if counts is None else mask * counts
            result.append(_Picture(camera, c if training else None, float(times[k]), truth, plate, mask, counts))
    return result
