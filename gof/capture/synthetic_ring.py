"""Renders footage of a ring board with exact rolling shutter and exposure, and known times: the truth for its decoder.

As in `gof.capture.synthetic`, nothing is shared with the decoder but the board's template.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from gof.capture.ring_board import RingBoard
from gof.capture.synthetic import SyntheticShot, led_mask, lit_share

RED = np.array([1.0, 0.25, 0.18])  # a red LED's light in R, G, B
BOARD, PRINT = np.array([22.0, 24.0, 26.0]), np.array([205.0, 205.0, 200.0])  # solder mask and silk screen


@dataclass(frozen=True)
class RingShot:
    """One camera filming a ring board.

    Args:
        camera: everything but the board's pattern; its `period` is not used.
        move: px per frame by which the board is carried right and down.
        covered: discs (x, y, radius) in marker sides that hide what is behind them, as a hand does.
        counter_gain: brightness of the counter's LEDs against the ring's (the published firmware dims them to half).
    """

    camera: SyntheticShot
    move: tuple[float, float] = (0.0, 0.0)
    covered: tuple[tuple[float, float, float], ...] = ()
    counter_gain: float = 0.5


def render_ring(shot: RingShot, board: RingBoard, frames: int) -> Iterator[np.ndarray]:
    """RGB pictures (H, W, 3) uint8 of the running board in front of a textured ground."""
    import cv2

    camera = shot.camera
    rng = np.random.default_rng(camera.seed)
    size = (camera.height, camera.width)
    ground = cv2.GaussianBlur(rng.normal(0, 1, size).astype(np.float32), (0, 0), 2)
    ground = (70 + 25 * (ground / ground.std())[..., None]) * np.ones(3, np.float32)
    axis = 1 if camera.readout in ("left", "right") else 0
    lines = np.arange(size[axis]) + 0.5 - size[axis] / 2
    delay = (1 if camera.readout in ("right", "down") else -1) * camera.row_time * lines
    lamps = [*board.led_xy, *board.counter_xy]
    still = None
    for k, mid in enumerate(camera.times(frames)):
        if still is None or any(shot.move):
            centre = np.add(camera.centre, np.multiply(shot.move, k) / [camera.width, camera.height])
            H = replace(camera, centre=tuple(centre)).homography()
            still = _printed(ground, board, shot, H)
            places = cv2.perspectiveTransform(np.array(lamps).reshape(-1, 1, 2), H)[:, 0]
            spots = [led_mask(xy, LED_PART * camera.marker_px, size, camera.blur_px) for xy in places]
            open_ = [not any(np.hypot(*(xy - d[:2])) < d[2] for d in np.array(shot.covered)) for xy in lamps]
        start = mid + delay - camera.exposure / 2
        frame = still.copy()
        for lamp, ((mask, (y, x)), seen) in enumerate(zip(spots, open_, strict=True)):
            if seen and mask.size:
                share = _lit(lamp, start, camera.exposure, board, shot.counter_gain)
                line = share[x][None] if axis == 1 else share[y][:, None]
                frame[y, x] += (255 * camera.gain * mask * line)[..., None] * RED
        if camera.noise:
            frame += camera.noise * rng.standard_normal(frame.shape, np.float32)
        yield np.clip(np.rint(frame), 0, 255).astype(np.uint8)


LED_PART = 0.6  # an LED of the ring is 3.5 mm long: of `led_mask`'s spots, which are of the marker's size


def _printed(ground: np.ndarray, board: RingBoard, shot: RingShot, H: np.ndarray) -> np.ndarray:
    """The board without what changes: print, and the lamps at its corners."""
    import cv2

    picture, fine = ground.copy(), 8

    def fill(points, colour):
        pixels = cv2.perspectiveTransform(np.asarray(points, np.float64).reshape(-1, 1, 2), H)
        cv2.fillPoly(picture, [np.round((pixels - 0.5) * 2**fine).astype(np.int32)], colour.tolist(), cv2.LINE_AA, fine)

    fill(board.outline, BOARD)
    fill([[-1 / 6, -1 / 6], [7 / 6, -1 / 6], [7 / 6, 7 / 6], [-1 / 6, 7 / 6]], PRINT)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    for (row, column), light in np.ndenumerate(cv2.aruco.generateImageMarker(dictionary, board.marker_id, 6) > 0):
        x, y = column / 6, row / 6
        square = [[x, y], [x + 1 / 6, y], [x + 1 / 6, y + 1 / 6], [x, y + 1 / 6]]
        fill(square, PRINT if light != board.inverted else BOARD)
    for x, y, radius in shot.covered:
        turn = np.linspace(0, 2 * np.pi, 40)
        fill(np.stack([x + radius * np.cos(turn), y + radius * np.sin(turn)], 1), np.array([150.0, 110.0, 90.0]))
    picture = cv2.GaussianBlur(picture, (0, 0), max(shot.camera.blur_px, 0.3))
    for xy in cv2.perspectiveTransform(board.corner_xy.reshape(-1, 1, 2), H)[:, 0]:
        mask, box = led_mask(xy, LED_PART * shot.camera.marker_px, picture.shape[:2], shot.camera.blur_px)
        picture[box] += (255 * shot.camera.gain * mask)[..., None] * RED
    return picture


def _lit(lamp: int, start: np.ndarray, exposure: float, board: RingBoard, counter_gain: float) -> np.ndarray:
    """Share of each line's exposure in which an LED is lit: the ring's, then the counter's from its lowest bit on."""
    ring = len(board.led_xy)
    if lamp < ring:
        return lit_share(start, exposure, lamp * board.step_us, board.step_us, board.period_us)
    half = board.period_us * (1 << (lamp - ring))
    return counter_gain * lit_share(start, exposure, half, half, 2 * half)
