"""`gof capture sync`: footage of the board from any number of cameras -> the time of every row of every frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, ClassVar, Literal, get_args

import tyro

from gof.capture.aligned import Codec, Layout, write_aligned
from gof.capture.board_points import read_board_points
from gof.capture.boardless import NO_BOARD, synchronise_without_board
from gof.capture.decode import DecodeOptions
from gof.capture.recognise import AUTO, first_frames, recognise
from gof.capture.ring_board import RingBoard
from gof.capture.sync import Sensor, sensor, synchronise
from gof.capture.times import FILE, FrameTimesFile, Readout, SyncedVideo
from gof.capture.warnings import missing_frames
from gof.commands.everywhere import require_free, require_writable, write_figures
from gof.commands.read import Microseconds, Rate, read_options
from gof.core.errors import GofError
from gof.core.records import write_record
from gof.footage.videos import chapter_lines, distinct_names, require_different
from gof.host.options import require_all_positive, require_not_given, require_number, require_positive
from gof.look.charts import frame_times_chart
from gof.look.drawing import Chart
from gof.look.sync_report import write_report

NO_MARKER = (
    "is it whole, lit, and at least about 20 pixels wide? A board of your own wants --board FILE; where its marker is "
    "partly hidden all through the take, name the board (--board gof_board) and mark four points of it: --board-points"
)
OF_BOARDS = ("board_points", "tick_us", "clock", "row_time", "readout", "estimate")  # options
WAYS_OUT = (
    "Without a board, give gof ingest the cameras' rate, and a frame of each that shows one moment: "
    "--times 240 --start 0 7 0"
)


@dataclass(frozen=True)
class SyncConfig:
    """Read the time of every frame, for any number of cameras on one clock: from footage of the LED board, else from
    the films' sound or the flames' light.

    Examples:
      gof capture sync cam_0.mp4 cam_1.mp4 cam_2.mp4 --out sync

    Writes OUT/times.json and one residual plot per camera.
    """

    FIRST: ClassVar = ("out", "board", "board_points", "tick_us", "fps", "clock", "row_time")

    videos: tyro.conf.Positional[Annotated[list[Path], tyro.conf.arg(metavar="VIDEO ...")]]
    """The cameras' own files of one take, in the order gof ingest gets them."""
    out: Path | None = None
    """Folder for times.json and the plots; a times.json that is there is kept. Default: "sync" beside the first
    video."""
    board: str = "auto"
    """Board in the pictures: "auto" recognises a built-in one (gof_board, paper_rig, rocsync); or its name, or the JSON
    file of your own. A board that contradicts the pictures is refused. Where "auto" finds none, and with "none", the
    films' sound or else the flames' light synchronises the clocks."""
    board_points: Path | None = None
    """JSON of points of the board marked by hand, for cameras in which its marker is partly hidden or cut off:
    {"cam_1": {"corners": {"0": [x, y]}, "leds": {"5": [x, y]}}}, four or more in all; see docs/capture.md."""
    tick_us: Microseconds = 400.0
    """Tick the board was set to; its period is 10 ticks. A RocSync board has one speed and needs none."""
    fps: list[Rate] | None = None
    """True capture rate, one for all or one per video; read from the counter when not given."""
    row_time: Annotated[str | None, tyro.conf.arg(metavar="US|SENSOR")] = None
    """Delay from one image line to the next in microseconds, or a sensor of the table (gopro_hero13_720p400) where the
    footage shows all sensor rows; measured when not given."""
    readout: Readout | None = None
    """Direction in which lines are read later, as the picture is stored; measured when not given."""
    clock: Literal["steady", "free"] = "steady"
    """steady: frames come at equal distances (action cameras, machine cameras); free: phones with a varying rate."""
    estimate: bool = True
    """Do not estimate the clock of a camera that does not show the board from the flame, against the cameras that do:
    such a clock is good to about a frame, and marked so."""
    report: bool = True
    """Do not write OUT/report.html: crops of all cameras at one moment, before and after, and how sure the times
    are."""
    write_videos: Annotated[str | None, tyro.conf.arg(metavar="LAYOUT[:mpeg4]")] = None
    """Also write aligned videos, in which equal frame numbers are equal times, into OUT/aligned, where the named
    program looks for them (pose2sim, freemocap, opencap), or plainly (plain). Whole frames are chosen, never blended.
    Lossless (FFV1, .avi), or with plain:mpeg4 a twentieth of the size (.mp4, 37 dB PSNR)."""


def main(argv: list[str]) -> int:
    """`gof capture sync VIDEO... [--out FOLDER]`; see --help."""
    take = find_clocks(read_options(SyncConfig, "capture sync", argv))
    write_figures(replace(take, cameras=tuple(map(without_frames, take.cameras))))
    return 0


def find_clocks(config: SyncConfig) -> FrameTimesFile:
    """Decode all videos, write times.json and the files that options name, and print the findings.

    Raises:
        GofError: no camera can be decoded; an option that holds nothing; a times.json is there. Nothing is written.
    """
    require_positive("--tick-us", config.tick_us)
    require_all_positive("--fps", config.fps)
    known, row_time_us = row_time(config)
    written = layout_and_codec(config.write_videos)
    folder = config.out or require_writable(config.videos[0].absolute().parent) / "sync"
    target = folder / FILE
    require_free(target)
    decoding = options(config, row_time_us)
    names = distinct_names(config.videos)
    require_different(config.videos)
    for line in chapter_lines(config.videos):
        print(line)
    board = None if config.board == NO_BOARD else recognise(config.board, first_frames(config.videos))
    if board is None:
        reason = "--board none" if config.board == NO_BOARD else f"no board is recognised ({NO_MARKER})"
        require_not_given(config, OF_BOARDS, f"for the light of a board's lamps, and {reason}")
        return sync_without_board(config, decoding, names, folder, written)
    if isinstance(board, RingBoard):
        why = "a ring board has one speed, and is found anew in every frame by its marker, which must be whole"
        require_not_given(config, ("tick_us", "board_points"), why)
    points = None
    if config.board_points is not None and not isinstance(board, RingBoard):
        points = read_board_points(config.board_points, board, names)
    charts: dict[str, Chart] = {}

    def draw(name: str, *seen) -> None:
        charts[name] = frame_times_chart(name, *seen)

    result = synchronise(config.videos, board, decoding, draw, known, config.estimate, points)
    if not any(camera.times for camera in result.cameras):
        raise GofError(f"no camera could be decoded with board '{board.name}': {said_once(result)} {WAYS_OUT}")
    write_record(target, result)
    for name, chart in charts.items():
        chart.write(folder / f"residuals_{name}.png")
    if config.board == AUTO:
        print(f"board: {board.name}, recognised from the pictures")
    for camera in result.cameras:
        print(describe(camera))
    for warning in result.warnings:
        print(f"warning: {warning}")
    print(f"wrote {target}")
    write_beside(folder, config.report, written, result, charts)
    return result


def sync_without_board(
    config: SyncConfig,
    decoding: list[DecodeOptions],
    names: list[str],
    folder: Path,
    written: tuple[Layout, Codec] | None,
) -> FrameTimesFile:
    """Write times.json by the films' sound, else by the flames' light, and print what was used."""
    try:
        result, notes = synchronise_without_board(config.videos, [option.fps for option in decoding])
    except GofError as e:
        raise GofError(
            f"no camera could be decoded: {', '.join(names)}: the marker of a known LED board is not there "
            f"({NO_MARKER}), and {e}. {WAYS_OUT}"
        ) from e
    write_record(folder / FILE, result)
    clock = next(camera.times.clock for camera in result.cameras if camera.times)
    used = {"sound": "the films' sound", "flame": "the flames' light"}[clock]
    print(f"board: none is seen; clocks by {used}, {names[0]}'s is the common one")
    for camera in result.cameras:
        print(describe(camera))
    for note in notes:
        print(f"note: {note}")
    for warning in result.warnings:
        print(f"warning: {warning}")
    print(f"wrote {folder / FILE}")
    write_beside(folder, config.report, written, result, {})
    return result


def said_once(take: FrameTimesFile) -> str:
    """Return each reason with the cameras that it holds for."""
    cameras: dict[str, list[str]] = {}
    for camera in take.cameras:
        cameras.setdefault(str(camera.error), []).append(camera.name)
    return " ".join(f"{', '.join(names)}: {reason.rstrip('.?')}." for reason, names in cameras.items())


def write_beside(
    out: Path, report: bool, videos: tuple[Layout, Codec] | None, take: FrameTimesFile, charts: Mapping[str, Chart]
) -> None:
    """Write the report and the aligned videos that the options request; one camera alone has neither."""
    together = sum(camera.times is not None for camera in take.cameras) > 1
    if report and together:
        print(write_report(out / "report.html", take, charts))
        print(f"wrote {out / 'report.html'}")
    if videos is not None:
        folder = out / "aligned"
        alignment = write_aligned(folder, take, *videos, trial=out.name)
        apart = f"up to {alignment.worst_us / 1000:.2f} ms apart"
        print(f"wrote {len(alignment.time_s)} aligned frames per camera, {apart} -> {folder}")


def row_time(config: SyncConfig) -> tuple[Sensor | None, float | None]:
    """Return the sensor of --row-time, or its number in microseconds. Raises GofError: it is neither."""
    if config.row_time is None:
        return None, None
    try:
        value = float(config.row_time)
    except ValueError:
        return sensor(config.row_time), None
    require_number("--row-time", value, least=0)
    return None, value


def layout_and_codec(asked: str | None) -> tuple[Layout, Codec] | None:
    """Return the layout and codec by --write-videos. Raises GofError: no such layout, or codec."""
    if asked is None:
        return None
    layout, _, codec = asked.partition(":")
    layouts, codecs = get_args(Layout), get_args(Codec)
    if layout not in layouts or codec not in ("", *codecs):
        raise GofError(f"--write-videos {asked}: give {', '.join(layouts)}, and behind a colon {' or '.join(codecs)}")
    return layouts[layouts.index(layout)], codecs[codecs.index(codec or "lossless")]


def options(config: SyncConfig, row_time_us: float | None) -> list[DecodeOptions]:
    """Return one per video. Raises GofError: another number of rates than videos."""
    count = len(config.videos)
    rates: Sequence[float | None] = config.fps or [None]
    if len(rates) not in (1, count):
        raise GofError(f"--fps: give one rate or one per video ({count}), got {len(rates)}")
    common = DecodeOptions(10 * config.tick_us, None, row_time_us, config.readout, config.clock)
    return [replace(common, fps=rate) for rate in (rates if len(rates) > 1 else [rates[0]] * count)]


def without_frames(camera: SyncedVideo) -> SyncedVideo:
    return replace(camera, times=camera.times and replace(camera.times, frames=()))


def describe(camera: SyncedVideo) -> str:
    """Return one line of figures, or why there are none."""
    times = camera.times
    if times is None:
        return f"{camera.name:<16} not decoded: {camera.error}"
    if times.clock == "sound":
        return f"{camera.name:<16} {times.fps:.4f} fps  by SOUND, +-{times.systematic_us / 1000:.1f} ms"
    if times.clock == "flame":
        return f"{camera.name:<16} {times.fps:.4f} fps  ESTIMATED from the flame, +-{times.systematic_us / 1000:.1f} ms"
    missing = sum(times.dropped_before.values())
    gaps = f"  {missing} frames missing ({missing_frames(times)})" if missing else ""
    return (
        f"{camera.name:<16} {times.fps:.4f} fps  rms {times.rms_us:.2f} us (max {times.max_residual_us:.1f}, "
        f"{times.outliers} outliers)  rows {times.row_time_us:.3f} us/px {times.readout}  "
        f"exposure {times.exposure_us or 0:.0f} us  {times.cost.frames_per_second:.0f} frames/s{gaps}"
    )
