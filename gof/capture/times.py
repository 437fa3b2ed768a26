"""times.json: when every frame of every video was exposed. Written by `gof capture sync`, read by `gof ingest`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

from gof.capture.board_mask import Outlines

FILE = "times.json"
Readout = Literal["down", "up", "left", "right"]
Clock = Literal["board", "flame", "sound"]


@dataclass(frozen=True)
class FrameTime:
    """One stored frame.

    Attributes:
        time_s: mid-exposure of the picture's centre on the board's clock, fused from all frames.
        sigma_us: its standard error.
        measured_s: the frame's own measurement.
        used: False for outliers, which the fused times leave out.
    """

    time_s: float
    sigma_us: float
    measured_s: float
    used: bool


@dataclass(frozen=True)
class CounterReading:
    """Number of counts that the visible LEDs allow, and the share of clean LED readings that agrees with the first."""

    candidates: int
    agreement: float
    readings: int


@dataclass(frozen=True)
class DecodingCost:
    """Seconds spent on reading the video and on decoding it, and frames per second of both together."""

    read_s: float
    decode_s: float
    frames_per_second: float


@dataclass(frozen=True)
class VideoTimes:
    """The readings of one video.

    Attributes:
        width, height: of the stored picture, px.
        fps, frame_interval_us: of the camera's clock.
        row_time_us, readout: a pixel's own time adds row_time_us times its distance from the centre line that way.
        frames: one per stored frame.
        repeated_frames: stored frames that show the one before again.
        dropped_before: how many frames are missing before a stored frame, by its number.
        rms_us, max_residual_us: of measured minus fused times of used frames.
        systematic_us: uncertainty common to all frames.
        outliers: frames left out that are no repeats.
        exposure_us, saturation: estimated; None where no strip shows them.
        count: of the periods, by the LEDs; no candidates where there is no board.
        container_fps: what the file states; None when it states none.
        marker_px: mean side of the marker.
        faults: of the board's wiring.   warnings: other faults.
        clock: "board": read from it; "flame": estimated from other cameras' flame (`gof.capture.flame_clock`), all
            frames by `systematic_us` alike; nothing is known of gaps then. "sound": by the films' sound
            (`gof.capture.boardless`), and so are the frames' own time stamps.
        board_px: polygons that the board covers in the stored picture (`gof.capture.board_mask`); empty where no board
            with strips is seen; None in older files.
    """

    width: int
    height: int
    fps: float
    frame_interval_us: float
    row_time_us: float
    readout: Readout
    frames: tuple[FrameTime, ...]
    repeated_frames: tuple[int, ...]
    dropped_before: dict[str, int]
    rms_us: float
    max_residual_us: float
    systematic_us: float
    outliers: int
    exposure_us: float | None
    saturation: float | None
    count: CounterReading
    container_fps: float | None
    marker_px: float
    faults: tuple[str, ...]
    warnings: tuple[str, ...]
    cost: DecodingCost
    clock: Clock = "board"
    board_px: Outlines | None = None

    @classmethod
    def estimated(
        cls,
        size: tuple[int, int],
        times_s: Sequence[float],
        interval_us: float,
        sigma_us: float,
        clock: Clock,
        container_fps: float | None,
        warning: str,
    ) -> VideoTimes:
        """Return times that no board was read for, every frame's as uncertain. size: (width, height) px."""
        sigma_us = round(sigma_us, 3)
        return cls(
            width=size[0],
            height=size[1],
            fps=round(1e6 / interval_us, 5),
            frame_interval_us=round(interval_us, 4),
            row_time_us=0.0,
            readout="down",
            frames=tuple(FrameTime(round(t, 8), sigma_us, round(t, 8), True) for t in times_s),
            repeated_frames=(),
            dropped_before={},
            rms_us=0.0,
            max_residual_us=0.0,
            systematic_us=sigma_us,
            outliers=0,
            exposure_us=None,
            saturation=None,
            count=CounterReading(0, 0.0, 0),
            container_fps=container_fps,
            marker_px=0.0,
            faults=(),
            warnings=(warning,) if warning else (),
            cost=DecodingCost(0.0, 0.0, 0.0),
            clock=clock,
            board_px=(),
        )


@dataclass(frozen=True)
class SyncedVideo:
    """One video: its times, or why it has none.

    Attributes:
        fingerprint: by which `gof ingest` knows it again (`gof.footage.videos.fingerprint`); None in older files.
    """

    name: str
    video: str
    times: VideoTimes | None = None
    error: str | None = None
    fingerprint: str | None = None


@dataclass(frozen=True)
class NearestFrame:
    """The frame of a video that is nearest to the first video's first one, and its time after that one."""

    frame: int
    offset_us: float


@dataclass(frozen=True)
class FrameTimesFile:
    """times.json: all videos of one take, in the order given, on the board's clock (count 0 = 0 s).

    Attributes:
        template: name of the board's; "none" where there is no board, and the first film's clock is the common one.
        period_us: of the board's counter.
        nearest_frames: by the name of each video that has times.
        warnings: those of all videos.
    """

    SCHEMA: ClassVar[str] = "gof-times"
    VERSION: ClassVar[int] = 2

    template: str
    period_us: float
    cameras: tuple[SyncedVideo, ...]
    nearest_frames: dict[str, NearestFrame]
    warnings: tuple[str, ...]
