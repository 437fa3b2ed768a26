"""Whether a frame shows the marker where it was found."""

from __future__ import annotations

import numpy as np

from gof.capture.brightness import sample
from gof.capture.locate import BoardInImage
from gof.capture.template import BoardTemplate

CELL_SAMPLES = 4  # per marker cell and direction


def marker_pattern(template: BoardTemplate) -> np.ndarray:
    """(6, 6) the marker's cells, 1 light and 0 dark."""
    import cv2

    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    light = cv2.aruco.generateImageMarker(dictionary, template.marker_id, 6) > 0
    return (light != template.inverted).astype(float)


def marker_likeness(image: np.ndarray, board: BoardInImage, pattern: np.ndarray) -> float:
    """Correlation of an (H, W) image, where the marker was found, with the marker's pattern."""
    import cv2

    count = len(pattern) * CELL_SAMPLES
    place = (np.arange(count) + 0.5) / count
    xy = np.stack(np.meshgrid(place, place), -1).reshape(1, -1, 2)
    seen = sample(image, cv2.perspectiveTransform(xy, board.marker_to_image)[0])
    expected = np.kron(pattern, np.ones((CELL_SAMPLES, CELL_SAMPLES))).ravel()
    spread = seen.std() * expected.std()
    return float(((seen - seen.mean()) * (expected - expected.mean())).mean() / spread) if spread > 1e-6 else 0.0
