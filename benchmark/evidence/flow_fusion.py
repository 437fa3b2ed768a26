"""How good is the fused 3D flow before any optimisation, and what do its choices buy? Prints a table.

    python -m gof_benchmark.evidence.flow_fusion DATASET [--json FILE]

Every row changes one choice of `gof reconstruct`. Scores are DVE's on the voxels, weighted by their tomographic
emission and averaged over the training frames: L2 (0 perfect, 1 = standing still), CosSim, and the speed relative to
the true one. Seconds are those of the fusion (and of another flow) and the scoring of that row.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import tyro

from gof.core.files import write_json
from gof.dataset import Dataset
from gof.reconstruct.flow_field import FlowField, seen_flow_field
from gof.reconstruct.flow_prior import FlowPrior
from gof.reconstruct.fusion import fuse_frame
from gof.reconstruct.methods import OURS
from gof.reconstruct.observation import Observation, observe
from gof.reconstruct.optical_flow import deepflow, tvl1
from gof_benchmark.training.field_score import best_constant, buoyant_law, mean_per_height, score


@dataclass(frozen=True)
class FlowFusion:
    """Velocity error of the fused flow field for each choice, against the dataset's own velocity."""

    dataset: tyro.conf.Positional[Path]
    """A generated dataset (with ground-truth velocity)."""
    voxels: int = 72
    """Voxels along the longest side of the flame's box."""
    json: Path | None = None
    """Also write the table to this file."""


def main(argv: list[str] | None = None) -> None:
    """Print a row per choice."""
    config = tyro.cli(FlowFusion, prog="python -m gof_benchmark.evidence.flow_fusion", args=argv)
    dataset = Dataset.open(config.dataset)
    seen = observe(dataset)
    field = seen_flow_field(seen, OURS, config.voxels)
    table = []
    print(f"{'choice':<46} {'L2':>7} {'CosSim':>7} {'speed':>6} {'s':>6}")
    for name, choice in choices(dataset, seen, field).items():
        start = time.perf_counter()
        found = score(choice(), dataset)
        seconds = time.perf_counter() - start
        table.append({"choice": name} | asdict(found) | {"seconds": seconds})
        figures = f"{found.l2:7.3f} {found.cos_sim:7.3f} {found.speed_ratio:6.2f} {seconds:6.1f}"
        print(f"{name:<46} {figures}", flush=True)
    if config.json:
        write_json(config.json, {"dataset": str(config.dataset), "voxels": len(field.voxels.center), "rows": table})


def choices(dataset: Dataset, seen: Observation, field: FlowField) -> dict[str, Callable[[], FlowField]]:
    """Return the makers of the field, by their name in the table."""

    def fused(flow: np.ndarray, fusion: str = "full", smooth: float = 3.0) -> FlowField:
        """Return the field with another flow, fusion or smoothing; its emission stays."""
        frames = []
        for f, frame in enumerate(field.frames):
            velocity, known = fuse_frame(field.voxels, flow[f], seen.mask[f], frame.emission, fusion, smooth)
            frames.append(replace(frame, velocity=velocity, known=known))
        return replace(field, frames=tuple(frames))

    return {
        "trivial: best constant vector (knows the truth)": lambda: best_constant(field, dataset),
        "trivial: mean per height (knows the truth)": lambda: mean_per_height(field, dataset),
        "trivial: buoyant law straight up (knows metres)": lambda: buoyant_law(field),
        "default: full, smooth 3, light above plate": lambda: fused(seen.flow),
        "no smoothing": lambda: fused(seen.flow, smooth=0.0),
        "smooth 6": lambda: fused(seen.flow, smooth=6.0),
        "the paper's constraint, smooth 3": lambda: fused(seen.flow, "paper"),
        "the paper's constraint, no smoothing": lambda: fused(seen.flow, "paper", 0.0),
        "flow on grey display pictures": lambda: fused(observe(dataset, picture=grey_picture).flow),
        "flow by DeepFlow": lambda: fused(observe(dataset, flow=deepflow).flow),
        "flow by TV-L1": lambda: fused(observe(dataset, flow=tvl1).flow),
        "default, and the flow prior": lambda: FlowPrior.load().correct(fused(seen.flow)),
    }


def grey_picture(image: np.ndarray, static: np.ndarray) -> np.ndarray:
    """Return the usual choice for optical flow: the display picture in grey, background and all."""
    return (np.clip(image, 0, 1) @ [0.299, 0.587, 0.114] * 255).astype(np.uint8)


if __name__ == "__main__":
    main()
