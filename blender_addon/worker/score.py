"""Worker of the panel Score: DVE of a reconstruction in a Blender without gof (`pure.dve`).

    python -m gof_blender.worker.score --result result.npz --dataset DATASET --out scores.json

Progress goes to standard output as lines ``{"progress": {"stage": "score", "done": 1, "total": 36}}``.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from ..core.errors import DataFormatError, GofError
from ..core.records import write_record
from ..pure import dve
from ..pure.dve import MotionScores
from ..pure.io import cloud as clouds
from .reporter import Reporter, exit_status, leave, run_alone


def main(argv: list[str] | None = None) -> int:
    """Score; returns the exit status. The process must then end through ``reporter.leave``."""
    parser = argparse.ArgumentParser(prog="python -m gof_blender.worker.score", description=__doc__.split("\n")[0])
    parser.add_argument("--result", type=Path, required=True, help="result.npz or result.ply")
    parser.add_argument("--dataset", type=Path, required=True, help="folder with the true velocity")
    parser.add_argument("--out", type=Path, required=True, help="scores.json to write")
    parser.add_argument("--clip-seconds", type=float, default=0.0, help="of a file whose time runs from 0 to 1")
    args = parser.parse_args(argv)
    return exit_status(lambda: score(args), GofError, OSError)


def score(args: argparse.Namespace) -> None:
    """Score frame by frame, and write what came out. Raises DataFormatError, OSError: a file that says no score."""
    progress = Reporter("score", args.out.with_suffix(".log"))
    cloud = clouds.load(args.result, clouds.CloudTiming(dve.frame_rate(args.dataset), args.clip_seconds or None))
    scores = MotionScores()
    try:
        for done, total, so_far in dve.score(cloud, args.dataset):
            scores = so_far
            progress(done, total)
    except MemoryError as error:
        raise DataFormatError("not enough memory for the true velocity around the Gaussians of one frame") from error
    write_record(args.out, scores)


def run(argv: list[str]) -> None:
    """Run a score as the only work of this process."""
    run_alone(main, argv)


if __name__ == "__main__":
    leave(main())
