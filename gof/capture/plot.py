"""One picture per camera: residuals of the frame times, and the strip curves they were read from."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gof.capture.decode import CameraTimes
from gof.footage.pictures import write_picture

WIDTH, HEIGHT, LEFT, RIGHT = 1100, 620, 80, 20
COLOURS = ((40, 40, 220), (30, 140, 240), (60, 160, 60), (200, 120, 30), (170, 50, 150))  # BGR, strips in slot order


def plot_camera(times: CameraTimes, title: str, slot: np.ndarray | None, period_us: float, path: Path) -> None:
    """Write a PNG: measured minus fused time per frame (left-out frames hollow, at the border when beyond it), and
    below it every strip's learned brightness over the board's period with its nominal slot.

    Args:
        slot: (S,) of the strips; None of a ring, whose one curve is its LEDs' brightness around the exposure's middle.
    """
    import cv2

    image = np.full((HEIGHT, WIDTH, 3), 255, np.uint8)

    def text(s, x, y, colour=(40, 40, 40), size=0.45):
        return cv2.putText(image, s, (int(x), int(y)), cv2.FONT_HERSHEY_SIMPLEX, size, colour, 1, cv2.LINE_AA)

    text(
        f"{title}: rms {times.rms_us:.2f} us, max {times.max_us:.1f} us over {int(times.used.sum())} of "
        f"{len(times.used)} frames; {times.interval_us:.3f} us per frame; "
        f"rows {times.row_time_us:.3f} us per pixel, {times.readout}",
        LEFT,
        24,
        size=0.5,
    )
    residual = times.measured_us - times.time_us
    limit = max(10.0, np.ceil(times.max_us / 5) * 5 + 5)
    top, bottom = 45, 330

    def x_of(k):
        return LEFT + (WIDTH - LEFT - RIGHT) * k / max(len(residual) - 1, 1)

    def y_of(r):
        return (top + bottom) / 2 - (bottom - top) / 2 * np.clip(r / limit, -1, 1)

    for level in (-limit, -times.rms_us, 0, times.rms_us, limit):
        y = int(y_of(level))
        cv2.line(image, (LEFT, y), (WIDTH - RIGHT, y), (190, 190, 190) if level else (120, 120, 120), 1)
        text(f"{level:+.1f}", 20, y + 4, size=0.4)
    for k, r in enumerate(residual):
        centre = (int(x_of(k)), int(y_of(r)))
        cv2.circle(
            image, centre, 3, (180, 90, 20) if times.used[k] else (0, 0, 220), -1 if times.used[k] else 1, cv2.LINE_AA
        )
    text("measured - fused time (us) against frame", LEFT, bottom + 20)
    text(f"0 .. {len(residual) - 1}", WIDTH - 130, bottom + 20)

    top, bottom = 370, 575
    bins = times.curve.shape[1]
    grid = LEFT + (WIDTH - LEFT - RIGHT) * np.arange(bins) / bins
    for k in np.argsort(slot) if slot is not None else [0]:
        s = int(slot[k]) if slot is not None else 0
        colour = COLOURS[s % len(COLOURS)]
        y = bottom - (bottom - top) * np.clip(times.curve[k], -0.1, 1.1)
        cv2.polylines(image, [np.stack([grid, y], 1).astype(np.int32)], False, colour, 2, cv2.LINE_AA)
        if slot is None:
            continue
        x0, x1 = (LEFT + (WIDTH - LEFT - RIGHT) * (s + a) / len(slot) for a in (0, 1))
        cv2.rectangle(image, (int(x0) + 1, bottom + 6), (int(x1) - 1, bottom + 12), colour, -1)
        text(f"slot {s}", (x0 + x1) / 2 - 20, bottom + 28, colour)
    what = "LEDs' brightness over a round" if slot is None else "strip brightness over the board's period"
    bars = "exposure in the middle" if slot is None else "bars: nominal slots"
    text(f"{what} of {period_us / 1000:g} ms ({bars})", LEFT, HEIGHT - 4)
    for i, fault in enumerate(times.faults):
        text(f"fault: {fault}", LEFT + 10, top - 6 + 18 * i, (0, 0, 200))
    write_picture(path, image)
