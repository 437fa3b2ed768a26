"""Presets: the amount of work of a reconstruction, and its time.

A preset's figures are enough for a clip of 50 frames and three cameras. A longer clip has more to learn, and gets more:
so many steps for each picture and Gaussians for each frame as keep it as good (notebook/choices.md).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from gof.core.ladder import preset
from gof.host.options import require_whole

if TYPE_CHECKING:
    from gof.dataset import Dataset

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
        GofError: one of them is no whole number, or below its least.
    """

    iterations: int
    gaussians: int
    voxels: int
    longest_side: int

    def __post_init__(self):
        for name, least in LEAST.items():
            require_whole(FLAGS[name], getattr(self, name), least)


PRESETS: dict[str, Effort] = {
    "toy": Effort(250, 6_000, 32, 160),
    "preview": Effort(2000, 60_000, 72, 320),
    "standard": Effort(6000, 120_000, 96, 640),
    "large": Effort(8000, 200_000, 112, 960),
    "full": Effort(30_000, 300_000, 128, 1280),  # the paper's steps and picture size; Gaussians and voxels are ours
}
TRIAL = "toy"  # whose figures are the same for every clip: it is for trying whether something works
LEAST_PER_PICTURE = 15  # steps
LEAST_PER_FRAME = 1360  # Gaussians
FORMER = {"draft": Effort(10_000, 100_000, 72, 320)}  # for one version


def effort_of(
    name: str,
    steps: int | None = None,
    gaussians: int | None = None,
    voxels: int | None = None,
    max_size: int | None = None,
    *,
    clip: tuple[int, int] = (0, 0),
) -> Effort:
    """Return the settings of a preset for a clip, with those figures replaced that are given.

    Args:
        clip: how many frames there are to learn from, and cameras.
    Raises:
        GofError: there is no preset of that name, or a figure is no whole number or below its least.
    """
    given = {"iterations": steps, "gaussians": gaussians, "voxels": voxels, "longest_side": max_size}
    effort = preset(name, PRESETS, FORMER)
    if name != TRIAL:
        frames, cameras = clip
        steps_for_all, gaussians_for_all = LEAST_PER_PICTURE * frames * cameras, LEAST_PER_FRAME * frames
        effort = replace(
            effort,
            iterations=max(effort.iterations, steps_for_all),
            gaussians=max(effort.gaussians, gaussians_for_all),
        )
    return replace(effort, **{key: value for key, value in given.items() if value is not None})


def size_of(dataset: Dataset) -> tuple[int, int]:
    """Return how many frames of a clip there are to learn from, and cameras: `clip` of `effort_of`."""
    return len(dataset.train_frames), len(dataset.cameras)


LIGHT_FINER = 1.5  # voxels of the light for each of the flow field's, along a side
STILL_STEPS = 1 / 3  # of the flame's: the paper's 10 000 and 30 000
UNHELD = 1 / 1.3  # times a step's time, where no flame is held over other plates and from all around (dev fires)
DRJIT = 1 / 0.6  # times a step's time, without the native kernels
REST_S = 2.0  # files that are written at the end


def step_ms(
    gaussians: int, frames: int, pixels: int, native: bool, all_drawn: bool = False, held: bool = False, together=1
) -> float:
    """Predict the ms of an optimisation step on the machine of `gof.core.time_left`.

    By hand through three runs there: the sample's `toy` and `preview` and the demo took 12, 25 and 21 ms, and through
    four on a quicker machine of 36 and 50 frames; all within 13 %. In batches of three the demo takes 0.7 of its time.

    Args:
        gaussians: in all frames together.   frames: for training.   pixels: that are drawn.
        native: whether the renderer's native kernels run (`gof.render.backend.kernels`).
        all_drawn: whether every step has all Gaussians, and not those alone that are alight.
        held: whether every step also draws a view from where no camera stood (`gof.reconstruct.unseen`).
        together: pictures of a batch (`gof.reconstruct.batches`), whose start they share.
    """
    of_gaussians = 0.18e-3 * gaussians if all_drawn else 2.5e-3 * gaussians / frames
    whole = 8.5 / together + of_gaussians + 0.145e-3 * pixels
    return whole * (1 if native else DRJIT) * (1 if held else UNHELD)


def seeing_s(frames: int, training_pixels: int, voxels: int) -> dict[str, float]:
    """Return seconds of the stages before the optimisation, on the same machine, by the titles of their bars.

    Args:
        frames: for training.   training_pixels: of all their pictures.   voxels: along the flame's longest side.
    """
    return {
        "motion": 0.9 + 0.67e-6 * training_pixels,
        "flow field": 0.2 * frames * (voxels / 72) ** 2,
        "light": 0.3 * frames * (voxels / 72) ** 2.5,
    }
