"""Colours that a clip's fire has: Gaussians are drawn to them.

Cameras on one side see the sum of Gaussians that lie one behind another: a green one and a red one look orange. From
the side, both are seen.

Not all that a picture shows less its plate is a colour of the fire. White pixels have lost theirs. And some cameras
press together what is bright, red first because fire has most of it: before a wall that the fire lights, light has more
green than red then. Pixels that are not so bright and outshine their plate do not: where they say that a fire is not
green, they alone say what its colours are, and it is held to them to the last step, as its pictures ask for green.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt, gaussian_filter

from gof.core.colour import linear_to_srgb, srgb_to_linear
from gof.reconstruct.observation import Observation, light_above

CELLS = 96  # along each side of the map of colours
FAINT = 0.15  # display value of the brightest channel; noise colours what is darker
RARE = 1e-3  # share of the flame's pixels that may have colours which are none of the fire's
CLIPPED, ENOUGH = 0.94, 0.01  # display value from which a channel tells no colour; share of pixels that must be below
BRIGHT, OUTSHINES = 0.8, 2.0  # display value from which red is pressed; linear light over its plate's
PRESSED, RARELY = 0.02, 0.1  # share of unclipped pixels greener than red; of it, among clear ones
MARGIN = 4  # cells around the fire's colours that are its own, too: what lies nearer costs own pictures and motion
MOST_PICTURES = 200  # that are looked at, spread over the clip


@dataclass(frozen=True)
class Palette:
    """A fire's colours, whatever their brightness.

    Attributes:
        nearest: (CELLS, CELLS, 2) int: of each cell of red and green over the sum of all three channels of display
            values, the nearest one within MARGIN of the fire's; itself where it is one.
        held: whether Gaussians are drawn to it to the last step.
    """

    nearest: np.ndarray
    held: bool = False

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

    Clipped pixels count only where hardly any others are.
    """
    every, unclipped, clear = _count_colors(observation)
    if not every.any():
        return None
    enough = ENOUGH * every.sum()
    counts = unclipped if unclipped.sum() > enough else every
    red, green = np.indices(counts.shape)
    greener = (green > red) & (green > CELLS - 1 - red - green)
    share, clear_share = (kind[greener].sum() / max(kind.sum(), 1) for kind in (counts, clear))
    pressed = clear.sum() > enough and share > PRESSED and clear_share < RARELY * share
    if pressed:
        counts = np.where(greener, 0, clear)
    counts = gaussian_filter(counts, 1.0)
    most = np.sort(counts, axis=None)[::-1]
    rarest = most[min(np.searchsorted(np.cumsum(most), (1 - RARE) * most.sum()), most.size - 1)]
    others = counts < max(rarest, np.finfo(float).tiny)
    others = (distance_transform_edt(others) > MARGIN) | (greener & pressed)
    cells = distance_transform_edt(others, return_distances=False, return_indices=True)
    return Palette(np.moveaxis(cells, 0, -1), pressed)


def _count_colors(observation: Observation) -> np.ndarray:
    """Return (3, CELLS, CELLS) how many of the flame's pixels have each colour: all, unclipped and clear ones."""
    delivered = np.argwhere(observation.delivered)
    every, unclipped, clear = counts = np.zeros((3, CELLS, CELLS))
    for f, c in delivered[:: -(-len(delivered) // MOST_PICTURES) or 1]:
        flame = observation.mask[f, c]
        seen, plate = observation.image[f, c][flame], observation.plate[c][flame]
        brightest, light = seen.max(1), light_above(seen, plate)
        outshines = light.max(1) > OUTSHINES * srgb_to_linear(plate).max(1)
        shown = linear_to_srgb(light)
        lit = shown.max(1) > FAINT
        kinds = (every, lit), (unclipped, lit & (brightest < CLIPPED)), (clear, lit & (brightest < BRIGHT) & outshines)
        for kind, counted in kinds:
            kind += np.bincount(_cells(shown[counted]) @ (CELLS, 1), minlength=CELLS**2).reshape(kind.shape)
    return counts


def _cells(color: np.ndarray) -> np.ndarray:
    """Return the cell (N, 2) of each colour (N, 3)."""
    total = np.maximum(color.sum(1, keepdims=True), np.finfo(np.float32).tiny)
    return np.clip((color[:, :2] / total * CELLS).astype(int), 0, CELLS - 1)


def _shares(cell: np.ndarray) -> np.ndarray:
    """Return (N, 3) > 0 shares of the channels in the middle of each cell (N, 2)."""
    two = (cell + 0.5) / CELLS
    return np.column_stack([two, np.maximum(1 - two.sum(1), 0.5 / CELLS)])
