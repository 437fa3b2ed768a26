"""Footage of the board -> brightness over time of every LED and of points along every strip."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

import numpy as np

from gof.capture.board_points import BoardPoints
from gof.capture.locate import BoardInImage, MarkerNotFound, Summary, locate, sample, white
from gof.capture.template import BoardTemplate
from gof.footage.videos import stored_frames

LED_CHANGE = 40.0  # grey levels: far above a codec's noise, half of what a dim LED changes by


@dataclass(frozen=True)
class Signals:
    """Raw brightness (0..255, smallest colour channel) of T frames.

    Args:
        strip: (T, S, J) float32 at the board's strip points, averaged over a pixel to either side.
        led: (T, L) float32.
        duplicate: (T,) True where the board's picture repeats the frame before exactly or nearly.
        image_size: (width, height).
        board: where the points are.
        marker: (T,) how much each frame looks like the marker where it was found, -1..1; None where not looked for.
    """

    strip: np.ndarray
    led: np.ndarray
    duplicate: np.ndarray
    image_size: tuple[int, int]
    board: BoardInImage
    marker: np.ndarray | None = None

    @property
    def marker_px(self) -> float:
        """Mean side of the marker."""
        return self.board.marker_px


def read_signals(
    video: Path,
    template: BoardTemplate,
    locate_frames: int = 160,
    memory: int = 2**28,
    progress=None,
    points: BoardPoints | None = None,
) -> Signals:
    """Read a video once: find the board in the first `locate_frames` frames (fewer when they would not fit in `memory`
    bytes), then sample those and all that follow.

    Args:
        points: of the board, marked by a user; its marker is hidden then, and all frames are taken to show the board.
    Raises:
        BoardNotFound, DataFormatError: see `locate` and `stored_frames`.
    """
    summary, held = Summary(), []
    stream = stored_frames(video)
    for frame in stream:
        summary.add(frame)
        held.append(white(frame))
        if len(held) >= locate_frames or (len(held) + 1) * held[0].nbytes > memory:
            break
    try:
        board = locate(summary, template, points=points)
    except MarkerNotFound as e:
        advice = "Where a part of it is hidden all through the take, mark four points of the board: --board-points"
        raise MarkerNotFound(f"{e} {advice}") from e
    strips, leds, markers = [], [], []
    pattern = marker_pattern(template)
    for count, image in enumerate(chain(held, map(white, stream)), 1):
        strip, led = sample_frame(image, board)
        strips.append(strip)
        leds.append(led)
        markers.append(marker_likeness(image, board, pattern))
        if progress and count % 64 == 0:
            progress(count)
    if progress:
        progress(len(leds))
    height, width = summary.low.shape
    signals = make_signals(np.stack(strips), np.stack(leds), (width, height), board)
    return signals if points else replace(signals, marker=np.array(markers))


def sample_frame(image: np.ndarray, board: BoardInImage) -> tuple[np.ndarray, np.ndarray]:
    """Return (S, J) strip and (L,) LED brightness of one (H, W) white image."""
    around = np.array([-1.0, 0.0, 1.0])
    strip = sample(image, board.strip[None] + around[:, None, None, None] * board.strip_normal).mean(0)
    offsets = np.stack(np.meshgrid(around, around), -1).reshape(-1, 1, 2)
    return strip, sample(image, board.led[None] + offsets).max(0)


def make_signals(strip: np.ndarray, led: np.ndarray, image_size: tuple[int, int], board: BoardInImage) -> Signals:
    """Signals with repeated frames marked: two frames of a running board differ by more than coding noise, in strips or
    LEDs, unless one is a copy of the other. (After a gap the strips alone may look as they did before it.)"""
    visible = board.strip_visible
    step = np.abs(np.diff(strip, axis=0))[:, visible].mean(1) if visible.any() else np.zeros(len(strip) - 1)
    seen = board.led_visible
    blinked = np.abs(np.diff(led, axis=0))[:, seen].max(1) > LED_CHANGE if seen.any() else np.zeros(len(led) - 1, bool)
    duplicate = np.concatenate([[False], (step < 0.06 * np.median(step)) & ~blinked])
    return Signals(strip, led, duplicate, image_size, board)


# ----------------------------------------------------------------
# Whether a frame shows the marker where it was found.

CELL_SAMPLES = 4  # per marker cell and direction


def marker_pattern(template: BoardTemplate) -> np.ndarray:
    """Return (6, 6) the marker's cells, 1 light and 0 dark."""
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
