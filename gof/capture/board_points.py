"""Points of the LED board that a user marked in a camera's pictures, where its marker is partly hidden or cut off."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gof.capture.template import BoardTemplate
from gof.core.errors import DataFormatError
from gof.core.files import read_json
from gof.core.records import convert_json

CORNERS = ((0, 0), (1, 0), (1, 1), (0, 1))  # of the marker, in its sides
FEWEST = 4  # points that a plane's perspective needs
MOST_MISS = 0.12  # marker sides: by how much a mark may miss; LEDs are three times as far apart


@dataclass(frozen=True)
class _Marked:
    """Marks in one camera: pixels of marker corners 0 to 3, and of LEDs by their Gray bit."""

    corners: dict[str, tuple[float, float]]
    leds: dict[str, tuple[float, float]]


@dataclass(frozen=True)
class BoardPoints:
    """Places on the board (N, 2) in marker sides, and their pixels (N, 2), centres at integer + 0.5."""

    xy: np.ndarray
    pixels: np.ndarray

    def homography(self) -> np.ndarray:
        """Return (3, 3) from marker sides to pixels, least squares. Raises DataFormatError: the points do not fit a
        board."""
        import cv2

        H, _ = cv2.findHomography(self.xy, self.pixels)
        if H is None or not np.isfinite(H).all() or np.linalg.cond(H) > 1e12:
            raise DataFormatError("the points marked on the board lie on one line; mark one beside it")
        seen = cv2.perspectiveTransform(self.xy.reshape(1, -1, 2), H)[0]
        side = np.sqrt(cv2.contourArea(cv2.perspectiveTransform(np.array([CORNERS], np.float32), H)))
        off = np.linalg.norm(seen - self.pixels, axis=1)
        if not off.max() <= max(5.0, MOST_MISS * side):
            raise DataFormatError(
                f"the points marked on the board miss a flat board by up to {off.max():.0f} px; are corners (0 to 3 "
                "clockwise, as the marker is printed) and LEDs (by bit) given their right numbers? 'gof capture draw' "
                "draws them"
            )
        return H


def read_board_points(path: Path, template: BoardTemplate, names: list[str]) -> dict[str, BoardPoints]:
    """{camera: {"corners": {"0": [x, y], ...}, "leds": {"5": [x, y], ...}}, ...}, pixels of the video as stored.

    Args:
        names: of the videos; those without an entry are read as usual.
    Raises:
        DataFormatError: an unknown camera, corner or bit; fewer than four points; numbers that are not finite.
    """
    content = read_json(path)
    if not isinstance(content, dict) or not content:
        raise DataFormatError(f"{path}: must be {{camera: {{'corners': {{'0': [x, y]}}, 'leds': {{'5': [x, y]}}}}}}")
    found = {}
    for name, entry in content.items():
        if name not in names:
            raise DataFormatError(f"{path}: no video is called '{name}'; there are {', '.join(names)}")
        if isinstance(entry, dict):
            entry = {"corners": {}, "leds": {}} | entry
        where = f"{path}: {name}"
        marked = convert_json(_Marked, entry, where)
        found[name] = points_on(template, marked.corners, marked.leds, where)
    return found


def points_on(
    template: BoardTemplate, corners: dict[str, tuple[float, float]], leds: dict[str, tuple[float, float]], where: str
) -> BoardPoints:
    """Return marks of marker corners "0" to "3" and of LEDs by Gray bit, pixels, as places on the board.

    Args:
        where: to name in errors.
    Raises:
        DataFormatError: as `read_board_points`.
    """
    known_corners = {str(k): xy for k, xy in enumerate(CORNERS)}
    known_leds = {str(b): xy for b, xy in zip(template.led_bit, template.led_xy, strict=True) if b >= 0}
    xy, pixels = [], []
    for kind, places, given in (("corner", known_corners, corners), ("LED", known_leds, leds)):
        for number, pixel in given.items():
            if number not in places:
                raise DataFormatError(f"{where}: the board '{template.name}' has no {kind} '{number}'")
            xy.append(places[number])
            pixels.append(pixel)
    if len(xy) < FEWEST:
        raise DataFormatError(f"{where}: {len(xy)} points of the board are marked, {FEWEST} are needed")
    if not np.isfinite(pixels).all():
        raise DataFormatError(f"{where}: a pixel is not finite")
    return BoardPoints(np.array(xy, np.float64), np.array(pixels, np.float64))
