"""Which frames of several videos belong together, and when each was taken.

Frames are paired by time, never by number: cameras may begin apart, differ in rate, or drop frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gof.capture.board_mask import board_mask, in_words, objection_to
from gof.capture.times import FILE, FrameTimesFile, SyncedVideo, VideoTimes
from gof.core.errors import DataFormatError, GofError
from gof.core.numbered import usual_step
from gof.core.records import read_record
from gof.footage.lens import Turn
from gof.footage.videos import VideoInfo, distinct_names
from gof.ingest.agreement import (
    number_notes,
    require_few_missing,
    require_few_repeats,
    require_one_beginning,
    require_one_length,
    require_one_rate,
    require_whole,
)
from gof.ingest.pairing import Pairing, pair

CLOCKWISE = ("down", "left", "up", "right")  # readout directions, each a clockwise quarter after the one before
QUARTERS = {"none": 0, "clockwise": 1, "half": 2, "counterclockwise": 3}
SAME_SHAPE = 0.02  # relative difference of two pictures' shapes: a smaller copy has whole pixels
ON_GRID = 0.2  # of a step: by how much a time stamp may miss where an even rate puts it; some are rounded to ms


@dataclass(frozen=True)
class FrameTimes:
    """The frames that are used, per camera, and their times.

    Attributes:
        frames: (T,) stored frame numbers.
        time_s: (T,) start of each frame on the dataset clock, on which camera 0's first is 0.
        row_time_s: from one stored line to the next.
        readout: direction of later lines in the picture.
        source: where the times are from, in words.
        notes: what a user should know of the frames, in words.
        boards: (H, W) uint8 per camera, 255 on the LED board in the stored picture, or None; empty where the times are
            not by a board.
    """

    frames: list[np.ndarray]
    time_s: list[np.ndarray]
    row_time_s: list[float]
    readout: list[str]
    source: str
    notes: tuple[str, ...] = ()
    boards: tuple[np.ndarray | None, ...] = ()

    @classmethod
    def of(
        cls, pairing: Pairing, clocks: list[np.ndarray], row_time_s: list[float], readout: list[str], source: str
    ) -> FrameTimes:
        """Return the paired frames' times on `clocks`, (N,) per camera, from camera 0's first on."""
        zero = clocks[0][pairing.frames[0][0]]
        time_s = [clock[frames] - zero for clock, frames in zip(clocks, pairing.frames, strict=True)]
        return cls(pairing.frames, time_s, row_time_s, readout, source, pairing.notes)

    def turned(self, turns: Sequence[Turn]) -> FrameTimes:
        """For pictures that are turned, one turn per camera: readout directions turn with them."""
        turned = [
            CLOCKWISE[(CLOCKWISE.index(r) + QUARTERS[turn]) % 4] for r, turn in zip(self.readout, turns, strict=True)
        ]
        return replace(self, readout=turned)


@dataclass(frozen=True)
class Timing:
    """Facts of the frame times, and which frames to use. One of `times`, `fps` and `stamps` is set.

    Attributes:
        times: times.json of `gof capture sync`, or None.
        fps: true capture rate of all videos, or one each; empty: not known.
        stamps: the files' own time stamps are true seconds.
        start: first frame of the first camera to use; or a frame of each that was taken at the same moment.
        limit: use at most so many frames; None for all.
        masks: whether the board that gave the times is masked.
    """

    times: Path | None = None
    fps: tuple[float, ...] = ()
    stamps: bool = False
    start: tuple[int, ...] = (0,)
    limit: int | None = None
    masks: bool = True

    def require_one_way(self) -> None:
        """Raise GofError: none or several ways to time are given."""
        if sum((self.times is not None, bool(self.fps), self.stamps)) != 1:
            raise GofError(
                "give the frame times with one of --times times.json (of 'gof capture sync'), --times RATE, or --times "
                "stamps (the files' own time stamps)"
            )

    def require_fitting(self, cameras: int, made: bool = True) -> None:
        """Check all that is known before a video is read.

        Args:
            made: whether the file of times is there already.
        Raises:
            DataFormatError: the file of times is none, or of another number of cameras.
            GofError: another number of rates or starts than of cameras.
        """
        if self.fps:
            _one_each("--times", self.fps, cameras)
        if self.times is None:
            _one_each("--start", self.start, cameras)
            return
        if len(self.start) != 1:
            raise GofError("--start: with --times give the first camera's only; the others' follow from the times")
        if made:
            _synced_videos(self.times, cameras)

    @property
    def begins_are_known(self) -> bool:
        """Whether it is known which frames were taken together, so that clips may differ in length."""
        return self.times is not None or len(self.start) > 1 or self.limit is not None


def read_frame_times(timing: Timing, videos: list[VideoInfo]) -> FrameTimes:
    """Return the times of videos that were read to their ends.

    Raises:
        DataFormatError, GofError: none or several ways to time are given; a file breaks off (unless `limit` says how
            many frames are wanted); see `measured_times`, `stated_times`.
    """
    timing.require_one_way()
    notes = require_whole(videos, timing.limit is not None)
    times = measured_times(timing, videos) if timing.times else stated_times(timing, videos)
    return replace(times, notes=(*notes, *times.notes))


# ---- by rate or time stamps ------------------------------------------------------------------------------------------


def stated_times(timing: Timing, videos: list[VideoInfo]) -> FrameTimes:
    """By the rate given, or by the files' own time stamps; films begin together, or one start each is of one moment.

    A rate gives equal steps, and a gap in the time stamps of a whole number of steps is a gap in time; so is one in the
    numbers of a folder's pictures.

    Raises:
        GofError: a rate that is not positive; another number of rates or starts than of videos; one rate for files that
            state different ones; time stamps that fit no one rate; clips of different length without
            their beginnings; a start beyond the end; fewer than two frames are left.
    """
    starts = _one_each("--start", timing.start, len(videos))
    for video, start in zip(videos, starts, strict=True):
        if not 0 <= start < video.frames:
            raise GofError(f"--start {start}: {video.path} has {video.frames} frames")
    if timing.stamps:
        ticks, source = [_stamps(video) for video in videos], "the files' time stamps"
    else:
        if len(timing.fps) == 1:
            require_one_rate(videos)
        rates = _one_each("--times", timing.fps, len(videos))
        if not min(rates) > 0:
            raise GofError(f"--times {min(rates):g}: must be positive")
        ticks = [_steps(video) / rate for video, rate in zip(videos, rates, strict=True)]
        source = f"{', '.join(f'{rate:g}' for rate in timing.fps)} frames per second"
    if len(timing.start) == 1:
        require_one_beginning(videos)
    one_moment = starts if len(timing.start) > 1 else [0] * len(videos)  # one start cuts films that begin together
    clocks = [tick - tick[frame] for tick, frame in zip(ticks, one_moment, strict=True)]
    if not timing.begins_are_known:
        require_one_length(videos, clocks)
    clocks = [_without_repeats(clock, video) for clock, video in zip(clocks, videos, strict=True)]
    together = "all cameras starting together" if not any(one_moment) else f"frames {starts} taken together"
    pairing = pair([video.path.name for video in videos], clocks, starts[0], timing.limit)
    count = len(videos)
    times = FrameTimes.of(pairing, clocks, [0.0] * count, ["down"] * count, f"{source}, {together}")
    return replace(times, notes=(*number_notes(videos), *times.notes))


def _one_each(flag: str, values: tuple, count: int) -> list:
    """Return a value for each of `count` videos, of one for all or one each. Raises GofError: another number of
    them."""
    if len(values) not in (1, count):
        raise GofError(f"{flag}: give one value for all videos, or one for each of the {count}")
    return list(values) * (count if len(values) == 1 else 1)


def _stamps(video: VideoInfo) -> np.ndarray:
    """Return (N,) s. Raises GofError: a folder of pictures, or stamps that do not grow."""
    if video.stamps_s is None:
        raise GofError(f"{video.path}: pictures have no time stamps; give the rate with --times")
    if len(video.stamps_s) > 1 and not np.diff(video.stamps_s).min() > 0:
        raise GofError(f"{video.path}: its time stamps do not grow with every frame; give the rate with --times")
    return video.stamps_s


def _without_repeats(clock: np.ndarray, video: VideoInfo) -> np.ndarray:
    """Return (N,) s with a frame that shows the one before again, and that one, at the time of what is before both, so
    that they are left out: who filled a gap shows the frame before it late, or the one after it early.

    Raises:
        DataFormatError: they are too many.
    """
    require_few_repeats(video)
    clock = clock.copy()
    for k in video.repeated:
        clock[max(k - 2, 0) : k + 1] = clock[max(k - 2, 0)]
    return clock


def _steps(video: VideoInfo) -> np.ndarray:
    """Return (N,) whole steps since the first frame: 0, 1, 2, ... where none is missing by the time stamps or file
    names.

    Raises:
        DataFormatError: by their names, too many of a folder's pictures are missing.
        GofError: no line through the stamps leaves all of them within `ON_GRID` steps.
    """
    if video.numbers is not None:
        require_few_missing(video)
        step = usual_step(list(video.numbers))
        return np.array([(number - video.numbers[0]) // step for number in video.numbers], np.float64)
    usual = video.usual_step_s
    if usual is None or video.stamps_s is None:
        return np.arange(video.frames or 0, dtype=np.float64)
    steps = np.maximum(np.rint(np.diff(video.stamps_s) / usual), 1)
    grid = np.concatenate([[0.0], np.cumsum(steps)])
    line = np.polynomial.Polynomial.fit(grid, video.stamps_s, 1)
    off = np.abs(line(grid) - video.stamps_s) / usual
    if off.max() > ON_GRID:
        raise GofError(
            f"{video.path}: has no one rate: by its time stamps frame {int(off.argmax())} is {off.max():.2f} frames "
            "off where an even rate would put it; if the stamps are true time, as phones write them, give --times "
            "stamps"
        )
    return grid


# ---- by the board ----------------------------------------------------------------------------------------------------


def measured_times(timing: Timing, videos: list[VideoInfo]) -> FrameTimes:
    """By `gof capture sync`. Frames are paired by the middle of the picture: where the flame is, whatever the readout.

    Raises:
        DataFormatError: not what `gof capture sync` writes, another number of cameras or frames, a camera without times
            (says which and why); too many moments lack a frame of some camera.
        GofError: the videos are in another order; a start beyond the end; the videos do not overlap; fewer than two
            frames are left.
    """
    timing.require_fitting(len(videos))
    assert timing.times is not None, "the way that was chosen"
    synced, cameras, notes = _read_sync(timing.times, videos)
    start = timing.start[0]
    if not 0 <= start < (videos[0].frames or 0):
        raise GofError(f"--start {start}: the first video has {videos[0].frames} frames")
    middles = [
        _without_repeats(np.array([frame.time_s for frame in camera.frames]), video)
        for camera, video in zip(cameras, videos, strict=True)
    ]
    pairing = pair([video.name for video in synced], middles, start, timing.limit, str(timing.times))
    # Sync gives the middle of the picture; a dataset's frame starts when its first line is read.
    begins = [middle - _readout_s(camera) / 2 for middle, camera in zip(middles, cameras, strict=True)]
    row_time_s = [_row_time_s(*each) for each in zip(cameras, videos, strict=True)]
    source = "gof capture sync"
    by_name = [(video.name, camera) for video, camera in zip(synced, cameras, strict=True)]
    estimated = [name for name, camera in by_name if camera.clock == "flame"]
    heard = [name for name, camera in by_name if camera.clock == "sound"]
    if estimated:
        source += f"; the clock of {', '.join(estimated)} is estimated from the flame"
    if heard:
        source += "; the clocks are by the films' sound"
    times = FrameTimes.of(pairing, begins, row_time_s, [camera.readout for camera in cameras], source)
    warnings = tuple(f"{name}: {warning}" for name, camera in by_name for warning in camera.warnings)
    guessed = (
        (f"the clock of {', '.join(estimated)} is estimated from the flame, to milliseconds",) if estimated else ()
    )
    if timing.masks:
        boards, masked = board_masks(by_name, [(video.width, video.height) for video in videos])
        times = replace(times, boards=boards, notes=(*times.notes, *masked))
    return replace(times, notes=(*notes, *guessed, *warnings, *times.notes))


def board_masks(
    cameras: list[tuple[str, VideoTimes]], sizes: list[tuple[int, int]]
) -> tuple[tuple[np.ndarray | None, ...], list[str]]:
    """Return each camera's mask (H, W) uint8 of the board in its stored picture, or None, and notes, in words.

    Args:
        cameras: name and times of each.   sizes: (width, height) of their stored pictures, px.
    """
    import cv2

    boards: list[np.ndarray | None] = []
    notes = []
    some = any(times.board_px for _, times in cameras)
    for (name, times), size in zip(cameras, sizes, strict=True):
        mask = board_mask(times.board_px, times.marker_px, (times.width, times.height)) if times.board_px else None
        objection = None if mask is None else objection_to(mask)
        if times.clock == "board" and times.board_px is None:
            objection = "no board mask: an older gof made times.json; 'gof capture annotate' makes one"
        elif some and times.clock != "board" and not times.board_px:
            objection = (
                "NO BOARD MASK, as it is not known where the board is: if it is in view, its lamps count as flame; "
                "mask it with 'gof capture annotate --footage ... --board-points FILE'"
            )
        if objection is not None:
            notes.append(f"{name}: {objection}")
        elif mask is not None:
            notes.append(f"{name}: {in_words(mask)}")
        boards.append(None if objection or mask is None else cv2.resize(mask, size))  # a copy may be smaller
    return tuple(boards), notes


def _synced_videos(path: Path, count: int) -> tuple[SyncedVideo, ...]:
    """Read a times.json. Raises DataFormatError: it is none, or of another number of videos."""
    if path.is_dir():
        hint = f"; give {path / FILE}" if (path / FILE).is_file() else f", with no {FILE} in it"
        raise DataFormatError(f"{path}: a folder{hint}")
    known = read_record(FrameTimesFile, path).cameras
    if len(known) != count:
        raise DataFormatError(f"{path}: has {len(known)} cameras; it must be made of the same {count} videos")
    return known


def _read_sync(path: Path, videos: list[VideoInfo]) -> tuple[list[SyncedVideo], list[VideoTimes], tuple[str, ...]]:
    """Return each video's entry of a times.json, the times that each of them has, and notes."""
    known = _synced_videos(path, len(videos))
    found, notes = _entries(path, known, videos)
    times = []
    for entry, video in zip(found, videos, strict=True):
        if entry.times is None:
            raise DataFormatError(
                f"{path}: camera '{entry.name}' has no times ({entry.error}); film the board whole and lit, "
                "leave this camera out, or give --times the rate"
            )
        if len(entry.times.frames) != video.frames:
            raise DataFormatError(
                f"{path}: camera '{entry.name}' has {len(entry.times.frames)} frames, its video {video.frames}"
            )
        times.append(entry.times)
    return found, times, notes


def _entries(
    path: Path, known: tuple[SyncedVideo, ...], videos: list[VideoInfo]
) -> tuple[list[SyncedVideo], tuple[str, ...]]:
    """Return the entry of each video: the one that was made of the same file, wherever it stands; for files that are
    none of those (copies in another format), what is left in its order, with a note.

    Raises:
        GofError: by their names, those are in another order.
    """
    places = {entry.fingerprint: k for k, entry in enumerate(known) if entry.fingerprint}
    chosen = [places.get(video.fingerprint or "") for video in videos]
    left = [k for k in range(len(known)) if k not in chosen]
    names = distinct_names([video.path for video in videos])
    theirs = [known[k].name for k in left]
    ours = [name for name, k in zip(names, chosen, strict=True) if k is None]
    if ours != theirs and sorted(ours) == sorted(theirs):
        raise GofError(f"{path}: was made of {', '.join(theirs)}, in this order; give the videos in that order")
    others = iter(left)
    found = [known[next(others) if k is None else k] for k in chosen]
    notes = tuple(
        f"{video.path.name}: not the file that {path.name} was made of ({Path(entry.video).name}); its frames are "
        "taken to be the same ones"
        for video, entry, k in zip(videos, found, chosen, strict=True)
        if k is None and entry.fingerprint
    )
    return found, notes


def _row_time_s(times: VideoTimes, video: VideoInfo) -> float:
    """Return the seconds from line to line of a video that may be a smaller copy of the one that was timed.

    Raises:
        DataFormatError: it is turned or cut, and lines or the board's place count.
    """
    across, along = (video.width, video.height) if times.readout in ("up", "down") else (video.height, video.width)
    wide, lines = (times.width, times.height) if times.readout in ("up", "down") else (times.height, times.width)
    if (times.row_time_us or times.board_px) and abs(across * lines - along * wide) > SAME_SHAPE * along * wide:
        raise DataFormatError(
            f"{video.path}: {video.width}x{video.height}, and the film that was timed {times.width}x{times.height}: a "
            "turned or cut copy. Give that film, or run gof capture sync on this one"
        )
    return times.row_time_us * 1e-6 * lines / along


def _readout_s(times: VideoTimes) -> float:
    """Return the time that a picture is read in, from its first to its last line."""
    lines = times.width if times.readout in ("left", "right") else times.height
    return times.row_time_us * 1e-6 * (lines - 1)
