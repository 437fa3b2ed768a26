"""The sync board as a set of points every camera knows: marker corners (a square of known side) and LEDs."""

from __future__ import annotations

import numpy as np

from gof.capture.locate import BoardNotFound, Summary, find_marker, locate
from gof.capture.template import BoardTemplate

CORNERS = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float64)


def board_points(clips: list[np.ndarray], template: BoardTemplate, marker_m: float) -> tuple[list[dict], list[str]]:
    """Points as `sfm.read_points` gives them, xyz on the board (z = 0) in metres.

    LEDs are "rough": the template's places for them are good to a few pixels only, but each is one spot in every picture.

    Args:
        clips: (T, H, W, 3) uint8 RGB per camera.   marker_m: side of the marker; any number when the scale is unknown.
    Returns:
        the points, and one note per camera that does not show the marker.
    """
    points = [{"pixels": {}, "xyz": np.append(marker_m * xy, 0.0)} for xy in CORNERS]
    points += [{"pixels": {}, "xyz": np.append(marker_m * xy, 0.0), "rough": True} for xy in template.led_xy]
    notes = []
    for c, clip in enumerate(clips):
        summary = Summary()
        for frame in clip:
            summary.add(frame)
        try:
            corners, leds = find_marker(summary, template), {}
        except BoardNotFound as e:
            notes.append(f"camera {c}: {e}")
            continue
        try:
            board = locate(summary, template)
            leds = {k: xy for k, (xy, seen) in enumerate(zip(board.led, board.led_visible, strict=True)) if seen}
        except BoardNotFound:
            pass  # marker without readable strips: the corners are enough
        for k, xy in enumerate(corners):
            points[k]["pixels"][c] = xy
        for k, xy in leds.items():
            points[4 + k]["pixels"][c] = xy
    return [p for p in points if p["pixels"]], notes


def board_region(
    points: list[dict], camera: int, template: BoardTemplate, marker_m: float, shape: tuple[int, int]
) -> np.ndarray:
    """(H, W) bool: the board's outline in a camera, grown by a fifth of a marker side; all False where it is not seen."""
    import cv2

    region = np.zeros(shape, np.uint8)
    seen = [p for p in points if camera in p["pixels"] and not p.get("rough")]
    if len(seen) >= 4:
        H, _ = cv2.findHomography(
            np.array([p["xyz"][:2] / marker_m for p in seen]), np.array([p["pixels"][camera] for p in seen])
        )
        if H is not None:
            outline = cv2.perspectiveTransform(template.outline.reshape(1, -1, 2), H)[0]
            cv2.fillPoly(region, [np.rint(outline).astype(np.int32)], 1)
            side = max(3, int(0.2 * np.linalg.norm(seen[1]["pixels"][camera] - seen[0]["pixels"][camera])))
            region = cv2.dilate(region, np.ones((side, side), np.uint8))
    return region > 0
