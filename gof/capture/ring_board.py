"""A board with a ring of LEDs, of which one is lit at a time, and a binary counter of its rounds: RocSync."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from gof.capture.template import BUILT_IN, BoardTemplate, MarkerEntry, Point, require_places
from gof.core.errors import DataFormatError
from gof.core.files import read_json
from gof.core.records import read_record

RING_BOARDS = ("rocsync",)
MOST_LEDS = 1000
FARTHEST_MM = 10_000.0
LEAST_STEP_US, MOST_STEP_US = 1.0, 1e6
DARK_RING = 0.9  # of the ring's radius: bare board, beside which an LED is bright or not
DARK_ROW = -1.0  # of the counter's spacing, across its row, away from the marker


@dataclass(frozen=True)
class RingEntry:
    """The ring of a template file: LED 0 is at its top, seen from the front; `clockwise` the order in which they light,
    each for `step_us`."""

    centre: Point
    radius: float
    count: int
    clockwise: bool
    step_us: float


@dataclass(frozen=True)
class CounterEntry:
    """The counter of a template file: the LED of its highest bit, and the step to the next lower one."""

    bits: int
    highest: Point
    step: Point


@dataclass(frozen=True)
class RingBoardFile:
    """A ring board as JSON: places in mm from the board's upper left corner, x right, y down; see `RingBoard`.

    Attributes:
        marker_corner: place of the marker's first corner.
        corners: LEDs that are always lit.
    """

    SCHEMA: ClassVar[str] = "gof-ring-board"
    VERSION: ClassVar[int] = 1

    name: str
    marker: MarkerEntry
    marker_corner: Point
    ring: RingEntry
    counter: CounterEntry
    corners: tuple[Point, ...]
    outline: tuple[Point, ...]
    origin: str = ""

    def __post_init__(self):
        if not self.marker.side_m or self.marker.side_m <= 0:
            raise DataFormatError("'marker.side_m' must be above 0: places are in millimetres")
        ring = self.ring
        if not 8 <= ring.count <= MOST_LEDS:
            raise DataFormatError(f"'ring.count' must be 8 to {MOST_LEDS}; it is {ring.count}")
        if not (0 < ring.radius <= FARTHEST_MM and LEAST_STEP_US <= ring.step_us <= MOST_STEP_US):
            raise DataFormatError(
                f"'ring.radius' must be above 0 and at most {FARTHEST_MM:g} mm, 'ring.step_us' {LEAST_STEP_US:g} to "
                f"{MOST_STEP_US:g}"
            )
        places = (self.marker_corner, ring.centre, self.counter.highest, self.counter.step)
        require_places("marker_corner, ring.centre and counter", places, FARTHEST_MM)
        require_places("corners", self.corners, FARTHEST_MM)
        require_places("outline", self.outline, FARTHEST_MM)
        if len(self.outline) < 3:
            raise DataFormatError("'outline' must have three places or more")
        if not 1 <= self.counter.bits <= 24:
            raise DataFormatError("'counter.bits' must be 1 to 24")


@dataclass(frozen=True)
class RingBoard:
    """A ring board. Coordinates are in marker sides: origin at the marker's first corner, x along its top edge, y down.

    LED i of the ring is lit from `i * step_us` after the start of a round on, for `step_us`; in round n the counter
    shows n. So LED i of round n means the time `n * period_us + i * step_us`.

    Args:
        name: of the template.
        marker_id, inverted: as of `BoardTemplate`.
        led_xy: (L, 2) the ring's LEDs, in the order in which they light; led_dark (L, 2) bare board beside each.
        counter_xy: (B, 2) the counter's LEDs, lowest bit first; counter_dark (B, 2) bare board beside each.
        corner_xy: (4, 2) LEDs that are always lit.
        outline: (N, 2) polygon around the board.
        step_us: for which each LED is lit.
    """

    name: str
    marker_id: int
    inverted: bool
    led_xy: np.ndarray
    led_dark: np.ndarray
    counter_xy: np.ndarray
    counter_dark: np.ndarray
    corner_xy: np.ndarray
    outline: np.ndarray
    step_us: float

    @property
    def period_us(self) -> float:
        """Return the period of a round."""
        return self.step_us * len(self.led_xy)

    @classmethod
    def load(cls, name: str | Path) -> RingBoard:
        """Return a built-in board by name ("rocsync") or a JSON file.

        Raises:
            DataFormatError: no such file, or a field is missing or malformed.
        """
        path = Path(__file__).with_name(f"{name}.json") if str(name) in RING_BOARDS else Path(name)
        file = read_record(RingBoardFile, path)
        side_m = file.marker.side_m
        assert side_m is not None, "RingBoardFile refuses markers without a size"

        def places(xy):
            return (np.asarray(xy, np.float64) - file.marker_corner) / (1000 * side_m)

        ring, counter = file.ring, file.counter
        angle = 2 * np.pi * np.arange(ring.count) / ring.count * (1 if ring.clockwise else -1)
        spoke = ring.radius * np.stack([np.sin(angle), -np.cos(angle)], 1)
        step = np.array(counter.step)
        row = counter.highest + step * np.arange(counter.bits)[::-1, None]
        return cls(
            name=file.name,
            marker_id=file.marker.id,
            inverted=file.marker.inverted,
            led_xy=places(ring.centre + spoke),
            led_dark=places(ring.centre + DARK_RING * spoke),
            counter_xy=places(row),
            counter_dark=places(row + DARK_ROW * np.array([-step[1], step[0]])),
            corner_xy=places(file.corners),
            outline=places(file.outline),
            step_us=ring.step_us,
        )


def load_board(name: str | Path) -> BoardTemplate | RingBoard:
    """Return a board of either kind: built-in, or a JSON file that says by its schema which it is.

    Raises:
        DataFormatError: as `BoardTemplate.load` and `RingBoard.load`.
    """
    if str(name) in BUILT_IN:
        return BoardTemplate.load(name)
    if str(name) in RING_BOARDS:
        return RingBoard.load(name)
    content = read_json(Path(name))
    ring = isinstance(content, dict) and content.get("schema") == RingBoardFile.SCHEMA
    return RingBoard.load(name) if ring else BoardTemplate.load(name)
