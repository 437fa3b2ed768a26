"""How much work a reconstruction does: presets, and the time they take."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Effort:
    """Settings that trade quality for time.

    Attributes:
        iterations: optimisation steps.   gaussians: in all frames together.
        voxels: along the longest side of the flame's box.   longest_side: of the pictures, px; larger ones are shrunk.
    """

    iterations: int
    gaussians: int
    voxels: int
    longest_side: int


PRESETS = {
    "preview": Effort(2500, 60_000, 72, 320),
    "draft": Effort(10_000, 100_000, 72, 320),
    "standard": Effort(15_000, 120_000, 96, 640),
    "paper": Effort(30_000, 300_000, 128, 1280),  # the paper's steps and picture size; Gaussians and voxels are ours
}


def step_ms(gaussians: int, pixels: int) -> float:
    """Expected ms of an optimisation step on two free CPU cores.

    Linear fit to four runs on a demo clip of 32 training frames (15 000 and 60 000 Gaussians; 90x160 and 180x320 pixels).
    """
    return 5.9 + 0.41e-3 * gaussians + 0.155e-3 * pixels
