"""The LED board that tells cameras the time: its layout, what the firmware lights when, and how a camera sees it.

Lengths are in marker sides, x along the marker's top edge and y down its left edge, as in the template "gof_board" of
`gof capture`. Outputs are numbered as in the firmware: strips 0 to 4, Gray bits 5 to 19, disambiguation LED 20.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

STRIPS, GRAY_BITS, OUTPUTS = 5, 15, 21
TICKS_PER_SLOT, TICKS_PER_PERIOD, DISAMBIGUATION_TICK = 2, 10, 4

BOXES = ((-0.7, -0.7, 1.7, 1.7), (-2.9, 1.7, 3.9, 3.5))
"""Left, top, right and bottom of the two rectangles that make the board: round the marker, and round the strips."""
CENTRE = (0.5, 1.4)
STRIP_X, STRIP_Y = (-2.7, 3.7), 2.0 + 0.3 * np.arange(STRIPS)
LED_XY = 0.5 + 0.425 * np.clip(np.abs(np.arange(GRAY_BITS + 1)[:, None] - (6, 10)) - 4, -2, 2)
"""A ring round the marker: from the lower right corner to the left, up, to the right and down."""
STRIP_HALF_WIDTH, LED_RADIUS = 0.03, 0.045
MARKER = np.pad([[1, 0, 1, 1], [0, 1, 0, 1], [0, 0, 1, 1], [0, 0, 1, 0]], 1) == 0
"""Light cells of ArUco DICT_4X4_50 number 0, inverted."""

MASK_MARGIN, MASK_RAMP = 0.25, 0.35  # around the board, as `gof capture annotate` makes it
SAMPLES = 4  # points along each side of a pixel

BEHIND, BOARD, PAPER, LAMPS = 0, 1, 2, 3
"""A point shows: the scene behind the board, the dark board, a light cell of the marker; from 3 on, output - 3."""


def lit(tick: np.ndarray) -> np.ndarray:
    """Return (N, 21) bool: outputs that are lit in ticks (N,) int; the counter wraps, also below tick 0."""
    count, phase = np.divmod(np.asarray(tick)[:, None], TICKS_PER_PERIOD)
    count %= 1 << GRAY_BITS
    strips = phase // TICKS_PER_SLOT == np.arange(STRIPS)
    gray = (count ^ count >> 1) >> np.arange(GRAY_BITS) & 1
    late = (count + (phase >= DISAMBIGUATION_TICK)) & 1
    return np.hstack([strips, gray, late]).astype(bool)


def lit_share(start: np.ndarray, length: float, tick: float) -> np.ndarray:
    """Return (21, N): for what share of the exposures [start, start + length] each output is lit; start (N,), all in
    s."""
    ticks = np.arange(np.floor(start.min() / tick), np.floor((start.max() + length) / tick) + 1).astype(np.int64)
    begin, end = np.maximum(start[:, None], ticks * tick), np.minimum(start[:, None] + length, (ticks + 1) * tick)
    return (np.clip(end - begin, 0, None) / length @ lit(ticks)).T


@dataclass(frozen=True)
class Footprint:
    """A board in one camera's picture, nothing of it where the camera sees its back.

    Args:
        pixels: row and column numbers, (P,) each, of the pixels near the board.
        shows: (SAMPLES^2, P) uint8, what the points of these pixels show.
        mask: (H, W) how much a pixel belongs to the board and its surroundings, 0 to 1.
    """

    pixels: tuple[np.ndarray, np.ndarray]
    shows: np.ndarray
    mask: np.ndarray

    def over(self, light: np.ndarray, shine: np.ndarray, line: np.ndarray) -> np.ndarray:
        """Return the picture (H, W, 3) with the board over it.

        Args:
            shine: (24, L) light of all that a point may show, 0 for BEHIND, in each of the sensor's lines.
            line: (H, W) number of the line that a pixel belongs to.
        """
        seen = light.copy()
        behind = (self.shows == BEHIND).mean(0)
        seen[self.pixels] = behind[:, None] * light[self.pixels] + shine[self.shows, line[self.pixels]].mean(0)[:, None]
        return seen


def footprint(to_image: np.ndarray, width: int, height: int) -> Footprint:
    """Return where the board is in a picture.

    Args:
        to_image: (3, 3), takes (x, y, 1) on the board to pixels times their depth (> 0).
        width, height: of the picture, pixels.
    """
    mask, reach = np.zeros((height, width)), MASK_MARGIN + MASK_RAMP
    left, top, right, bottom = np.min(BOXES, 0)[:2].tolist() + np.max(BOXES, 0)[2:].tolist()
    x, y = np.meshgrid((left - reach, right + reach), (top - reach, bottom + reach))
    column, row, depth = to_image @ np.stack([x.ravel(), y.ravel(), np.ones(4)])
    if depth.min() <= 0 or np.linalg.det(to_image) <= 0:
        return Footprint(np.nonzero(mask), np.zeros((SAMPLES**2, 0), np.uint8), mask)
    box = _around(row / depth, height), _around(column / depth, width)
    to_board, rows_columns = np.linalg.inv(to_image), np.mgrid[box]
    mask[box] = np.clip(1 - (_distance(*_places(to_board, rows_columns + 0.5)) - MASK_MARGIN) / MASK_RAMP, 0, 1)
    pixels = rows_columns[:, mask[box] > 0]
    fine = (np.arange(SAMPLES) + 0.5) / SAMPLES
    shows = [_shown(*_places(to_board, pixels + [[row], [column]])) for row in fine for column in fine]
    return Footprint(tuple(pixels), np.stack(shows), mask)


def _around(values: np.ndarray, size: int) -> slice:
    low, high = np.clip([np.floor(values.min()), np.ceil(values.max())], 0, size).astype(int)
    return slice(low, high)


def _places(to_board: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """x and y on the board of points (2, ...) of the picture, rows and columns."""
    x, y, scale = np.tensordot(to_board, np.stack([points[1], points[0], np.ones(points[0].shape)]), 1)
    return x / scale, y / scale


def _distance(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return distance to the board, 0 on it."""
    boxes = [
        np.hypot(np.maximum(np.maximum(x0 - x, x - x1), 0), np.maximum(np.maximum(y0 - y, y - y1), 0))
        for x0, y0, x1, y1 in BOXES
    ]
    return np.minimum(*boxes)


def _shown(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """uint8: what places on the board's plane show."""
    shown = np.where(_distance(x, y) > 0, BEHIND, BOARD).astype(np.uint8)
    marker = (x >= 0) & (x < 1) & (y >= 0) & (y < 1)
    cell = (np.stack([y[marker], x[marker]]) * len(MARKER)).astype(int)
    shown[marker] = np.where(MARKER[tuple(cell)], PAPER, BOARD)
    on_strips = (x >= STRIP_X[0]) & (x <= STRIP_X[1])
    for number, strip_y in enumerate(STRIP_Y):
        shown[on_strips & (np.abs(y - strip_y) <= STRIP_HALF_WIDTH)] = LAMPS + number
    for number, (led_x, led_y) in enumerate(LED_XY, STRIPS):
        shown[np.hypot(x - led_x, y - led_y) <= LED_RADIUS] = LAMPS + number
    return shown
