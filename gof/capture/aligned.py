"""Videos of one take cut and thinned so that equal frame numbers are equal times, for software that takes frame numbers
for times. Frames are chosen, never blended: what is left is up to half a frame interval per camera."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Literal

import numpy as np

from gof.capture.times import FrameTimesFile, SyncedVideo
from gof.core.errors import DataFormatError, GofError
from gof.core.files import atomic_path
from gof.footage.videos import stored_frames

Layout = Literal["plain", "pose2sim", "freemocap", "opencap"]
Codec = Literal["lossless", "mpeg4"]
CODECS = {"lossless": ("FFV1", ".avi"), "mpeg4": ("mp4v", ".mp4")}


@dataclass(frozen=True)
class AlignedFrames:
    """The stored frames that belong together.

    Attributes:
        time_s: (T,) instants on the board's clock, at the slowest camera's rate.
        frames: by camera, (T,) the stored frame nearest to each instant.
        off_us: by camera, (T,) how much later than the instant that frame was taken.
    """

    time_s: np.ndarray
    frames: dict[str, np.ndarray]
    off_us: dict[str, np.ndarray]

    @property
    def fps(self) -> float:
        """Return the frame rate of the aligned videos."""
        return float(1 / np.median(np.diff(self.time_s)))

    @property
    def worst_us(self) -> float:
        """Return the largest time between two frames of one number."""
        off = np.stack(list(self.off_us.values()))
        return float((off.max(0) - off.min(0)).max())


def align(cameras: tuple[SyncedVideo, ...]) -> AlignedFrames:
    """Instants that all cameras with times filmed, and their nearest frames.

    Raises GofError: fewer than two cameras have times, or they share fewer than two instants.
    """
    time_s = {c.name: np.array([f.time_s for f in c.times.frames]) for c in cameras if c.times}
    if len(time_s) < 2:
        raise GofError("fewer than two cameras have times: there is nothing to align")
    step = max(1e-6 * c.times.frame_interval_us for c in cameras if c.times)
    begin = max(t[0] for t in time_s.values())
    end = min(t[-1] for t in time_s.values())
    first = next(iter(time_s.values()))
    start = first[np.searchsorted(first, begin - 0.5 * step)] if begin <= first[-1] else np.inf
    instants = start + step * np.arange(max(int((end - start) / step + 0.5) + 1, 0)) if start <= end else np.empty(0)
    if len(instants) < 2:
        raise GofError("the cameras share fewer than two instants: were they filming together?")
    frames = {name: np.abs(instants[:, None] - t).argmin(1) for name, t in time_s.items()}
    off = {name: 1e6 * (t[frames[name]] - instants) for name, t in time_s.items()}
    return AlignedFrames(instants, frames, off)


def write_aligned(out: Path, take: FrameTimesFile, layout: Layout, codec: Codec, trial: str = "take") -> AlignedFrames:
    """Write the videos, and `aligned_times.csv` with what each of their frames is.

    Raises:
        GofError: see `align`.   DataFormatError: a video cannot be read or written.
    """
    alignment = align(take.cameras)
    named = [c for c in take.cameras if c.times]
    for number, camera in enumerate(named):
        target = out / place(layout, number, camera.name, trial, CODECS[codec][1])
        target.parent.mkdir(parents=True, exist_ok=True)
        _write_video(target, _chosen(Path(camera.video), alignment.frames[camera.name]), alignment.fps, codec)
    with atomic_path(out / "aligned_times.csv") as temporary:
        temporary.write_text(_table(alignment), encoding="utf-8")
    return alignment


def place(layout: Layout, number: int, name: str, trial: str, suffix: str) -> Path:
    """Return where a program looks for the video of camera `number`; docs/capture.md names the sources."""
    if layout == "pose2sim":
        return Path("videos") / f"cam{number + 1:02d}{suffix}"
    if layout == "freemocap":
        return Path("synchronized_videos") / f"{name}{suffix}"
    if layout == "opencap":
        return Path("Videos") / f"Cam{number}" / "InputMedia" / trial / f"{trial}{suffix}"
    return Path(f"{name}{suffix}")


def _chosen(video: Path, wanted: np.ndarray) -> Iterator[np.ndarray]:
    """Yield the wanted frames (non-decreasing numbers), one at a time."""
    place = 0
    for k, frame in enumerate(stored_frames(video)):
        while place < len(wanted) and wanted[place] == k:
            yield frame
            place += 1
        if place == len(wanted):
            return
    raise DataFormatError(f"{video}: has fewer frames than its times say; run 'gof capture sync' on it again")


def _write_video(path: Path, frames: Iterator[np.ndarray], fps: float, codec: Codec) -> None:
    import cv2

    fourcc, first = cv2.VideoWriter.fourcc(*CODECS[codec][0]), next(frames)
    with atomic_path(path) as temporary:
        writer = cv2.VideoWriter(str(temporary), fourcc, fps, first.shape[1::-1])
        if not writer.isOpened():
            raise DataFormatError(f"{path}: OpenCV cannot write {codec} video here")
        for frame in chain([first], frames):
            writer.write(cv2.cvtColor(frame, cv2.COLOR_RGB2BGR))
        writer.release()


def _table(alignment: AlignedFrames) -> str:
    """CSV: frame of the aligned videos, its time, and for each camera the stored frame and how late it is."""
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    names = list(alignment.frames)
    table.writerow(["frame", "time_s", *(f"{n}_{what}" for n in names for what in ("frame", "off_us"))])
    for k, time in enumerate(alignment.time_s):
        own = [value for n in names for value in (alignment.frames[n][k], f"{alignment.off_us[n][k]:.1f}")]
        table.writerow([k, f"{time:.8f}", *own])
    return text.getvalue()
