"""The paper's ablations: each leaves one part of the method out, at one place of the one code path.

| name | what changes |
|---|---|
| no-sync | every second camera's clock is believed half a frame late ("timing offsets of half a frame-time") |
| rand-flow | every seed keeps its speed and gets a random direction |
| joint-opt | the background is not known: it starts as the mean picture, its pixels are optimised with the flame |
| no-mask | no alpha loss |

The paper's JointOpt optimises static Gaussians together with the flame's instead of before it. Our background is a
plate per camera, so here the plates lose what was known of them, and learn it in their windows. Masks and optical flow
keep the fire-free plates, as the paper's do.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Literal

import numpy as np

from gof.core.gaussians import TransientGaussians

if TYPE_CHECKING:
    from gof.reconstruct.observation import Observation
    from gof.reconstruct.optimize import Schedule

Ablation = Literal["none", "no-sync", "rand-flow", "joint-opt", "no-mask"]

PLATE_RATE = 0.0025  # display values per step, the rate 3D Gaussian Splatting uses for colours


def change_times(ablation: Ablation, times_s: np.ndarray, frame_time_s: float) -> np.ndarray:
    """(C, F) picture times in s as the optimisation believes them."""
    if ablation != "no-sync":
        return times_s
    late = np.arange(len(times_s)) % 2 * (0.5 * frame_time_s)
    return times_s + late[:, None]


def change_plates(ablation: Ablation, observation: Observation) -> Observation:
    """Return the observation with the plates from which the optimisation starts."""
    if ablation != "joint-opt":
        return observation
    return replace(observation, plate=observation.image.mean(0))


def change_seeds(ablation: Ablation, seeds: TransientGaussians, rng: np.random.Generator) -> TransientGaussians:
    """Return the Gaussians that the optimisation starts from."""
    if ablation != "rand-flow":
        return seeds
    direction = rng.normal(size=seeds.velocity.shape)
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    light, gas = (direction * np.linalg.norm(v, axis=-1, keepdims=True) for v in (seeds.velocity, seeds.moving_gas))
    return replace(seeds, velocity=light, gas_velocity=gas, velocity_sd=np.full(len(seeds), np.inf))


def change_gas(ablation: Ablation, kept: TransientGaussians, of_field: TransientGaussians) -> TransientGaussians:
    """Return the result: with the gas' velocity of its seeds (`kept`), or with that of the flow field (`of_field`)."""
    return kept if ablation == "rand-flow" else of_field


def change_schedule(ablation: Ablation, schedule: Schedule) -> Schedule:
    """Weights and rates of the optimisation."""
    if ablation == "no-mask":
        return replace(schedule, alpha_loss=0.0)
    if ablation == "joint-opt":
        # Light above a plate cannot be told from it where the plate is unknown.
        rates = replace(schedule.rates, plate=PLATE_RATE)
        return replace(schedule, rates=rates, plate_loss=0.0, unseen=0.0)
    return schedule
