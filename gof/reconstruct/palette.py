"""Colours that a clip's fire has: Gaussians are drawn to them.

Cameras on one side see the sum of Gaussians that lie one behind another: a green one and a red one look orange. From
the side, both are seen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt, gaussian_filter

from gof.core.colour import linear_to_srgb
from gof.reconstruct.observation import Observation, light_above

CELLS = 96  # along each side of the map of colours
FAINT = 0.15  # display value of the brightest channel; noise colours what is darker
RARE = 1e-3  # share of the flame's pixels that may have colours which are none of the fire's
CLIPPED, ENOUGH = 0.94, 0.01  # display value from which a channel tells no colour; share of pixels that must be below
MARGIN = 4  # cells around the fire's colours that are its own, too: what lies nearer costs own pictures and motion
MOST_PICTURES = 200  # that are looked at, spread over the clip


@dataclass(frozen=True)
class Palette:
    """A fire's colours, whatever their brightness.

    Attributes:
        nearest: (CELLS, CELLS, 2) int: of each cell of red and green over the sum of all three channels of display
            values, the nearest one within MARGIN of the fire's; itself where it is one.
    """

    nearest: np.ndarray

    def find(self, color: np.ndarray) -> np.ndarray:
        """Return the fire's colour that is nearest to each of (N, 3) display values, its brightest channel 1; those
        that the fire has are only brightened. Black is taken for blue."""
        total = color.sum(1, keepdims=True)
        cell = _cells(color)
        own = self.nearest[tuple(cell.T)]
        moved = (own != cell).any(1) | (total[:, 0] <= 0)
        share = np.where(moved[:, None], _shares(own), color / np.where(total > 0, total, 1))
        return (share / share.max(1, keepdims=True)).astype(np.float32)


def find_palette(observation: Observation) -> Palette | None:
    """Return the colours of a clip's flame, of its light alone without its plates'; None where nothing burns.

    White pixels have lost theirs, and less a bright plate they are green: they count only where hardly any other is.
    """
    delivered = np.argwhere(observation.delivered)
    every, clear = np.zeros((2, CELLS, CELLS))
    for f, c in delivered[:: -(-len(delivered) // MOST_PICTURES) or 1]:
        flame = observation.mask[f, c]
        shown = linear_to_srgb(light_above(observation.image[f, c], observation.plate[c])[flame])
        unclipped = observation.image[f, c][flame].max(1) < CLIPPED
        for counts, counted in ((every, shown.max(1) > FAINT), (clear, (shown.max(1) > FAINT) & unclipped)):
            np.add.at(counts, tuple(_cells(shown[counted]).T), 1)
    if not every.any():
        return None
    counts = clear if clear.sum() > ENOUGH * every.sum() else every
    counts = gaussian_filter(counts, 1.0)
    most = np.sort(counts, axis=None)[::-1]
    rarest = most[min(np.searchsorted(np.cumsum(most), (1 - RARE) * most.sum()), most.size - 1)]
    others = counts < max(rarest, np.finfo(float).tiny)
    others = distance_transform_edt(others) > MARGIN
    cells = distance_transform_edt(others, return_distances=False, return_indices=True)
    return Palette(np.moveaxis(cells, 0, -1))


def _cells(color: np.ndarray) -> np.ndarray:
    """Return the cell (N, 2) of each colour (N, 3)."""
    total = np.maximum(color.sum(1, keepdims=True), np.finfo(np.float32).tiny)
    return np.clip((color[:, :2] / total * CELLS).astype(int), 0, CELLS - 1)


def _shares(cell: np.ndarray) -> np.ndarray:
    """Return (N, 3) > 0 shares of the channels in the middle of each cell (N, 2)."""
    two = (cell + 0.5) / CELLS
    return np.column_stack([two, np.maximum(1 - two.sum(1), 0.5 / CELLS)])
