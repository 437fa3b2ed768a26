"""`gof capture sync`: footage of the board from any number of cameras -> the time of every row of every frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import tyro

from gof.capture.aligned import Codec, Layout, write_aligned
from gof.capture.board_points import read_board_points
from gof.capture.decode import DecodeOptions
from gof.capture.doubts import missing_frames
from gof.capture.recognise import AUTO, recognise
from gof.capture.ring_board import RingBoard
from gof.capture.sensors import sensor
from gof.capture.sync import synchronise
from gof.capture.times import FILE, FrameTimesFile, Readout, SyncedVideo
from gof.commands.board_option import first_frames, renamed
from gof.core.errors import GofError
from gof.core.records import write_record
from gof.footage.videos import distinct_names, require_different
from gof.host.options import require_all_positive, require_number, require_positive
from gof.look.charts import Chart, frame_times_chart
from gof.look.sync_report import write_report

NO_MARKER = (
    "is it whole, lit, and at least about 20 pixels wide? A board of your own wants --board FILE; where its marker is "
    "partly hidden all through the take, name the board (--board gof_board) and mark four points of it: --board-points"
)
WAYS_OUT = (
    "Without a board, give gof ingest the cameras' rate, and a frame of each that shows one moment: "
    "--fps 240 --start 0 7 0"
)


@dataclass(frozen=True)
class SyncConfig:
    """Read the time of every frame from footage of the LED board, for any number of cameras on one clock.

    Writes OUT/times.json and one residual plot per camera.
    """

    videos: tyro.conf.Positional[Annotated[list[Path], tyro.conf.arg(metavar="VIDEO ...")]]
    """The cameras' own files of one take, in the order gof ingest gets them."""
    out: Path
    """Folder for times.json and the plots."""
    overwrite: bool = False
    """Replace the times.json that is in the folder already."""
    board: str = "auto"
    """Board in the pictures: "auto" recognises a built-in one (gof_board, paper_rig, rocsync); or its name, or the JSON
    file of your own. A board that the pictures speak against is refused."""
    board_points: Path | None = None
    """JSON of points of the board marked by hand, for cameras in which its marker is partly hidden or cut off:
    {"cam_1": {"corners": {"0": [x, y]}, "leds": {"5": [x, y]}}}, four or more in all; see docs/capture.md."""
    tick_us: float = 400.0
    """Tick the board was set to; its period is 10 ticks. A RocSync board has one speed and needs none."""
    fps: list[float] | None = None
    """True capture rate, one for all or one per video; read from the counter when not given."""
    row_time_us: float | None = None
    """Delay from one image line to the next; measured when not given."""
    sensor: str | None = None
    """Take the row time from the sensor table instead (gopro_hero13_720p400): footage that shows all sensor rows."""
    readout: Readout | None = None
    """Direction in which lines are read later, as the picture is stored; measured when not given."""
    clock: Literal["steady", "free"] = "steady"
    """steady: frames come at equal distances (action cameras, machine cameras); free: phones with a varying rate."""
    estimate: bool = True
    """Where a camera does not show the board: estimate its clock from the flame, against the cameras that do. Good to
    about a frame, and marked so."""
    report: bool = True
    """Write OUT/report.html: crops of all cameras at one moment, before and after, and how sure the times are."""
    write_videos: Layout | None = None
    """Also write aligned videos, in which equal frame numbers are equal times, into OUT/aligned, where the named
    program looks for them (pose2sim, freemocap, opencap), or plainly. Whole frames are chosen, never blended."""
    video_codec: Codec = "lossless"
    """Of aligned videos: lossless (FFV1, .avi) or mpeg4 (.mp4, a twentieth of the size, 37 dB PSNR)."""
    json: Path | None = None
    """Also write the figures (without the frames) to this file."""


def main(argv: list[str]) -> int:
    """Decode all videos; fails, and writes nothing, only when no camera can be decoded."""
    config = tyro.cli(SyncConfig, prog="gof capture sync", args=renamed(argv))
    require_positive("--tick-us", config.tick_us)
    require_all_positive("--fps", config.fps)
    require_number("--row-time-us", config.row_time_us, least=0)
    target = config.out / FILE
    if target.exists() and not config.overwrite:
        raise GofError(f"{target}: already there; choose another --out, or replace it with --overwrite")
    if config.sensor and config.row_time_us is not None:
        raise GofError("give either --sensor or --row-time-us")
    known = sensor(config.sensor) if config.sensor else None
    decoding = options(config)
    names = distinct_names(config.videos)
    require_different(config.videos)
    board = recognise(config.board, first_frames(config.videos))
    if board is None:
        raise GofError(
            f"no camera could be decoded: {', '.join(names)}: the marker of a known LED board is not there: "
            f"{NO_MARKER}. {WAYS_OUT}"
        )
    points = None
    if config.board_points is not None:
        if isinstance(board, RingBoard):
            raise GofError("--board-points: a ring board is found anew in every frame; its marker must be whole")
        points = read_board_points(config.board_points, board, names)
    charts: dict[str, Chart] = {}

    def draw(name: str, *seen) -> None:
        charts[name] = frame_times_chart(name, *seen)

    result = synchronise(config.videos, board, decoding, draw, known, config.estimate, points)
    if not any(camera.times for camera in result.cameras):
        raise GofError(f"no camera could be decoded with board '{board.name}': {said_once(result)} {WAYS_OUT}")
    write_record(target, result)
    for name, chart in charts.items():
        chart.write(config.out / f"residuals_{name}.png")
    if config.board == AUTO:
        print(f"board: {board.name}, recognised from the pictures")
    for camera in result.cameras:
        print(describe(camera))
    for warning in result.warnings:
        print(f"warning: {warning}")
    print(f"wrote {target}")
    write_beside(config, result, charts)
    if config.json:
        write_record(config.json, replace(result, cameras=tuple(map(without_frames, result.cameras))))
    return 0


def said_once(take: FrameTimesFile) -> str:
    """Each reason with the cameras that it holds for."""
    cameras: dict[str, list[str]] = {}
    for camera in take.cameras:
        cameras.setdefault(str(camera.error), []).append(camera.name)
    return " ".join(f"{', '.join(names)}: {reason.rstrip('.?')}." for reason, names in cameras.items())


def write_beside(config: SyncConfig, take: FrameTimesFile, charts: Mapping[str, Chart]) -> None:
    """The report and the aligned videos, as asked for; one camera alone has neither."""
    together = sum(camera.times is not None for camera in take.cameras) > 1
    if config.report and together:
        print(write_report(config.out / "report.html", take, charts))
        print(f"wrote {config.out / 'report.html'}")
    if config.write_videos:
        folder = config.out / "aligned"
        alignment = write_aligned(folder, take, config.write_videos, config.video_codec, trial=config.out.name)
        apart = f"up to {alignment.worst_us / 1000:.2f} ms apart"
        print(f"wrote {len(alignment.time_s)} aligned frames per camera, {apart} -> {folder}")


def options(config: SyncConfig) -> list[DecodeOptions]:
    """One per video. Raises GofError: another number of rates than videos."""
    count = len(config.videos)
    rates = config.fps or [None]
    if len(rates) not in (1, count):
        raise GofError(f"--fps: give one rate or one per video ({count}), got {len(rates)}")
    common = DecodeOptions(10 * config.tick_us, None, config.row_time_us, config.readout, config.clock)
    return [replace(common, fps=rate) for rate in (rates * count if len(rates) == 1 else rates)]


def without_frames(camera: SyncedVideo) -> SyncedVideo:
    return replace(camera, times=camera.times and replace(camera.times, frames=()))


def describe(camera: SyncedVideo) -> str:
    """One line of figures, or why there are none."""
    times = camera.times
    if times is None:
        return f"{camera.name:<16} not decoded: {camera.error}"
    if times.clock == "flame":
        return f"{camera.name:<16} {times.fps:.4f} fps  ESTIMATED from the flame, +-{times.systematic_us / 1000:.1f} ms"
    missing = sum(times.dropped_before.values())
    gaps = f"  {missing} frames missing ({missing_frames(times)})" if missing else ""
    return (
        f"{camera.name:<16} {times.fps:.4f} fps  rms {times.rms_us:.2f} us (max {times.max_residual_us:.1f}, "
        f"{times.outliers} outliers)  rows {times.row_time_us:.3f} us/px {times.readout}  "
        f"exposure {times.exposure_us or 0:.0f} us  {times.cost.frames_per_second:.0f} frames/s{gaps}"
    )
