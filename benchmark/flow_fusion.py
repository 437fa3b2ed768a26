"""How good is the fused 3D flow before any optimisation, and what do its choices buy? Prints a table.

    python -m benchmark.flow_fusion DATASET [--json FILE]

Every row changes one choice of `gof reconstruct`. Scores are DVE's formulas on the voxels, weighted by their tomographic
emission and averaged over the training frames: L2 (0 perfect, 1 = standing still), CosSim, and the gain, the factor that
would make the speeds fit best (above 1: too slow). Seconds are those of the flow and fusion stages of that row.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from gof.dataset import Dataset
from gof.io.files import write_json
from gof.reconstruct.flow_field import fuse_frame
from gof.reconstruct.motion import estimate_motion
from gof.reconstruct.voxels import carve, tomography


@dataclass
class FusionStudy:
    """Velocity error of the fused flow field for each choice, against the dataset's own velocity."""

    dataset: tyro.conf.Positional[Path]
    """A generated dataset (with ground-truth velocity)."""
    voxels: int = 72
    """Voxels along the longest side of the flame's box."""
    json: Path | None = None
    """Also write the table to this file."""


def scores(velocity: np.ndarray, truth: np.ndarray, weight: np.ndarray) -> tuple[float, float, float]:
    """(L2, CosSim, gain) of velocities (V, 3) against truth (V, 3), weighted (V,); a zero vector has cosine 0."""
    error = (weight * ((velocity - truth) ** 2).sum(1)).sum() / (weight * (truth**2).sum(1)).sum()
    product = np.linalg.norm(velocity, axis=1) * np.linalg.norm(truth, axis=1)
    cosine = np.where(product > 0, (velocity * truth).sum(1) / np.where(product > 0, product, 1), 0)
    energy = (weight * (velocity**2).sum(1)).sum()
    gain = (weight * (velocity * truth).sum(1)).sum() / energy if energy > 0 else np.nan
    return float(np.sqrt(error)), float((weight * cosine).sum() / weight.sum()), float(gain)


def grey_picture(image: np.ndarray, static: np.ndarray) -> np.ndarray:
    """The usual choice for optical flow: the display picture in grey, background and all."""
    return (np.clip(image, 0, 1) @ [0.299, 0.587, 0.114] * 255).astype(np.uint8)


def main(argv: list[str] | None = None) -> None:
    config = tyro.cli(FusionStudy, prog="python -m benchmark.flow_fusion", args=argv)
    dataset = Dataset.open(config.dataset)
    motion = estimate_motion(dataset)
    voxels = carve(dataset.cameras, motion.mask, config.voxels)
    count = len(motion.frames)
    emission = [tomography(voxels, motion.intensity[f], motion.mask[f]) for f in range(count)]
    truth = [dataset.velocity.at(dataset.times_s[k]).sample(voxels.center) for k in motion.frames]

    def measure(flow: np.ndarray, fusion: str, smooth: float) -> list[float]:
        rows = []
        for f in range(count):
            velocity, known = fuse_frame(voxels, flow[f], motion.mask[f], emission[f], fusion, smooth)
            rows.append(scores(velocity, truth[f], emission[f] * known))
        return np.mean(rows, 0).tolist()

    def constant(f: int) -> np.ndarray:
        mean = (emission[f][:, None] * truth[f]).sum(0) / emission[f].sum()
        return np.broadcast_to(mean, truth[f].shape)

    rows: list[tuple[str, Callable[[], list[float]]]] = [
        ("control: best constant vector", lambda: np.mean([scores(constant(f), truth[f], emission[f]) for f in range(count)], 0).tolist()),
        ("default: full, smooth 3, light above plate", lambda: measure(motion.flow, "full", 3.0)),
        ("no smoothing", lambda: measure(motion.flow, "full", 0.0)),
        ("smooth 6", lambda: measure(motion.flow, "full", 6.0)),
        ("the paper's constraint, smooth 3", lambda: measure(motion.flow, "paper", 3.0)),
        ("the paper's constraint, no smoothing", lambda: measure(motion.flow, "paper", 0.0)),
        ("flow on grey display pictures", lambda: measure(estimate_motion(dataset, picture=grey_picture).flow, "full", 3.0)),
    ]  # fmt: skip
    table = []
    print(f"{'choice':<46} {'L2':>7} {'CosSim':>7} {'gain':>6} {'s':>6}")
    for name, row in rows:
        start = time.perf_counter()
        l2, cosine, gain = row()
        table.append(
            {"choice": name, "l2": l2, "cos_sim": cosine, "gain": gain, "seconds": time.perf_counter() - start}
        )
        print(f"{name:<46} {l2:7.3f} {cosine:7.3f} {gain:6.2f} {table[-1]['seconds']:6.1f}", flush=True)
    if config.json:
        write_json(config.json, {"dataset": str(config.dataset), "voxels": len(voxels.center), "rows": table})


if __name__ == "__main__":
    main()
