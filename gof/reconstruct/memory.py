"""How much memory a reconstruction takes, known before it starts."""

from __future__ import annotations

import sys

import psutil

from gof.dataset import Dataset
from gof.errors import GofError

GB = 1e9
# Bytes, fitted to measured runs (docs/reconstruction.md, "Memory").
BASE, A_TRAINING_PIXEL, A_GAUSSIAN, A_VOXEL = 0.4e9, 60.0, 1600.0, 400.0
HULL = 0.15  # of the cells of the flame's box that stand in the hull


def needed_bytes(dataset: Dataset, gaussians: int, voxels: int) -> float:
    """What `gof reconstruct` takes of memory at its peak, about.

    Args:
        dataset: at the size that is reconstructed.
        gaussians: in all frames together.   voxels: along the longest side of the flame's box.
    """
    pixels = len(dataset.train_frames) * sum(camera.width * camera.height for camera in dataset.cameras)
    return BASE + A_TRAINING_PIXEL * pixels + A_GAUSSIAN * gaussians + A_VOXEL * HULL * voxels**3


def in_words(needed: float) -> str:
    return f"{needed / GB:.1f} GB of memory"


def require(needed: float) -> None:
    """Refuse what this machine cannot hold, and warn where others' programs stand in the way.

    Raises:
        GofError: it has less in all.
    """
    memory = psutil.virtual_memory()
    remedy = "--longest-side, --gaussians or --voxels with less, or a dataset of fewer frames, need less"
    limit = min(memory.total, _limit())
    if needed > limit:
        raise GofError(
            f"about {in_words(needed)} are needed, and this machine has {limit / GB:.1f} GB; {remedy}; --anyway tries"
        )
    if needed > memory.available:
        print(
            f"warning: about {in_words(needed)} are needed, and {memory.available / GB:.1f} GB are free; {remedy}",
            file=sys.stderr,
        )


def _limit() -> float:
    """Bytes that this process may take (`ulimit -v`), infinite without a limit."""
    try:
        import resource
    except ModuleNotFoundError:  # Windows
        return float("inf")
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    return float("inf") if limit == resource.RLIM_INFINITY else float(limit)
