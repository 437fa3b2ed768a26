"""Footage of a ring board -> brightness over time of its LEDs. The board may be carried about: it is found anew in
every frame."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gof.capture.locate import MARKER_CORNERS, bright_spots, in_picture, marker_in, project, sample
from gof.capture.ring_board import RingBoard
from gof.footage.videos import stored_frames

SCALES = (1, 0.5, 2)  # at which the marker is looked for: reduced where blurred, enlarged where small
LED_REACH = 0.15  # of the ring's spacing: half the patch over which an LED's light is averaged
SNAP = 0.08  # of a marker side: how far the corner LEDs may lie from where the marker alone puts them
SAME = 0.06  # of the usual change from frame to frame: a picture that changes less is the one before
BLINK = 40.0  # grey levels by which a counter's LED changes: not the same round, then


@dataclass(frozen=True)
class RingSignals:
    """The readings of a ring board in T frames.

    Attributes:
        seen: (T,) bool, frames in which the board was found; the rest holds NaN or False elsewhere.
        led: (T, L) float32 brightness of the ring's LEDs above the bare board beside them, grey levels of red.
        led_px: (T, L, 2) where they are in the picture.
        led_inside: (T, L) bool, False beyond the picture's border.
        counter, counter_px, counter_inside: the same of the counter's LEDs, lowest bit first.
        duplicate: (T,) bool, frames whose LEDs repeat the frame before.
        image_size: (width, height).
        marker_px: mean side of the marker.
    """

    seen: np.ndarray
    led: np.ndarray
    led_px: np.ndarray
    led_inside: np.ndarray
    counter: np.ndarray
    counter_px: np.ndarray
    counter_inside: np.ndarray
    duplicate: np.ndarray
    image_size: tuple[int, int]
    marker_px: float

    def among(self, frames: np.ndarray) -> RingSignals:
        """Return those of the chosen frames (T,) bool. After a gap nothing counts as repeated."""
        kept = np.flatnonzero(frames)
        duplicate = self.duplicate[kept] & np.concatenate([[False], np.diff(kept) == 1])
        names = ("seen", "led", "led_px", "led_inside", "counter", "counter_px", "counter_inside")
        return replace(self, duplicate=duplicate, **{name: getattr(self, name)[kept] for name in names})


def read_ring_signals(video: Path, board: RingBoard, progress: Callable[[int], None] | None = None) -> RingSignals:
    """Read a video once. Raises DataFormatError: see `stored_frames`."""
    found, homography, size = [], None, (0, 0)
    for count, frame in enumerate(stored_frames(video), 1):
        red = np.ascontiguousarray(frame[..., 0]) if frame.ndim == 3 else frame
        size = (red.shape[1], red.shape[0])
        homography = find_board(frame, red, board, homography)
        found.append(None if homography is None else read_frame(red, board, homography))
        if progress and count % 16 == 0:
            progress(count)
    if progress:
        progress(len(found))
    return _gathered(found, board, size)


def find_board(frame: np.ndarray, red: np.ndarray, board: RingBoard, before: np.ndarray | None) -> np.ndarray | None:
    """Return (3, 3) homography from marker sides to pixels of a frame; None where the board is not in it.

    Args:
        frame: (H, W, 3) or (H, W).   red: (H, W) its red channel.
        before: of the frame before: the board is looked for around there first.
    """
    import cv2

    grey = cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY) if frame.ndim == 3 else frame
    corners = None if before is None else _near(grey, board, before)
    for scale in SCALES:
        if corners is None:
            corners = marker_in(grey, board.marker_id, board.inverted, scale)
    if corners is None:
        return None
    H, _ = cv2.findHomography(MARKER_CORNERS, corners)
    side = float(np.sqrt(abs(cv2.contourArea(corners.astype(np.float32)))))
    # The lamps at the board's corners lie wider than the marker: they settle the homography.
    lamps, lit = bright_spots(red.astype(np.float32), project(H, board.corner_xy), radius=max(2.0, SNAP * side))
    if lit.sum() >= 2:
        better, _ = cv2.findHomography(
            np.vstack([MARKER_CORNERS, board.corner_xy[lit]]), np.vstack([corners, lamps[lit]])
        )
        H = H if better is None else better
    return H


def _near(grey: np.ndarray, board: RingBoard, homography: np.ndarray) -> np.ndarray | None:
    """Return the marker's corners (4, 2) around the place where the board was; None where it is not there."""
    outline = project(homography, board.outline)
    low, high = outline.min(0), outline.max(0)
    low, high = low - (high - low) / 4, high + (high - low) / 4
    x0, y0 = np.maximum(low.astype(int), 0)
    x1, y1 = np.minimum(high.astype(int) + 1, grey.shape[::-1])
    if x1 - x0 < 8 or y1 - y0 < 8:
        return None
    corners = marker_in(np.ascontiguousarray(grey[y0:y1, x0:x1]), board.marker_id, board.inverted)
    return None if corners is None else corners + [x0, y0]


@dataclass(frozen=True)
class _Frame:
    """One frame's part of `RingSignals`."""

    led: np.ndarray
    led_px: np.ndarray
    counter: np.ndarray
    counter_px: np.ndarray
    marker_px: float


def read_frame(red: np.ndarray, board: RingBoard, homography: np.ndarray) -> _Frame:
    led, counter = project(homography, board.led_xy), project(homography, board.counter_xy)
    reach = LED_REACH * np.linalg.norm(led - np.roll(led, 1, 0), axis=1).mean()
    around = reach * np.stack(np.meshgrid([-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0]), -1).reshape(-1, 1, 2)

    def light(lamps, dark):
        return sample(red, lamps + around).mean(0) - sample(red, project(homography, dark) + around).mean(0)

    marker = project(homography, MARKER_CORNERS)
    return _Frame(
        light(led, board.led_dark),
        led,
        light(counter, board.counter_dark),
        counter,
        float(np.linalg.norm(marker - np.roll(marker, 1, 0), axis=1).mean()),
    )


def _gathered(found: list[_Frame | None], board: RingBoard, size: tuple[int, int]) -> RingSignals:
    leds, bits = len(board.led_xy), len(board.counter_xy)
    nothing = _Frame(
        np.full(leds, np.nan, np.float32),
        np.full((leds, 2), np.nan),
        np.full(bits, np.nan, np.float32),
        np.full((bits, 2), np.nan),
        np.nan,
    )
    seen = np.array([frame is not None for frame in found], bool)
    frames = [frame or nothing for frame in found] or [nothing]
    led, led_px = np.stack([f.led for f in frames]), np.stack([f.led_px for f in frames])
    counter, counter_px = np.stack([f.counter for f in frames]), np.stack([f.counter_px for f in frames])
    step = np.abs(np.diff(led, axis=0)).mean(1)
    blinked = np.abs(np.diff(counter, axis=0)).max(1) > BLINK  # a gap of a whole round leaves the ring alone
    usual = float(np.nanmedian(step)) if np.isfinite(step).any() else 0.0
    return RingSignals(
        seen,
        led,
        led_px,
        in_picture(led_px, *size, 1.0),
        counter,
        counter_px,
        in_picture(counter_px, *size, 1.0),
        np.concatenate([[False], (step < SAME * usual) & ~blinked]),
        size,
        float(np.nanmean([f.marker_px for f in frames])) if seen.any() else 0.0,
    )
