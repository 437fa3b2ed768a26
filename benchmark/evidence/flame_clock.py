"""How well clocks are estimated from the flame alone.

    python -m gof_benchmark.evidence.flame_clock [--captures FOLDER] [--json FILE]

Takes about 3 min. Needs the paper's clips.

The truth is what `gof capture sync` reads off the board in every camera (a few microseconds; half markers by marked
points), which the estimates are not given. First, cameras are taken for ones without a board, in turn. Then the board
is painted over in all three, and the clips are thinned to slower cameras that begin a part of a frame apart. Needs the
paper's clips.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from gof.capture.annotate import find_mask
from gof.capture.board_points import BoardPoints, points_on
from gof.capture.boardless import by_light
from gof.capture.decode import DecodeOptions
from gof.capture.flame_clock import FlameLight, NoFlameClock, estimate_times, light_of, read_light
from gof.capture.sync import synchronise
from gof.capture.template import BoardTemplate
from gof.capture.times import SyncedVideo, VideoTimes
from gof.core.files import write_json
from gof.footage.videos import stored_frames
from tests.capture.marked_views import MARKED

THINNED = (1, 2, 4)  # every so manieth frame: 400, 200 and 100 fps
BEGIN = ((0, 0, 0), (0, 1, 3), (2, 0, 1))  # frames of 2.5 ms that the thinned cameras leave out at their starts


@dataclass(frozen=True)
class FlameClock:
    """Error of clocks estimated from the flame, on cameras whose clock is known."""

    captures: Path = Path(os.environ.get("GOF_CAPTURES", Path(__file__).parents[3] / "shared" / "captures"))
    """Folder of the public clips; GOF_CAPTURES names it too."""
    json: Path | None = None
    """Also write the figures to this file."""


def main(argv: list[str] | None = None) -> None:
    """Print the table, and the errors' size over all."""
    config = tyro.cli(FlameClock, prog="python -m gof_benchmark.evidence.flame_clock", args=argv)
    scenes = sorted(p.parent for p in config.captures.glob("*/*/cam_0.mp4"))
    if not scenes:
        print(f"skipped: no clips at {config.captures} (give --captures, or set GOF_CAPTURES)")
        return
    board = BoardTemplate.load("paper_rig")
    rows, without = [], []
    print("| clip | camera | against | error (ms) | stated +- (ms) |")
    print("|---|---|---|---|---|")
    for folder in scenes:
        scene = f"{folder.parent.name}/{folder.name}"
        videos = sorted(folder.glob("cam_*.mp4"))
        points = {c: points_on(board, *marks, c) for c, marks in MARKED.get(scene, {}).items()}
        cameras = synchronise(videos, board, [DecodeOptions()] * len(videos), points=points).cameras
        rows += leave_out(cameras, scene)
        without += no_board(cameras, scene, board, points)
    for size, rated in (
        ("one", [r for r in rows if r["cameras"] == 1]),
        ("all others", [r for r in rows if r["cameras"] > 1]),
    ):
        error = np.array([r["error_ms"] for r in rated if r["error_ms"] is not None])
        if len(error):
            inside = sum(abs(r["error_ms"]) <= r["sigma_ms"] for r in rated if r["error_ms"] is not None)
            print(
                f"\nagainst {size}: {len(error)} of {len(rated)} estimated; rms {np.sqrt(np.mean(error**2)):.2f} ms, "
                f"median {np.median(np.abs(error)):.2f} ms, largest {np.abs(error).max():.2f} ms; {inside} within the "
                "stated +-"
            )
    print_without(without)
    if config.json:
        write_json(config.json, {"estimates": rows, "no_board": without})


def leave_out(cameras: tuple[SyncedVideo, ...], scene: str) -> list[dict]:
    """Return every camera with a clock, estimated from each other one, and from all others."""
    known = {c.name: (Path(c.video), c.times, read_light(Path(c.video))) for c in cameras if c.times}
    rows = []
    for name, (video, times, light) in known.items():
        others = {other: k for other, k in known.items() if other != name}
        trials = [{other: k} for other, k in others.items()] + ([others] if len(others) > 1 else [])
        for against in trials:
            row = {"clip": scene, "camera": name, "cameras": len(against), "error_ms": None, "sigma_ms": None}
            try:
                found = estimate_times(video, light, against)
                row["error_ms"] = 1e3 * float(
                    np.mean([f.time_s - t.time_s for f, t in zip(found.frames, times.frames, strict=True)])
                )
                row["sigma_ms"] = found.systematic_us / 1e3
                cells = f"{row['error_ms']:+.2f} | {row['sigma_ms']:.2f}"
            except NoFlameClock as e:
                cells = f"{e} |"
            print(f"| {scene} | {name} | {', '.join(against)} | {cells} |", flush=True)
            rows.append(row)
    return rows


def no_board(
    cameras: tuple[SyncedVideo, ...], scene: str, board: BoardTemplate, points: dict[str, BoardPoints]
) -> list[dict]:
    """Return the clocks of films in which the board is painted over, on the first one's.

    Errors are to the moment of the picture's middle line, and to that of the line where the flame is: without a board
    nothing tells how long a line takes.
    """
    names = [camera.name for camera in cameras]
    lights = [hidden_board(camera, board, points.get(camera.name)) for camera in cameras]
    late = [flame_delay_s(camera.times, light) for camera, light in zip(cameras, lights, strict=True)]
    rows = []
    for step in THINNED:
        for begin in BEGIN if step > 1 else BEGIN[:1]:
            thin = [
                FlameLight(tuple(along[k::step] for along in light.along), light.middle, light.size)
                for light, k in zip(lights, begin, strict=True)
            ]
            own = [np.arange(len(light.along[0])) * step / 400 for light in thin]
            true_s = [camera.times.frames[k].time_s for camera, k in zip(cameras, begin, strict=True)]
            fits = by_light(names, own, thin)
            for k in (1, 2):
                error = fits[k].offset_s - fits[0].offset_s - (true_s[k] - true_s[0])
                row = {"clip": scene, "camera": names[k], "fps": 400 // step, "begin": begin}
                row |= {"error_ms": 1e3 * error, "at_flame_ms": 1e3 * (error - late[k] + late[0])}
                rows.append(row | {"sigma_ms": 1e3 * fits[k].sigma_s})
    return rows


def hidden_board(camera: SyncedVideo, board: BoardTemplate, points: BoardPoints | None) -> FlameLight:
    """Return the light of a film whose board, with its glow, is black."""
    seen = find_mask(stored_frames(Path(camera.video)), board, points) == 0
    return light_of(frame * seen[..., None] for frame in stored_frames(Path(camera.video)))


def flame_delay_s(times: VideoTimes, light: FlameLight) -> float:
    """Return the s by which the flame's line is read after the picture's middle one."""
    along = light.middle[0 if times.readout in ("left", "right") else 1]
    return 1e-6 * times.row_time_us * along * (1 if times.readout in ("right", "down") else -1)


def print_without(rows: list[dict]) -> None:
    """Print a row per clip, with the two cameras' errors, and the sums over all."""
    print("\n| no board: clip | 400 fps (ms) | at the flame's line (ms) | stated +- (ms) | worst at 200 fps | at 100 |")
    print("|---|---|---|---|---|---|")
    for clip in dict.fromkeys(row["clip"] for row in rows):
        mine = [row for row in rows if row["clip"] == clip]
        whole = [row for row in mine if row["fps"] == 400]
        worst = [max(abs(row["error_ms"]) for row in mine if row["fps"] == fps) for fps in (200, 100)]
        both = [" ".join(f"{row[what]:+.2f}" for row in whole) for what in ("error_ms", "at_flame_ms")]
        print(f"| {clip} | {both[0]} | {both[1]} | {whole[0]['sigma_ms']:.2f} | {worst[0]:.2f} | {worst[1]:.2f} |")
    for fps in dict.fromkeys(row["fps"] for row in rows):
        mine = [row for row in rows if row["fps"] == fps]
        error, local, sigma = (np.array([row[w] for row in mine]) for w in ("error_ms", "at_flame_ms", "sigma_ms"))
        half = 500 / fps
        print(
            f"\nno board, {fps} fps: rms {np.sqrt(np.mean(error**2)):.2f} ms ({np.sqrt(np.mean(local**2)):.2f} at the "
            f"flame's line), {np.sum(np.abs(error) <= half)} ({np.sum(np.abs(local) <= half)}) of {len(error)} within "
            f"half a frame, {np.sum(np.abs(error) <= sigma)} within the stated +-"
        )


if __name__ == "__main__":
    main()
