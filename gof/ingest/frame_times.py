"""Which frames of several videos belong together, and when each was taken."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gof.capture.times import FrameTimesFile, SyncedVideo, VideoTimes
from gof.errors import DataFormatError, GofError
from gof.lens import Turn
from gof.records import read_record

CLOCKWISE = ("down", "left", "up", "right")  # readout directions, each a clockwise quarter after the one before
QUARTERS = {"none": 0, "clockwise": 1, "counterclockwise": 3}
MAX_STEP = 1.5  # of the usual time between frames; a longer one hides a dropped frame


@dataclass(frozen=True)
class FrameTimes:
    """The frames that are used, per camera, and their times.

    Attributes:
        frames: stored frame numbers, all of one length T.
        time_s: (T,) start of each frame on the dataset clock, on which camera 0's first is 0.
        row_time_s: from one stored line to the next.
        readout: direction of later lines in the picture.
        source: where the times are from, in words.
    """

    frames: list[range]
    time_s: list[np.ndarray]
    row_time_s: list[float]
    readout: list[str]
    source: str

    def turned(self, turn: Turn) -> FrameTimes:
        """For pictures that are turned: readout directions turn with them."""
        turned = [CLOCKWISE[(CLOCKWISE.index(r) + QUARTERS[turn]) % 4] for r in self.readout]
        return replace(self, readout=turned)


@dataclass(frozen=True)
class Timing:
    """What is known of the frame times, and which frames to use.

    Attributes:
        times: times.json of `gof capture sync`, or None.
        fps: true capture rate of all videos, or None.
        start: first frame of the first camera to use.
        limit: use at most so many frames; None for all.
    """

    times: Path | None = None
    fps: float | None = None
    start: int = 0
    limit: int | None = None


def read_frame_times(timing: Timing, counts: list[int]) -> FrameTimes:
    """The times by `gof capture sync`, or equal steps, for videos of `counts` frames.

    Raises:
        DataFormatError, GofError: neither or both are given; see `measured_times` and `equal_times`.
    """
    if (timing.times is None) == (timing.fps is None):
        raise GofError("give the frame times with either --times times.json (of 'gof capture sync') or --fps RATE")
    if timing.times is None:
        return equal_times(timing.fps, counts, timing.start, timing.limit)
    return measured_times(timing.times, counts, timing.start, timing.limit)


def equal_times(fps: float, counts: list[int], start: int, limit: int | None) -> FrameTimes:
    """Equal steps with all videos starting together.

    Raises:
        GofError: a rate that is not positive; fewer than two frames are left.
    """
    if not fps > 0:
        raise GofError(f"--fps {fps}: must be positive")
    cameras = len(counts)
    length = _length([count - start for count in counts], limit)
    return FrameTimes(
        frames=[range(start, start + length)] * cameras,
        time_s=[np.arange(length) / fps] * cameras,
        row_time_s=[0.0] * cameras,
        readout=["down"] * cameras,
        source=f"{fps:g} frames per second, all cameras starting together",
    )


def measured_times(path: Path, counts: list[int], start: int, limit: int | None) -> FrameTimes:
    """Each camera's clip starts at its frame nearest to the first camera's frame `start`; the clips end together.

    Frames are paired by the middle of the picture: where the flame is, whatever the readout direction.

    Raises:
        DataFormatError: not what `gof capture sync` writes, another number of cameras or frames, a camera without times
            (says which and why); dropped frames inside the range.
        GofError: the videos do not overlap; fewer than two frames are left.
    """
    videos = _read_sync(path, counts)
    cameras = [video.times for video in videos]
    middles = [np.array([frame.time_s for frame in camera.frames]) for camera in cameras]
    frames = paired_frames(path, [video.name for video in videos], middles, start, limit)
    # Sync gives the middle of the picture; a dataset's frame starts when its first line is read.
    starts = [m - _readout_s(camera) / 2 for m, camera in zip(middles, cameras, strict=True)]
    zero = starts[0][frames[0].start]
    time_s = [t[f.start : f.stop] - zero for t, f in zip(starts, frames, strict=True)]
    row_time_s = [camera.row_time_us * 1e-6 for camera in cameras]
    source = "gof capture sync"
    estimated = [v.name for v in videos if v.times.clock == "flame"]
    if estimated:
        source += f"; the clock of {', '.join(estimated)} is estimated from the flame"
    return FrameTimes(frames, time_s, row_time_s, [camera.readout for camera in cameras], source)


def paired_frames(path: Path, names: list[str], time_s: list[np.ndarray], start: int, limit: int | None) -> list[range]:
    """Frame numbers per camera, of one length: from each camera's frame nearest to the first camera's `start` on.

    Args:
        path: what to name in errors.   names: of the cameras.   time_s: of all frames of each, on one clock.
        start, limit: see `Timing`.
    Raises:
        DataFormatError: a frame is repeated or missing inside the range.
        GofError: the videos do not overlap; fewer than two frames are left.
    """
    first = _first_frames(path, time_s, start)
    length = _length([len(t) - k for t, k in zip(time_s, first, strict=True)], limit)
    frames = [range(k, k + length) for k in first]
    for name, t, used in zip(names, time_s, frames, strict=True):
        _require_steady(path, name, t[used.start : used.stop])
    return frames


def _read_sync(path: Path, counts: list[int]) -> list[SyncedVideo]:
    """The videos of a times.json, which all have times, for videos of `counts` frames."""
    videos = read_record(FrameTimesFile, path).cameras
    if len(videos) != len(counts):
        raise DataFormatError(f"{path}: has {len(videos)} cameras; it must be made of the same {len(counts)} videos")
    for video, count in zip(videos, counts, strict=True):
        if video.times is None:
            raise DataFormatError(
                f"{path}: camera '{video.name}' has no times ({video.error}); film the board whole and lit, "
                "leave this camera out, or use --fps"
            )
        if len(video.times.frames) != count:
            raise DataFormatError(
                f"{path}: camera '{video.name}' has {len(video.times.frames)} frames, its video {count}"
            )
    return list(videos)


def _readout_s(times: VideoTimes) -> float:
    """How long a picture is read, from its first to its last line."""
    lines = times.width if times.readout in ("left", "right") else times.height
    return times.row_time_us * 1e-6 * (lines - 1)


def _first_frames(path: Path, middles: list[np.ndarray], start: int) -> list[int]:
    """Each camera's frame nearest to the first camera's frame `start`, or to its first after all have begun."""
    reference = middles[0]
    if not 0 <= start < len(reference):
        raise GofError(f"--start {start}: the first video has {len(reference)} frames")
    begun = max(m[0] - 0.5 * np.median(np.diff(m)) for m in middles)
    together = np.flatnonzero(reference[start:] >= begun)
    if not len(together):
        raise GofError(f"{path}: the videos do not overlap in time")
    common = reference[start + together[0]]
    return [int(np.abs(m - common).argmin()) for m in middles]


def _require_steady(path: Path, name: str, time_s: np.ndarray) -> None:
    """Raises DataFormatError: a frame of the range is repeated or missing."""
    step = np.diff(time_s)
    usual = np.median(step)
    if step.min() <= 0 or step.max() > MAX_STEP * usual:
        raise DataFormatError(
            f"{path}: camera '{name}' repeats or drops frames at {int(np.argmax(np.abs(step - usual)))} of the paired "
            "range; choose a range without with --start and --frames"
        )


def _length(available: list[int], limit: int | None) -> int:
    """How many frames all cameras have, at most `limit`."""
    length = min(available) if limit is None else min(limit, *available)
    if length < 2:
        raise GofError(
            f"{length} frames are left in common; at least 2 are needed (check --start, --frames and the times)"
        )
    return length
