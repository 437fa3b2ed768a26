"""`gof capture sync`: footage of the board from any number of cameras -> the time of every row of every frame."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tyro

from gof.capture.decode import CameraTimes, DecodeOptions, decode
from gof.capture.plot import plot_camera
from gof.capture.sensors import Sensor, sensor
from gof.capture.signals import read_signals
from gof.capture.template import BoardTemplate
from gof.errors import GofError
from gof.footage import distinct_names, stated_fps, stated_frames
from gof.io.files import write_json
from gof.progress import progress_bar


@dataclass(frozen=True)
class SyncConfig:
    """Read the time of every frame from footage of the LED board, for any number of cameras on one clock.

    Writes OUT/times.json and one residual plot per camera.
    """

    videos: tyro.conf.Positional[list[Path]]
    """The cameras' own files of one take, in the order gof static gets them."""
    out: Path
    """Folder for times.json and the plots."""
    overwrite: bool = False
    """Replace the times.json that is in the folder already."""
    template: str = "paper_rig"
    """Board: gof_board, paper_rig, or a JSON file."""
    tick_us: float = 400.0
    """Tick the board was set to; its period is 10 ticks."""
    fps: list[float] | None = None
    """True capture rate, one for all or one per video; read from the counter when not given."""
    row_time_us: float | None = None
    """Delay from one image line to the next; measured when not given."""
    sensor: str | None = None
    """Take the row time from the sensor table instead (gopro_hero13_720p400), for footage that shows all sensor rows."""
    readout: Literal["down", "up", "left", "right"] | None = None
    """Direction in which lines are read later, as the picture is stored; measured when not given."""
    clock: Literal["steady", "free"] = "steady"
    """steady: frames come at equal distances (action cameras, machine cameras); free: phones with a varying rate."""
    json: Path | None = None
    """Also write the figures (without the frames) to this file."""


def main(argv: list[str]) -> int:
    """Decode all videos; fails, and writes nothing, only when no camera can be decoded."""
    config = tyro.cli(SyncConfig, prog="gof capture sync", args=argv)
    target = config.out / "times.json"
    if target.exists() and not config.overwrite:
        raise GofError(f"{target}: already there; choose another --out, or replace it with --overwrite")
    if config.sensor and config.row_time_us is not None:
        raise GofError("give either --sensor or --row-time-us")
    rates = config.fps or [None]
    if len(rates) not in (1, len(config.videos)):
        raise GofError(f"--fps: give one rate or one per video ({len(config.videos)}), got {len(rates)}")
    options = [
        DecodeOptions(
            10 * config.tick_us, rates[min(i, len(rates) - 1)], config.row_time_us, config.readout, config.clock
        )
        for i in range(len(config.videos))
    ]
    known = sensor(config.sensor) if config.sensor else None
    result = synchronise(config.videos, BoardTemplate.load(config.template), options, config.out, known)
    if all("error" in camera for camera in result["cameras"]):
        raise GofError("no camera could be decoded: " + "; ".join(c["error"] for c in result["cameras"]))
    write_json(target, result)
    for camera in result["cameras"]:
        print(_line(camera))
    for warning in result["warnings"]:
        print(f"warning: {warning}")
    print(f"wrote {target}")
    if config.json:
        write_json(
            config.json,
            result | {"cameras": [{k: v for k, v in c.items() if k != "frames"} for c in result["cameras"]]},
        )
    return 0


def synchronise(
    videos: list[Path],
    template: BoardTemplate,
    options: list[DecodeOptions],
    plots: Path | None = None,
    known: Sensor | None = None,
) -> dict[str, Any]:
    """Decode every video and put all on the board's clock; `known` gives the row time of pictures of any size.

    Returns:
        JSON-ready dict, schema "gof-times" (docs/capture.md). A camera that cannot be decoded has "error" instead of times.
    """
    names = distinct_names(videos)
    decoded: dict[str, CameraTimes] = {}
    cameras: list[dict[str, Any]] = []
    for name, video, option in zip(names, videos, options, strict=True):
        camera: dict[str, Any] = {"name": name, "video": str(video)}
        cameras.append(camera)
        start = time.perf_counter()
        try:
            with progress_bar(f"read {name}") as update:
                total = stated_frames(video)
                signals = read_signals(
                    video, template, progress=lambda done, u=update, n=total: u(done, max(done, n or 0))
                )
            read_s = time.perf_counter() - start
            if known:  # sensors are wider than high: their rows are the shorter side, whichever way it is turned
                option = replace(option, row_time_us=known.image_row_time_us(min(signals.image_size)))
            times = decode(signals, template, option)
        except GofError as e:
            camera["error"] = str(e)
            continue
        seconds = time.perf_counter() - start
        camera |= {
            "width": signals.image_size[0],
            "height": signals.image_size[1],
            "container_fps": stated_fps(video),
            "marker_px": round(float(np.linalg.norm(np.diff(signals.board.corners, axis=0), axis=1).mean()), 1),
            "cost": {
                "read_s": round(read_s, 2),
                "decode_s": round(seconds - read_s, 2),
                "frames_per_second": round(len(times.time_us) / seconds, 1),
            },
        }
        decoded[name] = times
    warnings = _settle_counts(decoded, options[0].period_us)
    for camera in cameras:
        if times := decoded.get(camera["name"]):
            camera |= _describe(times)
            if plots:
                plot_camera(
                    times,
                    camera["name"],
                    template.strip_slot,
                    options[0].period_us,
                    plots / f"residuals_{camera['name']}.png",
                )
    for camera in cameras:
        warnings += [f"{camera['name']}: {w}" for w in [*camera.get("faults", []), *camera.get("warnings", [])]]
        if "error" in camera:
            warnings.append(f"{camera['name']}: {camera['error']}")
    return {
        "schema": "gof-times",
        "version": 1,
        "template": template.name,
        "period_us": options[0].period_us,
        "time": "mid-exposure of the picture's centre, seconds on the board's clock (count 0 = 0)",
        "cameras": cameras,
        "nearest_frames": _nearest(decoded),
        "warnings": warnings,
    }


def _settle_counts(decoded: dict[str, CameraTimes], period: float) -> list[str]:
    """Cameras that do not see all counter LEDs take the candidate nearest to one that does: they filmed together."""
    warnings = []
    certain = [n for n, t in decoded.items() if len(t.count_candidates) == 1]
    if not decoded:
        return []
    reference = certain[0] if certain else min(decoded, key=lambda n: len(decoded[n].count_candidates))
    if not certain:
        warnings.append(
            f"no camera sees enough counter LEDs for a unique count; the clock starts at the smallest that fits {reference}"
        )
    target = np.median(decoded[reference].time_us)
    for name, times in decoded.items():
        if name == reference or len(times.count_candidates) == 1:
            continue
        candidates = times.count_candidates - times.count_candidates[0]
        shift = int(candidates[np.abs(np.median(times.time_us) + candidates * period - target).argmin()])
        times.shift_periods(shift, period)
        warnings.append(f"{name}: its visible LEDs allow {len(candidates)} counts; took the one nearest to {reference}")
    return warnings


def _nearest(decoded: dict[str, CameraTimes]) -> dict[str, Any]:
    """For each camera, the offset (us) and index of its frame nearest to the first camera's first frame."""
    out: dict[str, Any] = {}
    first = next(iter(decoded.values()), None)
    for name, times in decoded.items():
        k = int(np.abs(times.time_us - first.time_us[0]).argmin())
        out[name] = {"frame": k, "offset_us": round(float(times.time_us[k] - first.time_us[0]), 2)}
    return out


def _describe(t: CameraTimes) -> dict[str, Any]:
    repeated = np.concatenate([[False], np.diff(t.clock_index) == 0])
    gaps = np.flatnonzero(np.diff(t.clock_index) > 1)

    def number(x, digits=3):
        return None if x is None else round(float(x), digits)

    return {
        "fps": number(1e6 / t.interval_us, 5),
        "frame_interval_us": number(t.interval_us, 4),
        "row_time_us": number(t.row_time_us, 4),
        "readout": t.readout,
        "exposure_us": number(t.exposure_us, 0),
        "saturation": t.saturation,
        "rms_us": number(t.rms_us),
        "max_residual_us": number(t.max_us),
        "systematic_us": number(t.systematic_us),
        "count": {
            "candidates": len(t.count_candidates),
            "agreement": number(t.count_agreement, 5),
            "readings": t.count_readings,
        },
        "outliers": int((~t.used & ~repeated).sum()),
        "repeated_frames": np.flatnonzero(repeated).tolist(),
        "dropped_before": {str(k + 1): int(t.clock_index[k + 1] - t.clock_index[k] - 1) for k in gaps},
        "faults": t.faults,
        "warnings": t.warnings,
        "frames": [
            {
                "time_s": round(a * 1e-6, 8),
                "sigma_us": round(float(b), 3),
                "measured_s": round(c * 1e-6, 8),
                "used": bool(d),
            }
            for a, b, c, d in zip(t.time_us, t.sigma_us, t.measured_us, t.used, strict=True)
        ],
    }


def _line(camera: dict[str, Any]) -> str:
    if "error" in camera:
        return f"{camera['name']:<16} not decoded: {camera['error']}"
    return (
        f"{camera['name']:<16} {camera['fps']:.4f} fps  rms {camera['rms_us']:.2f} us (max {camera['max_residual_us']:.1f}, "
        f"{camera['outliers']} outliers)  rows {camera['row_time_us']:.3f} us/px {camera['readout']}  "
        f"exposure {camera['exposure_us'] or 0:.0f} us  {camera['cost']['frames_per_second']:.0f} frames/s"
    )
