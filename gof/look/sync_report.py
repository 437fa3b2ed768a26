"""One page on which a layman can judge a take's times: one moment as all cameras saw it, and how sure they are."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gof.capture.aligned import AlignedFrames, align
from gof.capture.times import FrameTimesFile, SyncedVideo, VideoTimes
from gof.capture.warnings import missing_frames
from gof.core.files import atomic_path
from gof.footage.videos import stored_frames
from gof.look.drawing import Chart
from gof.look.images import data_uri
from gof.look.pages import template

CROP_HEIGHT = 320
MOVES = 40  # grey levels by which a pixel changes where there is flame or light
MOMENTS = 3  # at which the flame's motion is measured
FAST = 95  # percentile of the motion
BLUR_PX = 0.5  # of motion within the uncertainty: above, a reconstruction blurs
FIRE = 60  # red minus blue of a flame


@dataclass(frozen=True)
class FramesAround:
    """The frames of one camera around one moment.

    Attributes:
        before, after: (H, W, 3) uint8 RGB, of equal number, and nearest in time.
        before_ms, after_ms: when they were taken, after the moment.
        speed: px per ms, the flame's fast parts; 0 where nothing burns.
        changes: (H, W) how much each pixel changes between the frames that were looked at.
    """

    before: np.ndarray
    after: np.ndarray
    before_ms: float
    after_ms: float
    speed: float
    changes: np.ndarray


def write_report(path: Path, take: FrameTimesFile, charts: Mapping[str, Chart]) -> str:
    """Write the page, with the charts of the cameras' times by name. Returns the verdict in a sentence.

    Raises GofError as `align`.
    """
    alignment = align(take.cameras)
    timed = [(c, c.times) for c in take.cameras if c.times]
    moments = {c.name: look(c, times, alignment) for c, times in timed}
    speed = max(m.speed for m in moments.values())
    sigma = {c.name: max(f.sigma_us for f in times.frames) / 1000 for c, times in timed}
    worst = max(sigma, key=lambda name: sigma[name])
    estimated = [c.name for c, times in timed if times.clock != "board"]
    conclusion = verdict(worst, sigma[worst], speed, alignment, estimated)
    page = template("sync_report.html").render(
        verdict=conclusion,
        warned=sigma[worst] * speed > BLUR_PX or bool(estimated),
        strip=data_uri(strip(moments)[..., ::-1], "png"),
        rows=[_row(c.name, times, sigma[c.name], speed) for c, times in timed],
        warnings=take.warnings,
        residuals=[(name, chart.svg()) for name, chart in charts.items() if name in sigma],
    )
    with atomic_path(path) as temporary:
        temporary.write_text(page, encoding="utf-8")
    return conclusion


def verdict(worst: str, sigma_ms: float, speed: float, alignment: AlignedFrames, estimated: list[str]) -> str:
    """Return one sentence: the worst error in ms and in px of motion, and what pairing whole frames adds; and whose
    clock is only estimated."""
    motion = f", in which the flame's fast parts move {_short(sigma_ms * speed)} px" if speed else ""
    pair = alignment.worst_us / 1000
    paired = f" ({_short(pair * speed)} px)" if speed else ""
    return (
        f"The frame times are known to {_short(sigma_ms)} ms (one standard deviation, worst camera: {worst}){motion}; "
        f"frames paired whole, as in aligned videos, are up to {_short(pair)} ms apart{paired}."
        + (
            f" The clock of {', '.join(estimated)} is only estimated: a frame or two off is likely."
            if estimated
            else ""
        )
    )


def _short(value: float) -> str:
    return f"{value:.2f}" if value >= 0.1 else f"{value:.2g}"


def _row(name: str, times: VideoTimes, sigma_ms: float, speed: float) -> dict[str, str]:
    return {
        "name": name,
        "clock": "read from the board" if times.clock == "board" else "ESTIMATED from the flame",
        "sigma": _short(sigma_ms),
        "motion": _short(sigma_ms * speed) if speed else "no flame seen",
        "missing": missing_frames(times) or ("none" if times.clock == "board" else "not known"),
        "outliers": str(times.outliers),
    }


def look(camera: SyncedVideo, times: VideoTimes, alignment: AlignedFrames) -> FramesAround:
    """Read the frames of one camera around the middle of what all cameras filmed, and at other moments its flame's
    speed."""
    chosen = alignment.frames[camera.name]
    last = len(times.frames) - 1
    at = np.linspace(0, len(chosen) - 1, MOMENTS + 2).astype(int)[1:-1]
    middle = at[len(at) // 2]
    first = next(iter(alignment.frames.values()))
    before = min(int(first[middle]), last)
    pairs = [(int(chosen[k]), min(int(chosen[k]) + 1, last)) for k in at]
    wanted = {before, *(k for pair in pairs for k in pair)}
    frames = {k: f for k, f in enumerate(_until(Path(camera.video), max(wanted))) if k in wanted}
    grey = np.stack([f.max(2) for f in frames.values()])
    time_ms = [1e3 * (f.time_s - alignment.time_s[middle]) for f in times.frames]
    per_frame = [motion(frames[a], frames[b]) for a, b in pairs if a < b]
    speed = max(per_frame, default=0.0) / (1e-3 * times.frame_interval_us)
    after = int(chosen[middle])
    return FramesAround(
        frames[before], frames[after], time_ms[before], time_ms[after], speed, grey.max(0).astype(int) - grey.min(0)
    )


def _until(video: Path, last: int):
    for k, frame in enumerate(stored_frames(video)):
        yield frame
        if k == last:
            return


def motion(a: np.ndarray, b: np.ndarray) -> float:
    """px by which the flame's fast parts move between two (H, W, 3) RGB frames (optical flow, 95th percentile of what
    burns); 0 where less than a hundred pixels burn."""
    import cv2

    burns = cv2.subtract(a[..., 0], a[..., 2]) > FIRE
    if burns.sum() < 100:
        return 0.0
    at_rest = np.zeros((*a.shape[:2], 2), np.float32)
    flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM).calc(
        cv2.cvtColor(a, cv2.COLOR_RGB2GRAY), cv2.cvtColor(b, cv2.COLOR_RGB2GRAY), at_rest
    )
    return float(np.percentile(np.linalg.norm(flow, axis=2)[burns], FAST))


def strip(moments: dict[str, FramesAround]) -> np.ndarray:
    """Return (H, W, 3) uint8 BGR: one row of crops before, one after; each with its camera and time."""
    import cv2

    rows = []
    for word in ("before", "after"):
        crops = []
        for name, m in moments.items():
            box = _box(m.changes)
            crop = getattr(m, word)[box]
            width = max(1, round(crop.shape[1] * CROP_HEIGHT / crop.shape[0]))
            crop = cv2.cvtColor(cv2.resize(crop, (width, CROP_HEIGHT), interpolation=cv2.INTER_AREA), cv2.COLOR_RGB2BGR)
            crop = cv2.copyMakeBorder(crop, 4, 26, 4, max(4, 250 - width), cv2.BORDER_CONSTANT, value=(0, 0, 0))
            text = f"{word}: {name} {round(getattr(m, word + '_ms'), 3) + 0.0:+.3f} ms"
            cv2.putText(
                crop, text, (4, CROP_HEIGHT + 22), cv2.FONT_HERSHEY_SIMPLEX, 0.45, (225, 225, 225), 1, cv2.LINE_AA
            )
            crops.append(crop)
        rows.append(np.hstack(crops))
    return np.vstack(rows)


def _box(changes: np.ndarray) -> tuple[slice, slice]:
    """Around what changes, with a margin; the whole picture where nothing does."""
    import cv2

    spots = cv2.medianBlur((changes > MOVES).astype(np.uint8), 5) > 0
    if not spots.any():
        return slice(None), slice(None)
    rows, columns = (_with_margin(np.flatnonzero(spots.any(axis))) for axis in (1, 0))
    return rows, columns


def _with_margin(seen: np.ndarray, margin: int = 20) -> slice:
    """Return the slice from the first to the last of these numbers, with a margin, px."""
    return slice(max(0, int(seen[0]) - margin), int(seen[-1]) + margin)
