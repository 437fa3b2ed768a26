"""Renders footage of an LED board with exact rolling shutter and exposure, and known times: the truth for the decoder.

The render model shares nothing with the decoder but the template: brightness is the exact overlap of each image line's
exposure with the firmware's pattern, then optics (blur), sensor (gain, saturation, noise, 8 bits), a codec if asked.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gof.capture.ring_board import RingBoard
from gof.capture.template import BoardTemplate

SLOTS = 5
COUNTER_BITS = 15


@dataclass(frozen=True)
class SyntheticShot:
    """One camera filming a running board. Times in us.

    Args:
        width, height: of the picture.
        row_time: delay from line to line; readout: direction of later lines.
        exposure, fps, start: start is the mid-exposure of the centre in frame 0, on the board's clock.
        marker_px: side of the marker in pixels; yaw_deg turns the board about its vertical axis, roll_deg in the
            picture.
        centre: of the marker, as fractions of the picture.
        blur_px, noise: Gaussian, standard deviations in pixels and grey levels.
        gain: brightness of a fully exposed LED, of full scale (above 1 saturates).
        tied: groups of strip slots wired together.
        lost: positions on the camera's clock that never reach the file; repeated: file positions shown twice.
        clock_noise: random deviation of each frame from a steady clock.
    """

    width: int = 720
    height: int = 1280
    row_time: float = 3.0
    readout: str = "left"
    exposure: float = 1000.0
    fps: float = 400.0
    start: float = 1_234_567.0
    marker_px: float = 60.0
    yaw_deg: float = 0.0
    roll_deg: float = 180.0
    centre: tuple[float, float] = (0.5, 0.8)
    blur_px: float = 0.8
    noise: float = 2.0
    gain: float = 3.0
    period: float = 4000.0
    tied: tuple[tuple[int, ...], ...] = ()
    lost: tuple[int, ...] = ()
    repeated: tuple[int, ...] = ()
    clock_noise: float = 0.0
    seed: int = 0

    def homography(self) -> np.ndarray:
        """Return (3, 3) from marker sides to pixels."""
        a, r = np.radians(self.yaw_deg), np.radians(self.roll_deg)
        distance = 20.0  # marker sides: moderate perspective
        to_centre = np.array([[1, 0, -0.5], [0, 1, -0.5], [0, 0, 1]])
        turn = np.array([[np.cos(a), 0, 0], [0, 1, 0], [np.sin(a), 0, distance]])
        roll = np.array([[np.cos(r), -np.sin(r), 0], [np.sin(r), np.cos(r), 0], [0, 0, 1]])
        focal = self.marker_px * distance
        image = np.array([[focal, 0, self.centre[0] * self.width], [0, focal, self.centre[1] * self.height], [0, 0, 1]])
        return image @ roll @ turn @ to_centre

    def times(self, frames: int) -> np.ndarray:
        """Return (frames,) true mid-exposure times of the pictures' centre, in file order."""
        clock = [k for k in range(frames + len(self.lost)) if k not in self.lost]
        for at in sorted(self.repeated):
            clock.insert(at + 1, clock[at])
        index = np.array(clock[:frames])
        jitter = np.random.default_rng(self.seed + 1).normal(0, self.clock_noise, index.max() + 1)
        return self.start + index * 1e6 / self.fps + (jitter[index] if self.clock_noise else 0.0)


def lit_share(start: np.ndarray, exposure: float, on: float, length: float, cycle: float) -> np.ndarray:
    """Return share of the exposure [start, start + exposure] in which something is lit that is lit from `on` for
    `length` in every `cycle`. Exact for any lengths."""

    def lit_until(t):
        n = np.floor((t - on) / cycle)
        return n * length + np.minimum(t - on - n * cycle, length)

    return (lit_until(start + exposure) - lit_until(start)) / exposure


def render(shot: SyntheticShot, template: BoardTemplate, frames: int) -> Iterator[np.ndarray]:
    """Grey pictures (H, W) uint8 of the board in front of a textured ground."""
    import cv2

    rng = np.random.default_rng(shot.seed)
    H = shot.homography()

    def project(p):
        return cv2.perspectiveTransform(np.asarray(p, np.float64).reshape(-1, 1, 2), H).reshape(np.shape(p))

    ground = cv2.GaussianBlur(rng.normal(0, 1, (shot.height, shot.width)).astype(np.float32), (0, 0), 2)
    picture = 70 + 25 * ground / ground.std()
    fine = 8  # subpixel bits of the polygons

    def fill(img, p, value):
        return cv2.fillPoly(img, [np.round((project(p) - 0.5) * 2**fine).astype(np.int32)], value, cv2.LINE_AA, fine)

    fill(picture, template.outline, 18)
    cells = (
        cv2.aruco.generateImageMarker(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50), template.marker_id, 6)
        > 0
    )
    for (row, column), white in np.ndenumerate(cells):
        x, y = column / 6, row / 6
        light = white != template.inverted
        fill(picture, np.array([[x, y], [x + 1 / 6, y], [x + 1 / 6, y + 1 / 6], [x, y + 1 / 6]]), 200 if light else 20)
    picture = cv2.GaussianBlur(picture, (0, 0), max(shot.blur_px, 0.3))

    lights = [_strip_mask(project, e, picture.shape, shot.blur_px) for e in template.strip_ends]
    lights += [led_mask(project(p), shot.marker_px, picture.shape, shot.blur_px) for p in template.led_xy]
    axis = 1 if shot.readout in ("left", "right") else 0  # array axis of the readout
    size = picture.shape[axis]
    sign = 1 if shot.readout in ("right", "down") else -1
    delay = sign * shot.row_time * (np.arange(size) + 0.5 - size / 2)
    group = {s: (s,) for s in range(SLOTS)} | {s: g for g in shot.tied for s in g}
    for mid in shot.times(frames):
        start = mid + delay - shot.exposure / 2
        frame = picture.copy()
        for k, (mask, box) in enumerate(lights):
            if k < SLOTS:
                slot = shot.period / SLOTS
                lit = [
                    lit_share(start, shot.exposure, s * shot.period / SLOTS, slot, shot.period)
                    for s in group[int(template.strip_slot[k])]
                ]
                share = np.sum(lit, axis=0)
            else:
                share = _led_share(start, shot, int(template.led_bit[k - SLOTS]), template.disambiguation_lead)
            y, x = box
            line = share[x][None] if axis == 1 else share[y][:, None]
            frame[y, x] += 255 * shot.gain * mask * line
        frame += rng.normal(0, shot.noise, frame.shape) if shot.noise else 0.0
        yield np.clip(np.round(frame), 0, 255).astype(np.uint8)


def _led_share(start, shot, bit, lead):
    if bit < 0:
        return lit_share(start, shot.exposure, (1 - lead) * shot.period, shot.period, 2 * shot.period)
    # Gray bit b is lit for the middle half of every 2^(b+2) counts; the top bit for the upper half of the counter.
    if bit == COUNTER_BITS - 1:
        return lit_share(start, shot.exposure, 2**bit * shot.period, 2**bit * shot.period, 2 ** (bit + 1) * shot.period)
    return lit_share(
        start, shot.exposure, 2**bit * shot.period, 2 ** (bit + 1) * shot.period, 2 ** (bit + 2) * shot.period
    )


def _box(low, high, shape):
    (x0, y0), (x1, y1) = np.floor(low).astype(int), np.ceil(high).astype(int) + 1
    return slice(max(0, y0), min(shape[0], max(y1, 0))), slice(max(0, x0), min(shape[1], max(x1, 0)))


def _strip_mask(project, ends, shape, blur):
    """Light of a strip, 1 on its axis: a soft band with the optics' blur."""
    a, b = project(ends)
    unit = np.linalg.norm(project(np.add(ends[:1], [0, 0.1])) - a) * 10
    sigma = np.hypot(0.03 * unit, blur)
    low, high = np.minimum(a, b) - 4 * sigma, np.maximum(a, b) + 4 * sigma
    box = _box(low, high, shape)
    yy, xx = np.mgrid[box] + 0.5
    d = b - a
    length = np.linalg.norm(d)
    along = ((xx - a[0]) * d[0] + (yy - a[1]) * d[1]) / length
    across = ((yy - a[1]) * d[0] - (xx - a[0]) * d[1]) / length
    inside = np.clip(along / (2 * sigma) + 0.5, 0, 1) * np.clip((length - along) / (2 * sigma) + 0.5, 0, 1)
    return np.exp(-0.5 * (across / sigma) ** 2) * inside, box


def led_mask(centre, marker_px, shape, blur):
    sigma = np.hypot(0.03 * marker_px, blur)
    box = _box(centre - 4 * sigma, centre + 4 * sigma, shape)
    yy, xx = np.mgrid[box] + 0.5
    return np.exp(-0.5 * ((xx - centre[0]) ** 2 + (yy - centre[1]) ** 2) / sigma**2), box


def write_video(path: Path, pictures: Iterator[np.ndarray], codec: str = "mp4v") -> None:
    """Encode grey or RGB pictures ("mp4v" is MPEG-4 at OpenCV's default bit rate, "FFV1" in .avi is lossless)."""
    import cv2

    writer = None
    for picture in pictures:
        if writer is None:
            writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*codec), 30, picture.shape[1::-1])
            if not writer.isOpened():
                raise OSError(f"{path}: OpenCV cannot write codec {codec}")
        writer.write(picture[..., ::-1] if picture.ndim == 3 else cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR))
    if writer is not None:
        writer.release()


# ----------------------------------------------------------------
# Renders footage of a ring board with exact rolling shutter and exposure, and known times: the truth for its decoder.
#
# As above, nothing is shared with the decoder but the board's template.

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


USUAL = SyntheticShot(
    width=300,
    height=260,
    marker_px=60,
    row_time=20.0,
    readout="down",
    exposure=8000.0,
    fps=29.97,
    centre=(0.5, 0.5),
    roll_deg=0.0,
    gain=4.0,
)  # a camera that films a ring board


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
    """Return the board without what changes: print, and the lamps at its corners."""
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
    """Return share of each line's exposure in which an LED is lit: the ring's, then the counter's from its lowest bit
    on."""
    ring = len(board.led_xy)
    if lamp < ring:
        return lit_share(start, exposure, lamp * board.step_us, board.step_us, board.period_us)
    half = board.period_us * (1 << (lamp - ring))
    return counter_gain * lit_share(start, exposure, half, half, 2 * half)
