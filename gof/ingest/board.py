"""The sync board as a set of points every camera knows: marker corners (a square of known side) and LEDs."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from gof.capture.locate import MARKER_CORNERS, BoardNotFound, Summary, find_marker, locate
from gof.capture.template import BoardTemplate
from gof.ingest.marked_points import MarkedPoint

GROWN = 0.2  # of a marker side: what around the board's outline still belongs to it


def board_points(
    clips: list[Collection[np.ndarray]], template: BoardTemplate, marker_m: float
) -> tuple[list[MarkedPoint], list[str]]:
    """The board's points that some camera sees, xyz on the board (z = 0) in metres.

    LEDs are rough: the template's places for them are good to a few pixels only, but each is one spot in every picture.

    Args:
        clips: per camera its (H, W, 3) uint8 RGB pictures.
        marker_m: side of the marker; any number when the scale is unknown.
    Returns:
        the points, and one note per camera that does not show the marker.
    """
    corners = [MarkedPoint({}, np.append(marker_m * xy, 0.0)) for xy in MARKER_CORNERS]
    leds = [MarkedPoint({}, np.append(marker_m * xy, 0.0), rough=True) for xy in template.led_xy]
    notes = []
    for camera, clip in enumerate(clips):
        summary = Summary()
        for frame in clip:
            summary.add(frame)
        try:
            corner_pixels = find_marker(summary, template)
        except BoardNotFound as e:
            notes.append(f"camera {camera}: {e}")
            continue
        for point, xy in zip(corners, corner_pixels, strict=True):
            point.pixels[camera] = xy
        for led, xy in _seen_leds(summary, template).items():
            leds[led].pixels[camera] = xy
    return [p for p in corners + leds if p.pixels], notes


def _seen_leds(summary: Summary, template: BoardTemplate) -> dict[int, np.ndarray]:
    """Pixel of every LED that is seen, by its number; none where the strips cannot be read: the corners are enough."""
    try:
        board = locate(summary, template)
    except BoardNotFound:
        return {}
    return {k: xy for k, (xy, seen) in enumerate(zip(board.led, board.led_visible, strict=True)) if seen}


def board_region(
    points: list[MarkedPoint], camera: int, template: BoardTemplate, marker_m: float, shape: tuple[int, int]
) -> np.ndarray:
    """(H, W) bool: the board's outline in a camera, grown a little; all False where it is not seen."""
    import cv2

    region = np.zeros(shape, np.uint8)
    corners = [p for p in points if camera in p.pixels and not p.rough]
    if len(corners) < len(MARKER_CORNERS):
        return region > 0
    pixels = np.array([p.pixels[camera] for p in corners])
    H, _ = cv2.findHomography(np.array([p.xyz[:2] / marker_m for p in corners]), pixels)
    if H is None:
        return region > 0
    outline = cv2.perspectiveTransform(template.outline.reshape(1, -1, 2), H)[0]
    cv2.fillPoly(region, [np.rint(outline).astype(np.int32)], 1)
    side = max(3, int(GROWN * np.linalg.norm(pixels[1] - pixels[0])))
    return cv2.dilate(region, np.ones((side, side), np.uint8)) > 0
