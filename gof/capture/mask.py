"""Soft mask of the LED board: its flicker is neither fire nor an error of a picture."""

from __future__ import annotations

import numpy as np

from gof.capture.locate import BoardInImage
from gof.capture.template import BoardTemplate


def board_mask(
    board: BoardInImage, template: BoardTemplate, size: tuple[int, int], margin: float = 0.25, feather: float = 0.35
) -> np.ndarray:
    """How much each pixel belongs to the board: 1 on it, 0 away from it.

    Args:
        size: (width, height) of the picture.
        margin: how far around outline and strips it stays 1, in marker sides; glow reaches further than the board.
        feather: width of the ramp beyond it, in marker sides, > 0.
    Returns:
        (H, W) float32 in [0, 1].
    """
    import cv2

    width, height = size
    covered = np.zeros((height, width), np.uint8)
    outline = cv2.perspectiveTransform(template.outline.reshape(1, -1, 2), board.marker_to_image)[0]
    # The strips are mounted off the marker's plane: take them from where they were found.
    strips = cv2.convexHull(board.strip.reshape(-1, 2).astype(np.float32))[:, 0]
    for polygon in (outline, strips):
        cv2.fillPoly(covered, [np.round(polygon - 0.5).astype(np.int32)], 255)
    side = float(np.linalg.norm(board.corners[0] - board.corners[1]))
    distance = cv2.distanceTransform(255 - covered, cv2.DIST_L2, 5)
    return np.clip(1 - (distance - margin * side) / (feather * side), 0, 1).astype(np.float32)
