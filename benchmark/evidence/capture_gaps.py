"""Whether `gof capture sync` finds the gaps in real footage. Prints a table.

    python -m gof_benchmark.evidence.capture_gaps [--captures FOLDER] [--json FILE]

Frames are taken out of the paper's clips, single ones, runs, many at random, and at the ends; the times of the frames
that are left must be those that the whole clip gave them. Cameras that see all counter LEDs, and some of them.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from gof.capture.decode import DecodeOptions, decode
from gof.capture.signals import Signals, make_signals, read_signals
from gof.capture.strips import NotDecodable
from gof.capture.template import BoardTemplate
from gof.core.files import write_json

CAMERAS = (
    ("capture_05/scene_0006", 0, "all 14"),
    ("capture_05/scene_0006", 1, "8 of 14"),
    ("capture_04/scene_0010", 1, "8 of 14"),
    ("capture_04/scene_0009", 1, "11 of 14"),
    ("capture_03/scene_0002", 0, "10 of 14, strips tied"),
    ("capture_03/scene_0004", 0, "10 of 14, strips tied"),
)
FIXED = ((20, 21, 59), (1,), (98,), (2, 3), (96, 97), tuple(range(10, 21)), tuple(range(30, 38)))
RANDOM = (1, 2, 3, 4, 6, 8, 3, 3, 5, 5, 10, 12)  # frames at random places
NEAR_US = 60.0  # far above what fewer frames change, far below a frame


@dataclass(frozen=True)
class CaptureGaps:
    """Times of real footage with frames taken out, against those of the whole."""

    captures: Path = Path(os.environ.get("GOF_CAPTURES", Path(__file__).parents[3] / "shared" / "captures"))
    """Folder of the public clips; GOF_CAPTURES names it too."""
    json: Path | None = None
    """Also write the figures to this file."""


def main(argv: list[str] | None = None) -> None:
    """Print one row per camera."""
    config = tyro.cli(CaptureGaps, prog="python -m gof_benchmark.evidence.capture_gaps", args=argv)
    if not config.captures.is_dir():
        print(f"skipped: no clips at {config.captures} (give --captures, or set GOF_CAPTURES)")
        return
    template, rows = BoardTemplate.load("paper_rig"), []
    print("| clip | camera | LEDs in view | all times right | all but frames that are marked | wrong |")
    print("|---|---|---|---|---|---|")
    for scene, camera, leds in CAMERAS:
        signals = read_signals(config.captures / scene / f"cam_{camera}.mp4", template)
        found = [judge(signals, lost, template) for lost in patterns(len(signals.strip))]
        row = {word: found.count(word) for word in ("right", "marked", "wrong")}
        rows.append({"clip": scene, "camera": f"cam_{camera}", "leds": leds, "patterns": len(found)} | row)
        print(
            f"| {scene} | cam_{camera} | {leds} | {row['right']} of {len(found)} | {row['marked']} | {row['wrong']} |",
            flush=True,
        )
    if config.json:
        write_json(config.json, {"gaps": rows})


def patterns(frames: int) -> list[tuple[int, ...]]:
    """Frame numbers to take out."""
    rng = np.random.default_rng(0)
    return [*FIXED, *(tuple(np.sort(rng.choice(np.arange(5, frames - 5), n, replace=False))) for n in RANDOM)]


def judge(signals: Signals, lost: tuple[int, ...], template: BoardTemplate) -> str:
    """ "right"; "marked": every frame with a wrong time says that it was left out of the fit; "wrong"."""
    whole = decode(signals, template, DecodeOptions()).time_us
    keep = np.setdiff1d(np.arange(len(whole)), lost)
    cut = make_signals(signals.strip[keep], signals.led[keep], signals.image_size, signals.board)
    try:
        times = decode(cut, template, DecodeOptions())
    except NotDecodable:
        return "wrong"
    error = times.time_us - whole[keep]
    error -= 4000 * np.rint(np.median(error) / 4000)  # the count of the clip is settled by other cameras
    off = np.abs(error) > NEAR_US
    return "right" if not off.any() else "wrong" if times.used[off].any() else "marked"


if __name__ == "__main__":
    main()
