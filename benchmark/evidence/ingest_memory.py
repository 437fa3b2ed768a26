"""How much memory does `gof ingest` take for long footage of three cameras?

    python -m gof_benchmark.evidence.ingest_memory [--width 1920] [--height 1080] [--frames 300]

Takes about 5 min. Needs ffmpeg.

Makes three videos with ffmpeg: its moving test picture with grain, as H.264. Poses are given, so that the figure is of
reading, plates and writing; structure from motion depends on the pictures' size and not on their number.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from gof.core.costs import StageLog
from gof.core.errors import MissingDependencyError
from gof.host.processes import python_command
from gof.ingest.fire_free import PlateKind

CAMERAS = 3


@dataclass
class IngestMemory:
    """Make three videos and a dataset of them; print the peak of memory per stage."""

    width: int = 1920
    height: int = 1080
    frames: int = 300
    plate: PlateKind = "steady"
    work: Path | None = None
    """Folder for videos and dataset; default: a temporary one."""


def make_video(path: Path, seed: int, config: IngestMemory) -> None:
    """ffmpeg's moving test picture with grain. Raises MissingDependencyError: there is no ffmpeg."""
    if shutil.which("ffmpeg") is None:
        raise MissingDependencyError("this script makes its videos with ffmpeg; install it from your system's packages")
    picture = f"testsrc2=size={config.width}x{config.height}:rate=60,noise=alls=6:allf=t:all_seed={seed}"
    codec = ["-c:v", "libx264", "-preset", "ultrafast", "-crf", "23", "-pix_fmt", "yuv420p"]
    source = ["-f", "lavfi", "-i", picture, "-frames:v", str(config.frames)]
    subprocess.run(["ffmpeg", "-v", "error", "-y", *source, *codec, str(path)], check=True)


def cameras_file(path: Path, config: IngestMemory) -> None:
    """cameras.json with poses: beside each other, looking along Y."""
    focal = 1.2 * config.width
    K = [[focal, 0, config.width / 2], [0, focal, config.height / 2], [0, 0, 1]]
    look = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0.5], [0, 1, 0, 3.0], [0, 0, 0, 1]])
    entries = []
    for c in range(CAMERAS):
        pose = look.copy()
        pose[0, 3] = -0.3 * (c - 1)
        entries.append({"width": config.width, "height": config.height, "K": K, "world_to_camera": pose.tolist()})
    path.write_text(json.dumps({"cameras": entries}), encoding="utf-8")


def main(argv: list[str] | None = None) -> None:
    """Print the peak of every stage."""
    config = tyro.cli(IngestMemory, prog="python -m gof_benchmark.evidence.ingest_memory", args=argv)
    with tempfile.TemporaryDirectory() as temporary:
        work = config.work or Path(temporary)
        work.mkdir(parents=True, exist_ok=True)
        videos = [work / f"cam_{c}.mp4" for c in range(CAMERAS)]
        for c, video in enumerate(videos):
            make_video(video, c, config)
        cameras_file(work / "cameras.json", config)
        made = work / "set"
        words = ["ingest", *map(str, videos), "--out", str(made), "--times", "60", "--board", "none"]
        words += ["--max-size", "480", "--cameras", str(work / "cameras.json"), "--plates", config.plate]
        subprocess.run(python_command("-m", "gof", *words), check=True, stdout=sys.stderr)
        raw = CAMERAS * config.frames * config.width * config.height * 3 / 2**20
        print(f"{CAMERAS} cameras, {config.frames} frames of {config.width}x{config.height}: {raw:.0f} MB as pictures")
        for stage in StageLog(made / "costs.json").stages():
            print(f"{stage.name:<8} peak {stage.peak_mb:6.0f} MB")


if __name__ == "__main__":
    main()
