"""How good is the fused 3D flow before any optimisation, and what do its choices buy? Prints a table.

    python -m gof_benchmark.evidence.flow_fusion DATASET [--json FILE]

Every row changes one choice of `gof reconstruct`. Scores are DVE's on the voxels, weighted by their tomographic
emission and averaged over the training frames: L2 (0 perfect, 1 = standing still), CosSim, and the speed relative to
the true one. Seconds are those of the fusion (and of another flow) and the scoring of that row.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro

from gof.dataset import Dataset
from gof.evaluate import dve
from gof.files import write_json
from gof.gaussians import TransientGaussians
from gof.reconstruct.flow_field import FlowField, seen_flow_field
from gof.reconstruct.flow_prior import FlowPrior
from gof.reconstruct.fusion import fuse_frame
from gof.reconstruct.observation import observe
from gof.reconstruct.optical_flow import deepflow, tvl1
from gof.reconstruct.presets import METHODS
from gof.reconstruct.voxels import FlameVoxels


@dataclass
class FusionStudy:
    """Velocity error of the fused flow field for each choice, against the dataset's own velocity."""

    dataset: tyro.conf.Positional[Path]
    """A generated dataset (with ground-truth velocity)."""
    voxels: int = 72
    """Voxels along the longest side of the flame's box."""
    json: Path | None = None
    """Also write the table to this file."""


def on_voxels(voxels: FlameVoxels, velocity: np.ndarray, emission: np.ndarray, time_s: float) -> TransientGaussians:
    """The fused field as point-like Gaussians, weighted by emission, so that DVE itself scores it."""
    n = len(voxels.center)
    return TransientGaussians(
        position=voxels.center,
        velocity=velocity,
        t_mu=np.full(n, time_s),
        t_sigma=np.full(n, np.inf),
        scale=np.full((n, 3), 1e-3 * voxels.voxel_size),
        rotation=np.tile([1.0, 0, 0, 0], (n, 1)),
        opacity=emission / emission.max(),
        color=np.ones((n, 3)),
        dynamic=np.ones(n, bool),
    )


def grey_picture(image: np.ndarray, static: np.ndarray) -> np.ndarray:
    """The usual choice for optical flow: the display picture in grey, background and all."""
    return (np.clip(image, 0, 1) @ [0.299, 0.587, 0.114] * 255).astype(np.uint8)


def main(argv: list[str] | None = None) -> None:
    config = tyro.cli(FusionStudy, prog="python -m gof_benchmark.evidence.flow_fusion", args=argv)
    dataset = Dataset.open(config.dataset)
    seen = observe(dataset)
    field = seen_flow_field(seen, METHODS["gof"], config.voxels)
    voxels = field.voxels

    def measure(field: FlowField) -> list[float]:
        results = []
        for frame in field.frames:
            cloud = on_voxels(voxels, frame.velocity, frame.emission, frame.time_s)
            r = dve(cloud, dataset.velocity.at(frame.time_s), frame.time_s, order=1)
            results.append((r.l2, r.cos_sim, r.speed_ratio))
        return np.mean(results, 0).tolist()

    def constant() -> FlowField:
        frames = []
        for frame in field.frames:
            truth = dataset.velocity.at(frame.time_s).sample(voxels.center)
            mean = (frame.emission[:, None] * truth).sum(0) / frame.emission.sum()
            frames.append(replace(frame, velocity=np.broadcast_to(mean, truth.shape)))
        return replace(field, frames=tuple(frames))

    def fused(flow: np.ndarray, fusion: str, smooth: float) -> FlowField:
        """The field with another flow, fusion or smoothing; its emission stays."""
        frames = []
        for f, frame in enumerate(field.frames):
            velocity, known = fuse_frame(voxels, flow[f], seen.mask[f], frame.emission, fusion, smooth)
            frames.append(replace(frame, velocity=velocity, known=known))
        return replace(field, frames=tuple(frames))

    rows: list[tuple[str, Callable[[], FlowField]]] = [
        ("control: best constant vector", constant),
        ("default: full, smooth 3, light above plate", lambda: fused(seen.flow, "full", 3.0)),
        ("no smoothing", lambda: fused(seen.flow, "full", 0.0)),
        ("smooth 6", lambda: fused(seen.flow, "full", 6.0)),
        ("the paper's constraint, smooth 3", lambda: fused(seen.flow, "paper", 3.0)),
        ("the paper's constraint, no smoothing", lambda: fused(seen.flow, "paper", 0.0)),
        ("flow on grey display pictures", lambda: fused(observe(dataset, picture=grey_picture).flow, "full", 3.0)),
        ("flow by DeepFlow", lambda: fused(observe(dataset, flow=deepflow).flow, "full", 3.0)),
        ("flow by TV-L1", lambda: fused(observe(dataset, flow=tvl1).flow, "full", 3.0)),
        ("default, and the flow prior", lambda: FlowPrior.load().correct(fused(seen.flow, "full", 3.0))),
    ]
    table = []
    print(f"{'choice':<46} {'L2':>7} {'CosSim':>7} {'speed':>6} {'s':>6}")
    for name, row in rows:
        start = time.perf_counter()
        l2, cosine, speed = measure(row())
        table.append(
            {"choice": name, "l2": l2, "cos_sim": cosine, "speed_ratio": speed, "seconds": time.perf_counter() - start}
        )
        print(f"{name:<46} {l2:7.3f} {cosine:7.3f} {speed:6.2f} {table[-1]['seconds']:6.1f}", flush=True)
    if config.json:
        write_json(config.json, {"dataset": str(config.dataset), "voxels": len(voxels.center), "rows": table})


if __name__ == "__main__":
    main()
