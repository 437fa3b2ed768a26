"""The paper's ablations: each leaves one part of the method out, at one place of the one code path.

| name | what changes |
|---|---|
| no-sync | the clock of every second camera is believed half a frame time late ("timing offsets of half a frame-time") |
| rand-flow | every seed keeps its speed and gets a random direction |
| joint-opt | the background is not known beforehand: it starts as the mean picture, and its pixels are optimised together with the flame |
| no-mask | no alpha loss |

The paper's JointOpt optimises static Gaussians together with the flame's instead of before it. Our background is a plate per
camera, so here the plates lose what was known of them. Masks and optical flow keep the fire-free plates, as the paper's do.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from gof.gaussians import TransientGaussians

if TYPE_CHECKING:
    from gof.reconstruct.motion import Motion
    from gof.reconstruct.optimize import Schedule

PLATE_RATE = 0.0025  # display values per step, the rate 3D Gaussian Splatting uses for colours


def change_times(ablation: str, times_s: np.ndarray, frame_time_s: float) -> np.ndarray:
    """(C, F) picture times in s as the optimisation believes them."""
    late = np.arange(len(times_s)) % 2 * (0.5 * frame_time_s)
    return times_s + late[:, None] if ablation == "no-sync" else times_s


def change_plates(ablation: str, motion: Motion) -> Motion:
    """What the flame is drawn over when the optimisation starts."""
    return replace(motion, plate=motion.image.mean(0)) if ablation == "joint-opt" else motion


def change_seeds(ablation: str, seeds: TransientGaussians, rng: np.random.Generator) -> TransientGaussians:
    """The Gaussians that the optimisation starts from."""
    if ablation != "rand-flow":
        return seeds
    direction = rng.normal(size=seeds.velocity.shape)
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    return replace(seeds, velocity=direction * np.linalg.norm(seeds.velocity, axis=-1, keepdims=True))


def change_schedule(ablation: str, schedule: Schedule) -> Schedule:
    """Weights and rates of the optimisation."""
    if ablation == "no-mask":
        return replace(schedule, alpha_loss=0.0)
    return replace(schedule, plate=PLATE_RATE) if ablation == "joint-opt" else schedule
