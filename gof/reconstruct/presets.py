"""Presets: the amount of work of a reconstruction, and its time."""

from __future__ import annotations

from dataclasses import dataclass, replace

from gof.core.errors import GofError
from gof.core.ladder import preset

LEAST = {"iterations": 1, "gaussians": 1, "voxels": 4, "longest_side": 16}
# The options of commands that give them.
FLAGS = {"iterations": "--steps", "gaussians": "--gaussians", "voxels": "--voxels", "longest_side": "--max-size"}


@dataclass(frozen=True)
class Effort:
    """Settings that trade quality for time.

    Attributes:
        iterations: optimisation steps.
        gaussians: in all frames together.
        voxels: along the longest side of the flame's box.
        longest_side: of the pictures, px; larger ones are shrunk.

    Raises:
        GofError: one of them is below its least.
    """

    iterations: int
    gaussians: int
    voxels: int
    longest_side: int

    def __post_init__(self):
        for name, least in LEAST.items():
            if getattr(self, name) < least:
                raise GofError(f"{FLAGS[name]} {getattr(self, name)}: must be {least} or more")


PRESETS: dict[str, Effort] = {
    "toy": Effort(250, 6_000, 32, 160),
    "preview": Effort(2000, 60_000, 72, 320),
    "standard": Effort(15_000, 120_000, 96, 640),
    "large": Effort(20_000, 200_000, 112, 960),
    "full": Effort(30_000, 300_000, 128, 1280),  # the paper's steps and picture size; Gaussians and voxels are ours
}
FORMER = {"draft": Effort(10_000, 100_000, 72, 320)}  # for one version


def effort_of(
    name: str,
    steps: int | None = None,
    gaussians: int | None = None,
    voxels: int | None = None,
    max_size: int | None = None,
) -> Effort:
    """Return the settings of a preset, with those figures replaced that are given.

    Raises:
        GofError: there is no preset of that name, or a figure is below its least.
    """
    given = {"iterations": steps, "gaussians": gaussians, "voxels": voxels, "longest_side": max_size}
    return replace(preset(name, PRESETS, FORMER), **{key: value for key, value in given.items() if value is not None})


STILL_STEPS = 1 / 3  # of the flame's: the paper's 10 000 and 30 000
HELD = 1.3  # times a step's time, where the flame is held over other plates and from all around (dev fires)
NATIVE_SHARE = 0.6  # of a step's time that is left with the native kernels


def step_ms(gaussians: int, pixels: int, native: bool, all_drawn: bool = False, held: bool = False) -> float:
    """Expected ms of an optimisation step on two free CPU cores.

    By hand through four runs on the demo, of 36 and of 50 frames: 60 000, 100 000, 120 000 and 300 000 Gaussians,
    windows of 53 000, 48 000, 164 000 and 603 000 pixels: 9.8, 9.1, 16.2 and 51 ms, within 13 %.

    Args:
        gaussians: in all frames together.   pixels: that are drawn.
        native: whether the renderer's native kernels run (`gof.render.backend.kernels`).
        all_drawn: whether every step has all Gaussians, and not those alone that are alight.
        held: whether every step also draws a view from where no camera stood (`gof.reconstruct.unseen`).
    """
    per_gaussian = 0.085e-3 if all_drawn else 0.025e-3
    return (
        (8.8 + per_gaussian * gaussians + 0.113e-3 * pixels) * (NATIVE_SHARE if native else 1) * (HELD if held else 1)
    )
