"""The memory that a reconstruction takes, predicted before it starts."""

from __future__ import annotations

import ctypes
import sys

import psutil

from gof.core.errors import GofError

GB = 1e9
# Bytes at the peaks of finding the flow field and of optimising, fitted to measured runs (notebook/reliability.md).
FIELD, FIELD_PIXEL, FIELD_VOXEL = 300e6, 25.0, 175.0
FITTING, FITTING_PIXEL, FITTING_VOXEL, GAUSSIAN = 360e6, 20.0, 110.0, 1350.0
HULL = 0.07  # of the cube of voxels along the longest side of the flame's box, that stand in its hull
ADDRESSES = 0.8e9  # what libraries map and never touch, which `ulimit -v` counts too


def needed_bytes(training_pixels: int, frames: int, gaussians: int, voxels: int) -> float:
    """Predict the peak memory of `gof reconstruct`, within about 15 %.

    Args:
        training_pixels: of all training pictures together, at the size that is reconstructed.
        frames: for training.   gaussians: in all frames together.
        voxels: along the longest side of the flame's box.
    """
    hull = HULL * voxels**3 * frames
    return max(
        FIELD + FIELD_PIXEL * training_pixels + FIELD_VOXEL * hull,
        FITTING + FITTING_PIXEL * training_pixels + FITTING_VOXEL * hull + GAUSSIAN * gaussians,
    )


def in_words(needed: float) -> str:
    return f"{needed / GB:.1f} GB of memory"


def require(needed: float) -> None:
    """Refuse what this machine cannot hold, and warn where other programs stand in the way.

    Raises:
        GofError: it has less in all, or this process may not take so much.
    """
    memory = psutil.virtual_memory()
    remedy = "--max-size, --gaussians or --voxels with less, or a dataset of fewer frames, need less"
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


def give_back() -> None:
    """Return freed memory, which the C library keeps otherwise, to the system; done by glibc alone, elsewhere nothing.

    After stages that work on many frames side by side it is a sixth of all.
    """
    try:
        ctypes.CDLL("libc.so.6").malloc_trim(0)
    except (OSError, AttributeError):
        return


def _limit() -> float:
    """Bytes that this process may use under `ulimit -v`, infinite without one."""
    try:
        import resource
    except ModuleNotFoundError:  # Windows
        return float("inf")
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    return float("inf") if limit == resource.RLIM_INFINITY else max(limit - ADDRESSES, 0.0)
