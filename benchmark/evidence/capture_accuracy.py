"""How exact the times read off the LED board are, and what they cost.

    python -m gof_benchmark.evidence.capture_accuracy [--captures FOLDER] [--parts synthetic real cost] [--json FILE]

Takes about 20 min. Needs the paper's clips for its real part.

synthetic: rendered footage (exact rolling shutter and exposure, tests/capture/synthetic.py) whose times are known.
real: public clips of the paper's rig, FOLDER/capture_05/scene_0006/cam_0.mp4 ...; without them it says so and goes on.
cost: what each option of the decoder, and the clip's length, cost and buy.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro

from gof.capture.board_points import points_on
from gof.capture.decode import DecodeOptions
from gof.capture.sync import synchronise
from gof.capture.template import BoardTemplate
from gof.capture.times import VideoTimes
from gof.core.errors import GofError
from gof.core.files import write_json
from gof.look.charts import frame_times_chart
from tests.capture.marked_views import MARKED
from tests.capture.rendered_clips import measure
from tests.capture.synthetic import SyntheticShot

SHOWN = ("frame_interval_us", "rms_us", "max_residual_us", "outliers", "row_time_us", "readout", "faults")
GOAL_US, GOAL_COMPRESSED_US, GOAL_REAL_US = 5.0, 15.0, 9.0

# Variations around SyntheticShot's defaults: 720 x 1280, 400 fps, 3 us rows, 1 ms exposure, 60 px marker.
SWEEPS: dict[str, list[float]] = {
    "exposure": [100, 300, 600, 1000, 1500, 2200, 3000],
    "row_time": [1.5, 3.0, 6.0, 10.0],
    "blur_px": [0.5, 1.5, 3.0, 4.0],
    "noise": [0, 4, 10, 20],
    "gain": [0.4, 0.8, 3.0, 12.0],
    "marker_px": [20, 25, 40, 90],
    "yaw_deg": [20, 40, 60],
    "fps": [30, 60, 120, 240],
}
CODECS = ("mp4v", "h264 18", "h264 23", "h264 28", "h264 33", "h264 40", "jpeg 30", "jpeg 10")
CHANGES = ({"exposure": 300}, {"exposure": 2200}, {"marker_px": 40}, {"noise": 10}, {"gain": 0.8}, {"yaw_deg": 40})
COMPRESSED = [(codec, {}) for codec in CODECS] + [
    (codec, change) for codec in ("h264 23", "h264 33") for change in CHANGES
]

# Offsets (us) of the cameras' nearest frames to cam_0's first, measured on the same clips with another decoder (first
# row of the picture instead of its middle, other row time; 30 us systematic).
KNOWN_OFFSETS_US: dict[str, dict[str, float]] = {
    "capture_05/scene_0006": {"cam_1": -646, "cam_2": 635},
    "capture_04/scene_0010": {"cam_2": 904},
    "capture_04/scene_0009": {"cam_2": -840},
}

Row = dict[str, Any]


@dataclass(frozen=True)
class CaptureAccuracy:
    """Error and cost of the times read off the LED board, on rendered and on real footage."""

    parts: tuple[Literal["synthetic", "real", "cost"], ...] = ("synthetic", "real", "cost")
    """Which tables to make."""
    captures: Path = Path(os.environ.get("GOF_CAPTURES", Path(__file__).parents[3] / "shared" / "captures"))
    """Folder of the public clips; GOF_CAPTURES names it too."""
    plots: Path | None = None
    """Write the real clips' residual plots below this folder."""
    frames: int = 96
    """Frames per rendered clip."""
    repeats: int = 3
    """Starts per case of the synthetic table."""
    json: Path | None = None
    """Also write the figures to this file."""


def main(argv: list[str] | None = None) -> None:
    """Print the chosen tables."""
    config = tyro.cli(CaptureAccuracy, prog="python -m gof_benchmark.evidence.capture_accuracy", args=argv)
    tables = {
        "synthetic": lambda: synthetic(config.frames, config.repeats),
        "real": lambda: real(config.captures, config.plots),
        "cost": lambda: cost(config.frames),
    }
    figures: dict[str, list[Row]] = {}
    for part in config.parts:
        print(f"\n{part}\n")
        figures[part] = tables[part]()
    if config.json:
        write_json(config.json, figures)


# ---------------------------------------------------------------- rendered footage


def synthetic(frames: int, repeats: int) -> list[Row]:
    """Return all sweeps; every case from `repeats` other starts, rms over them."""
    template = BoardTemplate.load("gof_board")
    cases = [({}, None)] + [({name: value}, None) for name, values in SWEEPS.items() for value in values]
    cases += [(change, codec) for codec, change in COMPRESSED]
    print(
        "| varied | codec | kB per frame | fused rms (us) | single frame rms (us) | stated sigma (us) "
        "| row time error (us) | frames left out | goal (us) |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    rows = []
    for n, (change, codec) in enumerate(cases):
        starts = [1_000_000.0 + 777.7 * n + 12_345.6 * k for k in range(repeats)]
        shots = [replace(SyntheticShot(seed=10 * n + k, start=start), **change) for k, start in enumerate(starts)]
        row = {"change": change, "codec": codec, "goal_us": GOAL_COMPRESSED_US if codec else GOAL_US}
        try:
            row |= _pooled([measure(shot, template, frames, codec) for shot in shots], codec, row["goal_us"])
        except GofError as error:
            row |= {"error": str(error), "met": False}
        print(_synthetic_line(row, frames * repeats), flush=True)
        rows.append(row)
    return rows


def _pooled(found: list[dict[str, float]], codec: str | None, goal_us: float) -> Row:
    """Several measurements of a case as one: rms of the errors, the worst against the goal."""
    names = ("fused_rms_us", "single_rms_us", "row_time_error_us", "stated_us")
    row: Row = {name: float(np.sqrt(np.mean([f[name] ** 2 for f in found]))) for name in names}
    return row | {
        "kb_per_frame": float(np.mean([f["kb_per_frame"] for f in found])) if codec else None,
        "left_out": sum(f["left_out"] for f in found),
        "met": max(f["single_rms_us"] for f in found) <= goal_us,
    }


def _synthetic_line(row: Row, shown: int) -> str:
    """`shown` frames in all."""
    varied = ", ".join(f"{k} {v:g}" for k, v in row["change"].items()) or "default"
    head = f"| {varied} | {row['codec'] or 'none'} |"
    if "error" in row:
        return f"{head}  | {row['error']} | | | | | {row['goal_us']:g} not decoded |"
    size = "" if row["codec"] is None else format(row["kb_per_frame"], ".2g")
    return (
        f"{head} {size} | {row['fused_rms_us']:.2f} | {row['single_rms_us']:.2f} | {row['stated_us']:.2f} | "
        f"{row['row_time_error_us']:.4f} | {row['left_out']} of {shown} | "
        f"{row['goal_us']:g} {'met' if row['met'] else 'MISSED'} |"
    )


# ---------------------------------------------------------------- real footage


def real(captures: Path, plots: Path | None) -> list[Row]:
    """Return every clip folder of three cameras below `captures`."""
    scenes = sorted(p.parent for p in captures.glob("*/*/cam_0.mp4"))
    if not scenes:
        print(f"skipped: no clips at {captures} (give --captures, or set GOF_CAPTURES)")
        return []
    print(
        "| clip | camera | us per frame | rms (us) | max (us) | outliers | row time (us/px), direction "
        "| offset to cam_0 (us) | known (us) | fault |"
    )
    print("|---|---|---|---|---|---|---|---|---|---|")
    rows, board = [], BoardTemplate.load("paper_rig")
    for folder in scenes:
        scene = f"{folder.parent.name}/{folder.name}"
        videos = sorted(folder.glob("cam_*.mp4"))
        draw = _into(plots / scene.replace("/", "_")) if plots else None
        points = {c: points_on(board, *marks, c) for c, marks in MARKED.get(scene, {}).items()}
        result = synchronise(videos, board, [DecodeOptions()] * len(videos), draw, points=points)
        for camera in result.cameras:
            row = {"clip": scene, "camera": camera.name}
            if camera.times is None:
                row["error"] = camera.error
            else:
                row |= _real_figures(camera.times, result.nearest_frames[camera.name].offset_us)
                row["known_offset_us"] = KNOWN_OFFSETS_US.get(scene, {}).get(camera.name)
            print(_real_line(row), flush=True)
            rows.append(row)
    return rows


def _into(folder: Path) -> Callable:
    """Return a function that draws each camera's residuals into a folder."""
    return lambda name, *seen: frame_times_chart(name, *seen).write(folder / f"residuals_{name}.png")


def _real_figures(times: VideoTimes, offset_us: float) -> Row:
    return {name: getattr(times, name) for name in SHOWN} | {
        "offset_us": offset_us,
        "met": times.rms_us <= GOAL_REAL_US,
        "frames_per_second": times.cost.frames_per_second,
    }


def _real_line(row: Row) -> str:
    head = f"| {row['clip']} | {row['camera']} |"
    if "error" in row:
        return f"{head} {' | ' * 7}{row['error'].split(':')[0]} |"
    known = row["known_offset_us"]
    return (
        f"{head} {row['frame_interval_us']:.2f} | {row['rms_us']:.2f} | {row['max_residual_us']:.1f} | "
        f"{row['outliers']} | {row['row_time_us']:.3f} {row['readout']} | {row['offset_us']:+.0f} | "
        f"{'' if known is None else f'{known:+.0f}'} | {'; '.join(row['faults']) or 'none'} |"
    )


# ---------------------------------------------------------------- what options cost


def cost(frames: int) -> list[Row]:
    """Return options and clip lengths, on one rendered shot with codec (JPEG 30), mean of three starts."""
    template = BoardTemplate.load("gof_board")
    shot = SyntheticShot(noise=4)
    known = DecodeOptions(fps=400.0, row_time_us=3.0, readout="left")
    cases: list[tuple[str, int, dict[str, Any]]] = [("default: 6 rounds, 96 points a strip", frames, {})]
    cases += [(f"{n} rounds", frames, {"options": DecodeOptions(iterations=n)}) for n in (2, 3, 12)]
    cases += [(f"{n} points a strip", frames, {"samples": n}) for n in (12, 24, 48, 192)]
    cases += [
        ("rate, row time and direction given", frames, {"options": known}),
        ("free clock (phones)", frames, {"options": DecodeOptions(clock="free")}),
    ]
    cases += [(f"{n} frames", n, {}) for n in (12, 24, 48, 192, 384)]
    print(
        "| option | frames | fused rms (us) | single frame rms (us) | read (ms per frame) | fit (ms per frame) "
        "| frames/s |"
    )
    print("|---|---|---|---|---|---|---|")
    rows = []
    for label, n, how in cases:
        try:
            found = [
                measure(replace(shot, seed=k, start=1_000_000.0 + 12_345.6 * k), template, n, "jpeg 30", **how)
                for k in range(3)
            ]
        except GofError as error:
            rows.append({"option": label, "frames": n, "error": str(error)})
            print(f"| {label} | {n} | {error} | | | | |", flush=True)
            continue
        row = {
            key: float(np.mean([f[key] for f in found]))
            for key in ("fused_rms_us", "single_rms_us", "read_s", "decode_s")
        }
        rows.append({"option": label, "frames": n} | row)
        read, fit = 1e3 * row["read_s"] / n, 1e3 * row["decode_s"] / n
        errors_us = f"{row['fused_rms_us']:.2f} | {row['single_rms_us']:.2f}"
        print(f"| {label} | {n} | {errors_us} | {read:.2f} | {fit:.2f} | {1e3 / (read + fit):.0f} |", flush=True)
    return rows


if __name__ == "__main__":
    main()
