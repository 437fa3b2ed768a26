"""Worker of the panel Score: DVE of a reconstruction in a Blender without gof (`pure.dve`).

    python -m gof_blender.worker.score --result result.npz --dataset DATASET --out scores.json

Progress goes to standard output as lines ``{"progress": {"stage": "score", "done": 1, "total": 36}}``.
"""

from __future__ import annotations

import argparse
import sys
import traceback
from pathlib import Path

from ..pure import dve
from ..pure.io import FileFormatError, gaussians_file
from ..pure.io.records import write_record
from ..pure.scores import Scores
from .reporter import Reporter, leave, run_alone


def main(argv: list[str] | None = None) -> int:
    """Score; returns the exit status. The process must then end through ``reporter.leave``."""
    parser = argparse.ArgumentParser(prog="python -m gof_blender.worker.score", description=__doc__.split("\n")[0])
    parser.add_argument("--result", type=Path, required=True, help="result.npz or result.ply")
    parser.add_argument("--dataset", type=Path, required=True, help="folder with the true velocity")
    parser.add_argument("--out", type=Path, required=True, help="scores.json to write")
    parser.add_argument("--clip-seconds", type=float, default=0.0, help="of a file whose time runs from 0 to 1")
    args = parser.parse_args(argv)
    progress = Reporter("score", args.out.with_suffix(".log"))
    try:
        rate = dve.frame_rate(args.dataset)
        cloud = gaussians_file.load(args.result, gaussians_file.Clock(rate, args.clip_seconds or None))
        scores = Scores()
        for done, total, so_far in dve.score(cloud, args.dataset):
            scores = so_far
            progress(done, total)
        write_record(args.out, scores)
    except (FileFormatError, OSError) as error:
        print(f"score: {error}", file=sys.stderr)
        return 2
    except MemoryError:
        print("score: not enough memory for the true velocity around the Gaussians of one frame", file=sys.stderr)
        return 2
    except Exception:
        traceback.print_exc()
        return 1
    return 0


def run(argv: list[str]) -> None:
    """A score as the only work of this process."""
    run_alone(main, argv)


if __name__ == "__main__":
    leave(main())
