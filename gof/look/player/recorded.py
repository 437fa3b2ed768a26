"""A dataset's pictures, small enough to travel inside a page."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from gof.dataset import Dataset
from gof.look.images import base64_text, encoded, to_bytes

PLATE_SIDE, PLATE_QUALITY = 960, 86
# Longest side in px, quality of WebP, every n-th frame: the first that fits the budget is taken.
LADDER = [
    (960, 82, 1),
    (640, 80, 1),
    (480, 74, 1),
    (360, 70, 1),
    (320, 60, 1),
    (240, 55, 1),
    (240, 50, 2),
    (200, 40, 4),
]
SAMPLED = 3  # frames of each camera that tell how large all will be


def webp(picture: np.ndarray, side: int, quality: int) -> bytes:
    """(H, W, 3) display values in [0, 1] as WebP of at most `side` px."""
    return encoded(to_bytes(picture), "webp", quality, side)


def frames_within(
    views: list[tuple[Dataset, int]], budget_bytes: int, progress: Callable[[int, int], None] | None = None
) -> tuple[list[list[str | None] | None], str]:
    """Every camera's recorded frames as base64 WebP, None for one left out; and in words what was done to them.

    Args:
        views: (dataset, number of a camera in it).
        budget_bytes: for all of them together, as base64; 0 = none.
    """
    frames = len(views[0][0].times_s) if views else 0
    chosen = _rung(views, frames, budget_bytes)
    if chosen is None:
        return [None] * len(views), "no recorded pictures"
    side, quality, every = chosen
    packed, total = [], 0
    for number, (dataset, camera) in enumerate(views):
        taken = [
            base64_text(webp(dataset.image(camera, k), side, quality)) if k % every == 0 else None
            for k in range(frames)
        ]
        packed.append(taken)
        total += sum(len(text) for text in taken if text)
        if progress:
            progress(number + 1, len(views))
    width, height = views[0][0].cameras[views[0][1]].width, views[0][0].cameras[views[0][1]].height
    share = min(1.0, side / max(width, height))
    thinned = "" if every == 1 else f", every {every}. frame"
    return packed, (
        f"{len(views)} cameras, {round(width * share)} x {round(height * share)} px{thinned}, {total / 1e6:.1f} MB"
    )


def _rung(views: list[tuple[Dataset, int]], frames: int, budget: int) -> tuple[int, int, int] | None:
    """The first of LADDER whose frames, judged by a few, stay within the budget; None when none does."""
    few = sorted({int(k) for k in np.linspace(0, frames - 1, SAMPLED)}) if frames else []
    samples = [dataset.image(camera, k) for dataset, camera in views for k in few]
    for side, quality, every in LADDER if samples and budget else []:
        mean = np.mean([len(webp(picture, side, quality)) for picture in samples])
        if mean * 4 / 3 * len(views) * -(-frames // every) < budget:
            return side, quality, every
    return None
