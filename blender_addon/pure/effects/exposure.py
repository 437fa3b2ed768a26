"""Exposure differences: every camera has its own constant error and drift. EXR files keep the true light."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...core.checked_json import require
from ..timing import Picture


@dataclass(frozen=True)
class Settings:
    spread_ev: float = 0.3
    """Standard deviation between cameras, stops."""
    drift_ev_per_s: float = 0.0
    """Change over the clip in all cameras, stops per second."""

    def __post_init__(self):
        require(self.spread_ev >= 0, "effects.exposure.spread_ev", "0 or more", self.spread_ev)


def stops(settings: Settings, picture: Picture) -> float:
    """Exposure error of a picture in stops; the plate (frame -1) counts as frame 0."""
    own = settings.spread_ev * np.random.default_rng([picture.seed, 4, picture.camera]).standard_normal()
    return float(own + settings.drift_ev_per_s * max(picture.frame, 0) / picture.fps)


def expose(light: np.ndarray, settings: Settings, picture: Picture) -> np.ndarray:
    return light * 2.0 ** stops(settings, picture)
