"""Geometry of an LED board relative to its marker, as JSON; and a printable drawing of it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar
from xml.sax.saxutils import escape

import numpy as np

from gof.core.errors import DataFormatError
from gof.core.records import read_record

BUILT_IN = ("paper_rig", "gof_board")
MOST_BITS = 24
DISAMBIGUATION = -1  # instead of a Gray bit


Point = tuple[float, float]


MARKERS = 50  # of DICT_4X4_50
FARTHEST = 1000.0  # marker sides: places beyond are a slip
SIDES_M = 1e-3, 100.0


def require_places(what: str, places: Iterable[Point], farthest: float = FARTHEST) -> None:
    """Raise DataFormatError: a place of a board lies beyond any board."""
    for place in places:
        if not all(abs(value) <= farthest for value in place):
            raise DataFormatError(f"'{what}' has a place {farthest:g} or more away: {list(place)}")


@dataclass(frozen=True)
class MarkerEntry:
    """The marker of a template file: ArUco number, light on dark, side in metres where it is known."""

    id: int
    inverted: bool
    side_m: float | None = None

    def __post_init__(self):
        if not 0 <= self.id < MARKERS:
            raise DataFormatError(f"'marker.id' must be 0 to {MARKERS - 1} (DICT_4X4_50); it is {self.id}")
        least, most = SIDES_M
        if self.side_m is not None and not least <= self.side_m <= most:
            raise DataFormatError(f"'marker.side_m' must be {least:g} to {most:g} metres; it is {self.side_m:g}")


@dataclass(frozen=True)
class LedEntry:
    """An LED of a template file: its Gray bit (null = the disambiguation LED) and place in marker sides."""

    bit: int | None
    xy: Point


@dataclass(frozen=True)
class StripEntry:
    """A strip of a template file: its slot, and its first and last lit point in marker sides."""

    slot: int
    ends: tuple[Point, Point]


@dataclass(frozen=True)
class TemplateFile:
    """A board template as JSON; see `BoardTemplate`. The built-in ones say in "origin" where they are from."""

    SCHEMA: ClassVar[str] = "gof-led-board"
    VERSION: ClassVar[int] = 1

    name: str
    marker: MarkerEntry
    leds: tuple[LedEntry, ...]
    strips: tuple[StripEntry, ...]
    outline: tuple[Point, ...]
    disambiguation_lead: float = 0.6
    origin: str = ""

    def __post_init__(self):
        if sorted(strip.slot for strip in self.strips) != list(range(5)):
            raise DataFormatError("'strips' must be five, with slots 0..4")
        bits = sorted(led.bit for led in self.leds if led.bit is not None)
        if not bits or bits != list(range(len(bits))):
            raise DataFormatError("'leds' must hold each Gray bit from 0 up once")
        if len(bits) > MOST_BITS:
            raise DataFormatError(f"'leds' must hold {MOST_BITS} Gray bits at most")
        if not 0 < self.disambiguation_lead < 1:
            raise DataFormatError("'disambiguation_lead' must be between 0 and 1, of a period")
        require_places("leds", (led.xy for led in self.leds))
        require_places("strips", (end for strip in self.strips for end in strip.ends))
        require_places("outline", self.outline)
        if len(self.outline) < 3:
            raise DataFormatError("'outline' must have three places or more")


@dataclass(frozen=True)
class BoardTemplate:
    """An LED board. Coordinates are in marker sides: origin at the marker's first corner, x along its top edge, y down
    its left edge (as the marker is printed, whichever way the board hangs).

    Args:
        name: of the template.
        marker_id: in DICT_4X4_50.
        inverted: light marker squares on a dark board.
        led_xy: (L, 2) LED positions.
        led_bit: (L,) Gray bit of each LED; -1 for the disambiguation LED.
        strip_ends: (S, 2, 2) first and last lit point of each strip.
        strip_slot: (S,) slot in which each strip is lit.
        outline: (N, 2) polygon around the board, for masks and drawings.
        disambiguation_lead: how many periods before the count the disambiguation LED turns, see
            firmware/core/gof_board.h.
    """

    name: str
    marker_id: int
    inverted: bool
    led_xy: np.ndarray
    led_bit: np.ndarray
    strip_ends: np.ndarray
    strip_slot: np.ndarray
    outline: np.ndarray
    disambiguation_lead: float = 0.6

    @property
    def gray_bits(self) -> int:
        """Number of Gray bits that have an LED."""
        return int(self.led_bit.max()) + 1

    @classmethod
    def load(cls, name: str | Path) -> BoardTemplate:
        """Return a built-in template by name ("paper_rig", "gof_board") or a JSON file.

        Raises:
            DataFormatError: no such file, or a field is missing or malformed.
        """
        path = Path(__file__).with_name(f"{name}.json") if str(name) in BUILT_IN else Path(name)
        file = read_record(TemplateFile, path)
        return cls(
            name=file.name,
            marker_id=file.marker.id,
            inverted=file.marker.inverted,
            led_xy=np.array([led.xy for led in file.leds], np.float64),
            led_bit=np.array([DISAMBIGUATION if led.bit is None else led.bit for led in file.leds]),
            strip_ends=np.array([strip.ends for strip in file.strips], np.float64),
            strip_slot=np.array([strip.slot for strip in file.strips]),
            outline=np.array(file.outline, np.float64),
            disambiguation_lead=file.disambiguation_lead,
        )


def draw_svg(template: BoardTemplate, marker_side_mm: float) -> str:
    """Printable SVG at true size: marker, LED holes with labels, strip positions, outline. Cut the strips' length to
    what the drawing shows and mount them flush with the front."""
    import cv2

    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    cells = cv2.aruco.generateImageMarker(dictionary, template.marker_id, 6) > 0  # one pixel per cell
    points = np.vstack([template.outline, template.strip_ends.reshape(-1, 2), template.led_xy, [[0, 0], [1, 1]]])
    low, high = points.min(0) - 0.2, points.max(0) + 0.2

    def mm(p):
        return (np.asarray(p) - low) * marker_side_mm

    width, height = (high - low) * marker_side_mm
    light, dark = "#fff", "#111"
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.2f}mm" height="{height:.2f}mm" '
        f'viewBox="0 0 {width:.2f} {height:.2f}" font-family="sans-serif">',
        f"<title>LED board {escape(template.name)}, marker side {marker_side_mm:g} mm</title>",
        '<polygon points="'
        + " ".join(f"{x:.2f},{y:.2f}" for x, y in mm(template.outline))
        + f'" fill="{dark if template.inverted else light}"/>',
    ]
    cell = marker_side_mm / 6
    x0, y0 = mm((0, 0))
    for (row, column), white in np.ndenumerate(cells):
        out.append(
            f'<rect x="{x0 + column * cell:.3f}" y="{y0 + row * cell:.3f}" width="{cell:.3f}" '
            f'height="{cell:.3f}" fill="{light if white != template.inverted else dark}"/>'
        )
    for ends, slot in zip(template.strip_ends, template.strip_slot, strict=True):
        (xa, ya), (xb, yb) = mm(ends)
        out.append(f'<line x1="{xa:.2f}" y1="{ya:.2f}" x2="{xb:.2f}" y2="{yb:.2f}" stroke="#e8d9a0" stroke-width="3"/>')
        out.append(f'<text x="{xa + 2:.2f}" y="{ya + 1.2:.2f}" font-size="3.2" fill="#333">strip {slot}</text>')
    for xy, bit in zip(template.led_xy, template.led_bit, strict=True):
        x, y = mm(xy)
        out.append(f'<circle cx="{x:.2f}" cy="{y:.2f}" r="2.5" fill="#fff" stroke="#888" stroke-width="0.3"/>')
        out.append(
            f'<text x="{x:.2f}" y="{y + 1.1:.2f}" font-size="3" text-anchor="middle" fill="#333">'
            f"{'D' if bit < 0 else bit}</text>"
        )
    return "\n".join([*out, "</svg>", ""])
