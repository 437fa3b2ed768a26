"""Auto exposure: all cameras are set, once for the clip, so that the flame's bright parts come out nearly white.

Metered on the flame in the first picture of the first camera. EXR files keep the true light.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...core.checked_json import require


@dataclass(frozen=True)
class Settings:
    bright: float = 8.0
    """Linear light to which the flame's bright parts are brought; Filmic shows 8 a little below white."""
    share: float = 0.05
    """Share of the flame's pixels that is brighter than that."""
    most_ev: float = 6.0
    """Largest change either way, stops."""

    def __post_init__(self):
        require(self.bright > 0, "effects.auto_exposure.bright", "positive", self.bright)
        require(0 <= self.share < 1, "effects.auto_exposure.share", "in [0, 1)", self.share)
        require(0 < self.most_ev <= 20, "effects.auto_exposure.most_ev", "in (0, 20]", self.most_ev)


def gain(settings: Settings, flame: np.ndarray) -> float:
    """Factor on all light for a first picture whose flame alone is (N, 3), linear, N >= 0 visible pixels."""
    if not len(flame):
        return 1.0
    bright = float(np.quantile(flame.max(-1), 1 - settings.share))
    return float(np.clip(settings.bright / max(bright, 1e-9), 2.0**-settings.most_ev, 2.0**settings.most_ev))
