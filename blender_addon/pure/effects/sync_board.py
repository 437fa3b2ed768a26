"""LED sync board: the board of `gof capture` in every picture, each LED as lit as in that line's exposure.

The board is drawn over the rendered light: it lights nothing, and nothing stands in front of it. On the plate its LEDs
are off. EXR files do not have it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...core.checked_json import require
from .. import led_board
from ..timing import ExposureTiming, Picture

SHOWS_BOARD = True


@dataclass(frozen=True)
class Settings:
    position: tuple[float, float, float] = (0.0, -0.45, 0.13)
    """Centre of the board, world metres."""
    facing_deg: float = -90.0
    """Direction the board looks to, counter-clockwise from +X. A camera behind it does not see it."""
    turn_deg: float = 0.0
    """Turn of the board in its plane, clockwise as cameras see it. Its strips should lie along the readout."""
    marker_m: float = 0.06
    """Side of the marker, metres: the board is 6.8 of them wide and 4.2 high."""
    brightness: float = 4.0
    """Light of an LED that is lit for the whole exposure; from 1 on it saturates a Standard display."""
    paper: float = 0.5
    """Light of the marker's white."""
    exposure_s: float = 0.001
    """Exposure of the board where no effect opens the shutter, centred on the instant of the picture."""
    tick_us: float = 400.0
    """Tick of the firmware. No frame time may be a multiple of five ticks: at 25, 50, 100 or 250 fps take 410."""
    start_s: float = 1.0
    """Reading of the board's clock at time 0."""

    def __post_init__(self):
        require(self.marker_m > 0, "effects.sync_board.marker_m", "positive", self.marker_m)
        require(self.brightness > 0, "effects.sync_board.brightness", "positive", self.brightness)
        require(self.paper > 0, "effects.sync_board.paper", "positive", self.paper)
        require(self.exposure_s > 0, "effects.sync_board.exposure_s", "positive", self.exposure_s)
        require(50 <= self.tick_us <= 100000, "effects.sync_board.tick_us", "between 50 and 100000", self.tick_us)

    def plane(self) -> np.ndarray:
        """Return (3, 3): takes (x, y, 1) on the board to the world."""
        facing, turn = math.radians(self.facing_deg), math.radians(self.turn_deg)
        right, down = np.array([-math.sin(facing), math.cos(facing), 0.0]), np.array([0.0, 0.0, -1.0])
        x = self.marker_m * (math.cos(turn) * right + math.sin(turn) * down)
        y = self.marker_m * (math.cos(turn) * down - math.sin(turn) * right)
        return np.stack([x, y, self.position - led_board.CENTRE[0] * x - led_board.CENTRE[1] * y], axis=1)


def lit_shares(settings: Settings, picture: Picture, when: ExposureTiming) -> np.ndarray:
    """Return (21, lines): for what share of its exposure each line of a picture sees each output lit.

    Args:
        when: timing of the picture, all its effects together.
    """
    length = when.open or settings.exposure_s
    first = settings.start_s + picture.frame / picture.fps + when.delay + (when.open - length) / 2
    return led_board.lit_share(first + when.line * np.arange(picture.lines), length, 1e-6 * settings.tick_us)
