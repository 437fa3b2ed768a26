"""How good is stereo on the plates: semi-global matching against a generated scene's true depth.

    python -m gof_benchmark.evidence.static_depth DATASET

Prints coverage and error per camera, before and after the check between views.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from gof.dataset import Dataset
from gof.ingest.stereo import consistent, neighbours_matched

FAR = 1e6  # m; Blender writes 1e10 where nothing is


@dataclass(frozen=True)
class StaticDepth:
    """Score the depth of fire-free views by stereo."""

    dataset: tyro.conf.Positional[Path]
    """A generated dataset (its EXR files hold depth)."""


def main(argv: list[str] | None = None) -> None:
    """Print one line per camera, without and with the check between views."""
    config = tyro.cli(StaticDepth, prog="python -m gof_benchmark.evidence.static_depth", args=argv)
    dataset = Dataset.open(config.dataset)
    views = range(len(dataset.cameras))
    pictures = [np.uint8(np.rint(255 * dataset.static(c))) for c in views]
    truth = [true_depth(dataset, c) for c in views]
    depth = np.concatenate([t[t < FAR] for t in truth])
    near, far = np.percentile(depth, 1) / 1.2, np.percentile(depth, 99) * 1.2
    start = time.perf_counter()
    matched = neighbours_matched(pictures, dataset.cameras, near, far)
    seconds = (time.perf_counter() - start) / len(matched)
    for label, maps in (("semi-global", matched), ("checked", consistent(matched, dataset.cameras))):
        for camera, found, true in zip(dataset.cameras, maps, truth, strict=True):
            print(score(f"{label} {camera.name}", found, true, seconds))


def true_depth(dataset: Dataset, camera: int) -> np.ndarray:
    """Return (H, W) m, of the first frame."""
    import OpenEXR

    with OpenEXR.File(str(dataset.file(camera, "exr", 0)), separate_channels=True) as file:
        return np.array(file.channels()["Z"].pixels)


def score(name: str, found: np.ndarray, truth: np.ndarray, seconds: float) -> str:
    """Return one line: covered share, median relative error, share of the covered within 2 % and 5 %."""
    known = np.isfinite(truth) & (truth < FAR)
    both = known & np.isfinite(found)
    error = np.abs(found[both] - truth[both]) / truth[both]
    return (
        f"{name:<28} cover {both.sum() / known.sum():.2f}  median {np.median(error) if both.any() else np.nan:.4f}  "
        f"<2% {(error < 0.02).mean():.3f}  <5% {(error < 0.05).mean():.3f}  {seconds:.1f} s"
    )


if __name__ == "__main__":
    main()
