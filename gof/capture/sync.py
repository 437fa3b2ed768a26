"""Footage of the board from any number of cameras -> the time of every row of every frame, on one clock."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import ClassVar

import numpy as np

from gof.capture.board_mask import Outlines, outlines_of
from gof.capture.board_points import BoardPoints
from gof.capture.decode import CameraTimes, DecodeOptions, decode
from gof.capture.flame_clock import estimate_times, read_light
from gof.capture.ring_board import RingBoard
from gof.capture.ring_decode import decode_ring
from gof.capture.ring_signals import RingSignals, read_ring_signals
from gof.capture.signals import Signals, read_signals
from gof.capture.strips import NotDecodable
from gof.capture.template import BoardTemplate
from gof.capture.times import (
    CounterReading,
    DecodingCost,
    FrameTime,
    FrameTimesFile,
    NearestFrame,
    SyncedVideo,
    VideoTimes,
)
from gof.capture.warnings import MOST_US, refusal, warnings_of
from gof.core.errors import DataFormatError, GofError
from gof.core.records import read_record
from gof.footage.videos import distinct_names, fingerprint, require_different, stated_fps, stated_frames
from gof.host.terminal import progress_bar


def synchronise(
    videos: list[Path],
    template: BoardTemplate | RingBoard,
    options: list[DecodeOptions],
    show: Callable[[str, CameraTimes, np.ndarray | None, float], None] | None = None,
    known: Sensor | None = None,
    estimate: bool = False,
    points: dict[str, BoardPoints] | None = None,
) -> FrameTimesFile:
    """Decode every video and put all on the board's clock.

    A video that cannot be decoded has an error instead of times, or estimated times.

    Args:
        template: the board; a ring board's period is its own, whatever the options say.
        options: one per video.
        show: called with every camera that was decoded: name, times, slots (S,) of the board's strips (None of a ring),
            and the board's period in us.
        known: gives the row time of pictures of any size.
        estimate: estimate the clock of a camera without the board from its flame.
        points: of the board, by video, marked where the marker is partly hidden.
    Raises:
        DataFormatError: a video is not there, or given twice.
    """
    require_different(videos)
    period_us = template.period_us if isinstance(template, RingBoard) else options[0].period_us
    slots = None if isinstance(template, RingBoard) else template.strip_slot
    names = distinct_names(videos)
    decoded: dict[str, _Decoded] = {}
    errors: dict[str, str] = {}
    for name, video, option in zip(names, videos, options, strict=True):
        try:
            decoded[name] = _decode_video(name, video, template, option, known, (points or {}).get(name))
        except GofError as e:
            errors[name] = str(e)
    times = {name: found.times for name, found in decoded.items()}
    settled = _settle_counts(times, period_us)
    apart = _apart(times)
    errors |= apart
    times = {name: found for name, found in times.items() if name not in apart}
    cameras = []
    for name, video in zip(names, videos, strict=True):
        camera = SyncedVideo(name, str(video), error=errors.get(name), fingerprint=fingerprint(video))
        if name in errors:
            cameras.append(camera)
            continue
        cameras.append(replace(camera, times=_describe(decoded[name], stated_fps(video))))
        if show:
            show(name, times[name], slots, period_us)
    if estimate:
        cameras = _estimate_missing(cameras)
    warnings = [
        *settled,
        *warnings_of(cameras, _most_us(template), period_us),
        *chain.from_iterable(map(_warnings_of, cameras)),
    ]
    return FrameTimesFile(template.name, period_us, tuple(cameras), nearest_frames(cameras), tuple(warnings))


def _warnings_of(camera: SyncedVideo) -> list[str]:
    """Return the warnings of a camera."""
    own = [] if camera.times is None else [*camera.times.faults, *camera.times.warnings]
    return [f"{camera.name}: {text}" for text in ([camera.error] if camera.error else []) + own]


def _estimate_missing(cameras: list[SyncedVideo]) -> list[SyncedVideo]:
    """Return cameras without a board get an estimated clock, where one with a board filmed the same flame; the others
    are kept, with the reason."""
    if all(c.times for c in cameras) or not any(c.times for c in cameras):
        return cameras
    known = {c.name: (Path(c.video), c.times, read_light(Path(c.video))) for c in cameras if c.times}
    found = []
    for camera in cameras:
        if camera.times is None:
            try:
                estimated = estimate_times(Path(camera.video), read_light(Path(camera.video)), known)
                warnings = (f"not decoded ({camera.error})", *estimated.warnings)
                camera = replace(camera, times=replace(estimated, warnings=warnings), error=None)
            except GofError as e:
                camera = replace(camera, error=f"{camera.error}; and no clock from the flame: {e}")
        found.append(camera)
    return found


RING_MOST = 0.1  # of a ring's step: an rms or systematic error above it is worth a look


def _most_us(board: BoardTemplate | RingBoard) -> float:
    return RING_MOST * board.step_us if isinstance(board, RingBoard) else MOST_US


@dataclass(frozen=True)
class _Decoded:
    """A video's times, its size (width, height), the marker's mean side in px, the polygons that the board covers, and
    the seconds it took to read and to decode them."""

    times: CameraTimes
    image_size: tuple[int, int]
    marker_px: float
    board_px: Outlines
    read_s: float
    decode_s: float


def _decode_video(
    name: str,
    video: Path,
    template: BoardTemplate | RingBoard,
    options: DecodeOptions,
    known: Sensor | None,
    points: BoardPoints | None,
) -> _Decoded:
    start = time.perf_counter()
    frames = stated_frames(video) or 0
    with progress_bar(f"read {name}") as update:

        def count(done: int) -> None:
            update(done, max(done, frames))

        signals: RingSignals | Signals
        if isinstance(template, RingBoard):
            signals = ring = read_ring_signals(video, template, progress=count)
        else:
            signals = strips = read_signals(video, template, progress=count, points=points)
    read = time.perf_counter()
    if known:  # sensors are wider than high: their rows are the shorter side, whichever way it is turned
        options = replace(options, row_time_us=known.image_row_time_us(min(signals.image_size)))
    if isinstance(template, RingBoard):
        times = decode_ring(ring, template, options)
    else:
        times = decode(strips, template, options)
    outliers = int((~times.used).sum()) - int((np.diff(times.clock_index) == 0).sum()) - times.hidden
    shown = len(times.used) - times.hidden
    if why := refusal(times.rms_us, times.systematic_us, outliers, shown, _most_us(template)):
        raise NotDecodable(why)
    # A ring board may be carried about: it has no one place.
    place = () if isinstance(template, RingBoard) else outlines_of(strips.board, template)
    return _Decoded(times, signals.image_size, signals.marker_px, place, read - start, time.perf_counter() - read)


def _settle_counts(decoded: dict[str, CameraTimes], period: float) -> list[str]:
    """Return cameras that do not see all counter LEDs take the candidate nearest to one that does, and cameras that
    started after the counter began anew are put behind those that started before: they filmed together."""
    warnings = []
    certain = [n for n, t in decoded.items() if len(t.count_candidates) == 1]
    if not decoded:
        return []
    if certain:
        reference = max(certain, key=lambda n: sum(_overlap(decoded[n], decoded[other]) for other in certain))
    else:
        reference = min(decoded, key=lambda n: len(decoded[n].count_candidates))
    if not certain:
        warnings.append(
            "no camera sees enough counter LEDs for a unique count; "
            f"the clock starts at the smallest that fits {reference}"
        )
    target = np.median(decoded[reference].time_us)
    for name, times in decoded.items():
        if name == reference:
            continue
        candidates = times.count_candidates - times.count_candidates[0]
        middle = np.median(times.time_us)
        shift = int(candidates[np.abs(middle + candidates * period - target).argmin()])
        around = shift + times.count_cycle * np.array([-1, 1])  # where only the turn of the counter lies between them
        around = around[np.abs(middle + around * period - target) < np.ptp(decoded[reference].time_us)]
        times.shift_periods(int(around[0]) if len(around) else shift, period)
        if len(candidates) > 1:
            warnings.append(
                f"{name}: its visible LEDs allow {len(candidates)} counts; took the one nearest to {reference}"
            )
    first = min(float(times.time_us[0]) for times in decoded.values())
    if first < 0:  # a whole cycle later is the same count
        for times in decoded.values():
            times.shift_periods(max(t.count_cycle for t in decoded.values()), period)
    return warnings


def _overlap(one: CameraTimes, other: CameraTimes) -> bool:
    return one.time_us[0] <= other.time_us[-1] and other.time_us[0] <= one.time_us[-1]


def _apart(decoded: dict[str, CameraTimes]) -> dict[str, str]:
    """Return cameras that filmed at no time that another one filmed, with what to say of them: a take is filmed
    together. All of them where no two agree."""
    if len(decoded) < 2:
        return {}
    together = {n: [o for o in decoded if o != n and _overlap(decoded[n], decoded[o])] for n in decoded}
    main = max(together, key=lambda n: len(together[n]))
    odd = [n for n in decoded if not together[main] or (n != main and n not in together[main])]
    spans = ", ".join(f"{n} {1e-6 * t.time_us[0]:.3f} to {1e-6 * t.time_us[-1]:.3f} s" for n, t in decoded.items())
    warning = (
        f"by the board's clock the cameras did not film at the same time ({spans}). Are the videos of one take, was "
        "the board restarted between them, or does each film another board?"
    )
    return dict.fromkeys(odd, warning)


def nearest_frames(cameras: list[SyncedVideo]) -> dict[str, NearestFrame]:
    """For each camera with times, its frame nearest to the first such camera's first frame."""
    time_s = {c.name: np.array([frame.time_s for frame in c.times.frames]) for c in cameras if c.times}
    nearest: dict[str, NearestFrame] = {}
    for name, own in time_s.items():
        first = next(iter(time_s.values()))
        offset = 1e6 * (own - first[0])
        k = int(np.abs(offset).argmin())
        nearest[name] = NearestFrame(k, round(float(offset[k]), 2))
    return nearest


def _describe(found: _Decoded, container_fps: float | None) -> VideoTimes:
    """Return the figures in the precision that they have."""
    t = found.times
    width, height = found.image_size
    repeated = np.concatenate([[False], np.diff(t.clock_index) == 0])
    missing = np.diff(t.clock_index) - 1
    per_frame = (t.time_us, t.sigma_us, t.measured_us, t.used)
    return VideoTimes(
        width=width,
        height=height,
        fps=round(float(1e6 / t.interval_us), 5),
        frame_interval_us=round(float(t.interval_us), 4),
        row_time_us=round(float(t.row_time_us), 4),
        readout=t.readout,
        frames=tuple(
            FrameTime(round(1e-6 * fused, 8), round(sigma, 3), round(1e-6 * own, 8), used)
            for fused, sigma, own, used in zip(*(a.tolist() for a in per_frame), strict=True)
        ),
        repeated_frames=tuple(np.flatnonzero(repeated).tolist()),
        dropped_before={str(k + 1): int(missing[k]) for k in np.flatnonzero(missing > 0)},
        rms_us=round(t.rms_us, 3),
        max_residual_us=round(t.max_us, 3),
        systematic_us=round(t.systematic_us, 3),
        outliers=int((~t.used & ~repeated).sum()) - t.hidden,
        exposure_us=None if t.exposure_us is None else round(t.exposure_us, 0),
        saturation=t.saturation,
        count=CounterReading(len(t.count_candidates), round(t.count_agreement, 5), t.count_readings),
        container_fps=container_fps,
        marker_px=round(found.marker_px, 1),
        faults=tuple(t.faults),
        warnings=tuple(t.warnings),
        cost=DecodingCost(
            round(found.read_s, 2),
            round(found.decode_s, 2),
            round(len(t.time_us) / (found.read_s + found.decode_s), 1),
        ),
        board_px=found.board_px,
    )


# ----------------------------------------------------------------
# Known rolling-shutter sensors, as data (sensors.json).


@dataclass(frozen=True)
class Sensor:
    """A camera mode.

    Attributes:
        width, height: native size in pixels.
        row_time_us: from sensor row to sensor row.
        source: where that is from.
    """

    camera: str
    width: int
    height: int
    fps: float
    row_time_us: float
    source: str

    def image_row_time_us(self, lines: int) -> float:
        """Return row time of a picture whose `lines` lines show all sensor rows.

        Raises: ValueError for lines < 1.
        """
        if lines < 1:
            raise ValueError(f"a picture with {lines} lines")
        return self.row_time_us * self.height / lines


@dataclass(frozen=True)
class SensorTable:
    """sensors.json, by name of the mode. The rest of it (measurements, notes) is for people."""

    SCHEMA: ClassVar[str] = "gof-sensors"
    VERSION: ClassVar[int] = 1

    sensors: dict[str, Sensor]


def sensor(name: str) -> Sensor:
    """Return a sensor of the table by name.

    Raises: DataFormatError: not in the table (names those that are).
    """
    table = read_record(SensorTable, Path(__file__).with_name("sensors.json")).sensors
    if name not in table:
        raise DataFormatError(
            f"no sensor '{name}' in the table; it has {', '.join(table)}. Or give the row time itself"
        )
    return table[name]
