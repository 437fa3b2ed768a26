"""How well the clock of a camera without the LED board is estimated from the flame. Prints a table.

    python -m gof_benchmark.evidence.flame_clock [--captures FOLDER] [--json FILE]

Cameras whose clock is known are taken for one without, in turn. The truth is what `gof capture sync` reads off the
board in that camera (a few microseconds), which the estimate is not given. Needs the paper's clips.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from gof.capture.decode import DecodeOptions
from gof.capture.flame_clock import NoFlameClock, estimate_times, read_light
from gof.capture.sync import synchronise
from gof.capture.template import BoardTemplate
from gof.core.files import write_json


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
    print("| clip | camera | against | error (ms) | stated +- (ms) |")
    print("|---|---|---|---|---|")
    rows = []
    for folder in scenes:
        rows += leave_out(folder, f"{folder.parent.name}/{folder.name}")
    for size, rated in (
        ("one", [r for r in rows if r["cameras"] == 1]),
        ("all others", [r for r in rows if r["cameras"] > 1]),
    ):
        error = np.array([r["error_ms"] for r in rated if r["error_ms"] is not None])
        if len(error):
            print(
                f"\nagainst {size}: {len(error)} of {len(rated)} estimated; rms {np.sqrt(np.mean(error**2)):.2f} ms, "
                f"median {np.median(np.abs(error)):.2f} ms, largest {np.abs(error).max():.2f} ms"
            )
    if config.json:
        write_json(config.json, {"estimates": rows})


def leave_out(folder: Path, scene: str) -> list[dict]:
    """Return every camera with a clock, estimated from each other one, and from all others."""
    videos = sorted(folder.glob("cam_*.mp4"))
    read = synchronise(videos, BoardTemplate.load("paper_rig"), [DecodeOptions()] * len(videos))
    known = {c.name: (Path(c.video), c.times, read_light(Path(c.video))) for c in read.cameras if c.times}
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
                said = f"{row['error_ms']:+.2f} | {row['sigma_ms']:.2f}"
            except NoFlameClock as e:
                said = f"{e} |"
            print(f"| {scene} | {name} | {', '.join(against)} | {said} |", flush=True)
            rows.append(row)
    return rows


if __name__ == "__main__":
    main()
