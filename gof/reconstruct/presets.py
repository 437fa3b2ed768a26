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
    "preview": Effort(1500, 40_000, 72, 320),
    "draft": Effort(5000, 60_000, 72, 320),
    "standard": Effort(15_000, 120_000, 96, 640),
    "paper": Effort(30_000, 300_000, 128, 1280),  # the paper's steps and picture size; Gaussians and voxels are ours
}


def step_ms(gaussians_per_picture: float, pixels: int) -> float:
    """Expected ms of an optimisation step on two free CPU cores (fit to `gof study reconstruct`)."""
    return 10.0 + 0.6e-3 * gaussians_per_picture + 0.25e-3 * pixels
