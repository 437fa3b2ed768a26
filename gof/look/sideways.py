"""Velocities parallel to a picture, in m/s: of a result, and the true ones at its Gaussians; and one scale for all."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gof.core.cameras import Camera
from gof.core.gaussians import TransientGaussians
from gof.dataset import Dataset
from gof.evaluate.expectation import expected_velocity
from gof.evaluate.intervals import weighted_quantile
from gof.look.velocity import ScreenVelocity, living, sideways_velocity


def of_result(gaussians: TransientGaussians, camera: Camera, time_s: float) -> ScreenVelocity:
    """What the dynamic Gaussians that live then say of the gas."""
    return sideways_velocity(living(gaussians, time_s), camera, time_s)


def true_there(gaussians: TransientGaussians, dataset: Dataset, camera: Camera, time_s: float) -> ScreenVelocity:
    """The simulated velocity at the same Gaussians, the mean over each one's extent; the dataset has to know it."""
    alive = living(gaussians, time_s)
    centre, _ = alive.at(time_s)
    true = expected_velocity(dataset.velocity.at(time_s), centre, alive.scale, alive.rotation).mean
    return sideways_velocity(alive, camera, time_s, true)


def fastest(fields: Sequence[ScreenVelocity]) -> float:
    """The speed of full brightness for all of them: the 98th percentile by opacity; > 0."""
    speed = np.concatenate([np.linalg.norm(one.flow, axis=-1).ravel() for one in fields])
    weight = np.concatenate([one.alpha.ravel() for one in fields])
    return max(float(weighted_quantile(speed, weight, 0.98)), 1e-9) if weight.any() else 1.0


def unit(dataset: Dataset) -> str:
    """Of speeds on pictures of a dataset, whose poses may have no known length."""
    return "m/s" if dataset.description.in_metres else "units/s"
