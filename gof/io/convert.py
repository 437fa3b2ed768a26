"""Any known result to our formats, or to FTGS-PLY for the FreeTimeGS players."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gof.errors import DataFormatError
from gof.gaussians import TransientGaussians
from gof.io.importers import Imported, freetime
from gof.options import require_number


def convert(
    imported: Imported,
    out: Path,
    start_s: float | None = None,
    end_s: float | None = None,
    frame_time_s: float | None = None,
) -> list[str]:
    """Write a result by suffix: .npz (exact), .ply (3DGS attributes plus time and velocity), .ftgs.ply.

    Returns what the format made of it, in words.

    Args:
        start_s, end_s: first and last second of the clip in an .ftgs.ply; default: when the first Gaussian appears and
            when the last one is gone.
        frame_time_s: seconds between two frames; with both of the above it tells an .ftgs.ply its number of frames.
    Raises:
        DataFormatError: the file exists, the suffix is unknown, positions sampled in time are to become a closed form,
            or start_s or end_s is given for another format.
    """
    require_number("--start", start_s)
    require_number("--end", end_s)
    if (start_s, end_s) != (None, None) and not out.name.endswith(".ftgs.ply"):
        raise DataFormatError(f"{out}: --start and --end mean something in .ftgs.ply only; leave them out")
    if out.exists():
        raise DataFormatError(f"{out}: exists already; remove it or choose another name")
    gaussians = imported.gaussians
    if not isinstance(gaussians, TransientGaussians) and out.suffix != ".npz":
        raise DataFormatError(f"{out}: positions sampled in time have no closed form; write .npz (gof-trajectory/1)")
    if out.name.endswith(".ftgs.ply"):
        return _save_ftgs(gaussians, out, start_s, end_s, frame_time_s)
    gaussians.save(out, f"{imported.method}: {imported.path.name}")
    return []


def _save_ftgs(
    gaussians: TransientGaussians,
    out: Path,
    start_s: float | None,
    end_s: float | None,
    frame_time_s: float | None,
) -> list[str]:
    frames = None
    if frame_time_s and start_s is not None and end_s is not None:
        frames = round((end_s - start_s) / frame_time_s) + 1
    born, dead = gaussians.life() if gaussians.dynamic.any() else (0.0, 1.0)
    if not np.isfinite([born, dead]).all() and None in (start_s, end_s):
        raise DataFormatError(f"{out}: some Gaussians are always on, so the clip's --start and --end must be given")
    start_s = born if start_s is None else start_s
    end_s = dead if end_s is None else end_s
    freetime.save(gaussians, out, start_s, end_s, frames)
    return freetime.losses(gaussians, start_s, end_s)
