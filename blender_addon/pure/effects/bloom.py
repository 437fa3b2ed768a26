"""Bloom: the lens scatters a little of the light around what is bright. EXR files keep the true light.

Away from a bright point the scattered light falls with the third power of the distance: between the squares and cubes
that are measured on eyes (CIE's standard glare observer) and lenses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...core.checked_json import require
from ..timing import Picture


@dataclass(frozen=True)
class Settings:
    amount: float = 0.08
    """Share of all light that is scattered."""
    core: float = 0.01
    """Radius around a bright point in which half as much glow is left, of the picture's longer side (roughly)."""

    def __post_init__(self):
        require(0 <= self.amount <= 1, "effects.bloom.amount", "in [0, 1]", self.amount)
        require(0 < self.core <= 1, "effects.bloom.core", "in (0, 1]", self.core)


def expose(light: np.ndarray, settings: Settings, picture: Picture) -> np.ndarray:
    height, width = light.shape[:2]
    down, across = (np.minimum(index, 2 * side - index) for side in (height, width) for index in [np.arange(2 * side)])
    core = settings.core * max(height, width)
    spread = ((down[:, None] ** 2 + across**2) / core**2 + 1.0) ** -1.5
    shape = spread.shape  # twice the picture's: nothing comes round from the other side
    glow = np.fft.irfft2(
        np.fft.rfft2(light, shape, axes=(0, 1)) * np.fft.rfft2(spread / spread.sum())[..., None], shape, axes=(0, 1)
    )[:height, :width]
    return ((1 - settings.amount) * light + settings.amount * np.maximum(glow, 0)).astype(light.dtype)
