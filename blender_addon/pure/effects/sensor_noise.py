"""Sensor noise: shot noise of the photons and read noise of the electronics, before the display transform.

EXR files keep the true light. The noise of a picture depends on seed, camera and frame alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...core.checked_json import require
from ..timing import Picture


@dataclass(frozen=True)
class Settings:
    electrons: float = 4000.0
    """Photo-electrons that light of 1 frees in a pixel: fewer is noisier."""
    read_noise: float = 4.0
    """Standard deviation of the readout, electrons."""

    def __post_init__(self):
        require(self.electrons > 0, "effects.sensor_noise.electrons", "positive", self.electrons)
        require(self.read_noise >= 0, "effects.sensor_noise.read_noise", "0 or more", self.read_noise)


def expose(light: np.ndarray, settings: Settings, picture: Picture) -> np.ndarray:
    """Shot noise as a normal variable of the right variance, which holds from about 10 electrons on."""
    rng = np.random.default_rng([picture.seed, 5, picture.camera, picture.frame + 1])
    mean = np.clip(light, 0, None) * settings.electrons
    noise = rng.standard_normal(light.shape) * np.sqrt(mean + settings.read_noise**2)
    return np.clip((mean + noise) / settings.electrons, 0, None)
