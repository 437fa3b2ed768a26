"""Soft mask of the LED board: its flicker is neither fire nor an error of a picture."""

from __future__ import annotations

import numpy as np

from gof.capture.locate import BoardInImage
from gof.capture.template import BoardTemplate

MUCH_COVERED, MOST_COVERED = 0.25, 0.6  # of the picture; the published clips have 0.08 to 0.15
FARTHEST_PX = 30_000.0  # OpenCV draws no farther
Outlines = tuple[tuple[tuple[float, float], ...], ...]  # polygons in px, pixel centres at integer + 0.5


def outlines_of(board: BoardInImage, template: BoardTemplate) -> Outlines:
    """Return the polygons that the board covers, to a tenth of a pixel: its outline, and the hull of its strips."""
    import cv2

    outline = cv2.perspectiveTransform(template.outline.reshape(1, -1, 2), board.marker_to_image)[0]
    # The strips are mounted off the marker's plane: take them from where they were found.
    strips = cv2.convexHull(board.strip.reshape(-1, 2).astype(np.float32))[:, 0]
    return tuple(tuple((round(float(x), 1), round(float(y), 1)) for x, y in polygon) for polygon in (outline, strips))


def board_mask(
    outlines: Outlines, marker_px: float, size: tuple[int, int], margin: float = 0.25, feather: float = 0.35
) -> np.ndarray:
    """Return the share of each pixel that belongs to the board, of 255: all on it, none away from it.

    Args:
        outlines: of the board, see `outlines_of`.   marker_px: side of its marker.
        size: (width, height) of the picture.
        margin: how far around the outlines it stays whole, in marker sides; glow reaches further than the board.
        feather: width of the ramp beyond it, in marker sides, > 0.
    Returns:
        (H, W) uint8.
    """
    import cv2

    width, height = size
    covered = np.zeros((height, width), np.uint8)
    for polygon in outlines:
        cv2.fillPoly(covered, [np.round(np.clip(polygon, -FARTHEST_PX, FARTHEST_PX) - 0.5).astype(np.int32)], (255,))
    distance = cv2.distanceTransform(255 - covered, cv2.DIST_L2, 5)
    share = np.clip(1 - (distance - margin * marker_px) / (feather * marker_px), 0, 1)
    return np.rint(255 * share).astype(np.uint8)


def share_of(mask: np.ndarray) -> float:
    """Return the share of the picture that a mask covers."""
    return float((mask > 127).mean())


def objection_to(mask: np.ndarray) -> str | None:
    """Return why a mask is not believed, in words, or None."""
    share = share_of(mask)
    if share <= MOST_COVERED:
        return None
    return (
        f"no board mask: what was taken for the board covers {share:.0%} of the picture, and the flame with "
        "it: is it the right board (--board), whole and sharp?"
    )


def in_words(mask: np.ndarray) -> str:
    """Return how much a mask covers, for people."""
    share = share_of(mask)
    much = "; that is much: look at it, it hides what is behind it from scores" if share > MUCH_COVERED else ""
    return f"board mask, {share:.1%} of the picture{much}"
