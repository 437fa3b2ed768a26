"""How exact the times read off a RocSync board are, on rendered footage whose times are known.

    python -m gof_benchmark.evidence.ring_accuracy [--frames 60] [--only TEXT] [--json FILE]

Takes about 15 s.

The pictures have exact rolling shutter and exposure (tests/capture/synthetic.py, which shares only the board's
template with the reader) and are read from files, as `gof capture sync --board rocsync` reads a camera's.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro

from gof.capture.decode import DecodeOptions
from gof.capture.ring_board import RingBoard
from gof.capture.ring_decode import decode_ring
from gof.capture.ring_signals import read_ring_signals
from gof.core.files import write_json
from gof.footage.pictures import write_picture
from tests.capture.synthetic import USUAL, RingShot, render_ring

LARGE = replace(USUAL, width=960, height=720, marker_px=90, gain=1.2, yaw_deg=35, roll_deg=12, blur_px=2, noise=6)
CASES = {
    "as it comes": RingShot(USUAL),
    "carried about, 1 px per frame": RingShot(replace(USUAL, width=400, centre=(0.4, 0.5)), move=(1.0, 0.2)),
    "a hand before a part of the ring": RingShot(replace(USUAL, fps=24.0), covered=((-0.55, 0.4, 0.38),)),
    "16 ms exposure at 60 fps, read upwards": RingShot(
        replace(USUAL, readout="up", fps=60.0, exposure=16_000.0, gain=10.0)
    ),
    "30 ms exposure at 30 fps, saturated": RingShot(replace(USUAL, exposure=30_000.0, fps=30.0, gain=20.0)),
    "0.3 ms exposure (within one LED's step) at 240 fps, rows of 7 us read to the left": RingShot(
        replace(USUAL, exposure=300.0, fps=240.0, readout="left", row_time=7.0)
    ),
    "960x720, turned by 35 degrees, blur 2 px, noise of 6 grey levels": RingShot(LARGE),
}


@dataclass(frozen=True)
class RingAccuracy:
    """Errors of the times read off rendered RocSync boards. Prints a table."""

    frames: int = 60
    """Per case."""
    only: str = ""
    """Only cases whose name holds this text."""
    json: Path | None = None
    """Also write the figures to this file."""


def measure(shot: RingShot, frames: int) -> dict[str, float]:
    """Return errors in us of the fused times and of single frames (which see no arc within one step), and the row
    time."""
    board = RingBoard.load("rocsync")
    with tempfile.TemporaryDirectory() as folder:
        for k, picture in enumerate(render_ring(shot, board, frames)):
            write_picture(Path(folder) / f"{k:04d}.png", picture[..., ::-1])
        found = decode_ring(read_ring_signals(Path(folder), board), board, DecodeOptions())
    truth = shot.camera.times(frames)
    return {
        "fused_us": float(np.sqrt(np.mean((found.time_us - truth) ** 2))),
        "single_us": float((found.measured_us - truth)[found.used].std()),
        "row_us": float(found.row_time_us),
        "true_row_us": shot.camera.row_time,
        "stated_us": float(found.sigma_us.mean()),
        "used": int(found.used.sum()),
    }


def main(argv: list[str] | None = None) -> None:
    """Print the table."""
    config = tyro.cli(RingAccuracy, prog="python -m gof_benchmark.evidence.ring_accuracy", args=argv)
    print(
        "| case | fused times, rms error (us) | single frames, scatter (us) | row time read, of (us) | frames used |\n"
        "|---|---|---|---|---|"
    )
    rows = {}
    for name, shot in CASES.items():
        if config.only in name:
            rows[name] = r = measure(shot, config.frames)
            times = f"{r['fused_us']:.1f} | {r['single_us']:.1f} | {r['row_us']:.2f}, {r['true_row_us']:g}"
            print(f"| {name} | {times} | {r['used']} of {config.frames} |", flush=True)
    if config.json:
        write_json(config.json, rows)


if __name__ == "__main__":
    main()
