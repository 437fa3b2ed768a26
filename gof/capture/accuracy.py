"""`gof capture accuracy`: decode rendered footage with known times, and table the error against what a rig can vary."""

from __future__ import annotations

import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro

from gof.capture.decode import CameraTimes, DecodeOptions, decode
from gof.capture.locate import Summary, locate
from gof.capture.signals import make_signals, read_signals, sample_frame
from gof.capture.synthetic import SyntheticShot, render, write_video
from gof.capture.template import BoardTemplate
from gof.errors import GofError
from gof.io.files import write_json

# What varies, around SyntheticShot's defaults: 720 x 1280, 400 fps, 3 us rows, 1 ms exposure, 60 px marker.
SWEEPS: dict[str, list] = {
    "exposure": [100.0, 300.0, 600.0, 1000.0, 1500.0, 2200.0],
    "row_time": [1.5, 3.0, 6.0, 10.0],
    "blur_px": [0.5, 1.5, 3.0],
    "noise": [0.0, 4.0, 10.0],
    "gain": [0.8, 3.0, 12.0],
    "marker_px": [25.0, 40.0, 90.0],
    "yaw_deg": [20.0, 40.0],
    "fps": [120.0, 240.0],
}


def measure(shot: SyntheticShot, template: BoardTemplate, frames: int = 96, codec: str | None = None,
            options: DecodeOptions | None = None) -> dict[str, float]:
    """Render, decode, compare. `codec`: None, an OpenCV four-letter code, or "jpeg Q" for single pictures of that quality.

    Returns:
        rms error in us of fused and of single-frame times (bias included), bias, error of row time and exposure, seconds.
    Raises:
        GofError: not decodable.
    """
    truth = shot.times(frames)
    if codec and not codec.startswith("jpeg"):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / ("shot.avi" if codec == "FFV1" else "shot.mp4")
            write_video(path, render(shot, template, frames), codec)
            start = time.perf_counter()
            signals = read_signals(path, template)
    else:
        pictures = list(render(shot, template, frames))
        if codec:
            pictures = [_jpeg(p, int(codec.split()[1])) for p in pictures]
        start = time.perf_counter()
        summary = Summary()
        for picture in pictures:
            summary.add(picture)
        board = locate(summary, template)
        strips, leds = zip(*(sample_frame(p, board) for p in pictures), strict=True)
        signals = make_signals(np.stack(strips), np.stack(leds), (shot.width, shot.height), board)
    times = decode(signals, template, options or DecodeOptions(shot.period))
    return errors(times, truth, shot) | {"seconds": time.perf_counter() - start}


def _jpeg(picture: np.ndarray, quality: int) -> np.ndarray:
    import cv2

    return cv2.imdecode(cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], cv2.IMREAD_GRAYSCALE)


def errors(times: CameraTimes, truth: np.ndarray, shot: SyntheticShot) -> dict[str, float]:
    """Errors of decoded times (us) against the truth; frames that were left out do not count as single measurements."""
    fused, single = times.time_us - truth, (times.measured_us - truth)[times.used]
    return {
        "fused_rms_us": float(np.sqrt(np.mean(fused**2))), "single_rms_us": float(np.sqrt(np.mean(single**2))),
        "bias_us": float(fused.mean()), "left_out": int((~times.used).sum()),
        "row_time_error_us": times.row_time_us - shot.row_time,
        "exposure_us": times.exposure_us or float("nan"),
    }


@dataclass(frozen=True)
class AccuracyConfig:
    """Table the decoder's error on rendered footage with known times. About two minutes on two cores."""

    out: Path | None = None
    """Markdown file for the table."""
    frames: int = 96
    """Frames per case."""
    codec: bool = True
    """Also table compressed footage (MPEG-4, JPEG)."""
    json: Path | None = None
    """Also write the figures to this file."""


def main(argv: list[str]) -> int:
    """Run all sweeps and print the table."""
    config = tyro.cli(AccuracyConfig, prog="gof capture accuracy", args=argv)
    template = BoardTemplate.load("gof_board")
    rows = [["default", "", None]]
    rows += [[name, value, None] for name, values in SWEEPS.items() for value in values]
    if config.codec:
        rows += [[name, value, "mp4v"] for name, value in
                 [("default", ""), ("exposure", 300.0), ("exposure", 2200.0), ("marker_px", 40.0), ("noise", 10.0), ("gain", 0.8)]]
        rows += [["default", "", "jpeg 30"], ["default", "", "jpeg 10"], ["marker_px", 40.0, "jpeg 10"]]
    lines = ["| varied | value | codec | fused rms (us) | single frame rms (us) | bias (us) | frames left out |",
             "|---|---|---|---|---|---|---|"]
    figures = []
    print("\n".join(lines))
    for name, value, codec in rows:
        # Another start for every case: none is lucky.
        shot = replace(SyntheticShot(seed=len(figures), start=1_000_000.0 + 777.7 * len(figures)), **({name: value} if value != "" else {}))
        try:
            e = measure(shot, template, config.frames, codec)
            cells = f"{e['fused_rms_us']:.2f} | {e['single_rms_us']:.2f} | {e['bias_us']:+.2f} | {e['left_out']} |"
        except GofError as error:
            e, cells = {"error": str(error)}, f"not decoded: {error} | | | |"
        figures.append({"varied": name, "value": value, "codec": codec, **e})
        lines.append(f"| {name} | {value} | {codec or 'none'} | {cells}")
        print(lines[-1], flush=True)
    if config.out:
        config.out.write_text("\n".join(lines) + "\n")
    if config.json:
        write_json(config.json, {"rows": figures})
    return 0
