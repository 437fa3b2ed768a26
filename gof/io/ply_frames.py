"""A folder of 3DGS PLYs, one for every frame: for viewers that know no time, and play files one after another."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gof.core.drafts import whole_folder
from gof.core.errors import DataFormatError
from gof.core.gaussians import TransientGaussians
from gof.core.ply import splat_columns, write

VISIBLE = 1 / 255
MOST_FRAMES = 100_000  # five digits


def save(gaussians: TransientGaussians, folder: Path, start_s: float, end_s: float, step_s: float) -> list[str]:
    """Write folder/frame00000.ply, ...: number k is the state at start_s + k step_s; the folder must not exist.

    The same Gaussians in the same order in every file, so that their ways can be followed; those that no file would
    show are left out. Returns what was written, in words.

    Raises:
        DataFormatError: more frames than five digits count, or nothing is ever seen.
    """
    count = int(np.floor((end_s - start_s) / step_s + 1e-6)) + 1
    if not 1 <= count <= MOST_FRAMES:
        raise DataFormatError(f"{folder}: {count} frames from {start_s} s to {end_s} s; choose --clip, --frame-time")
    times = start_s + step_s * np.arange(count)
    seen = np.zeros(len(gaussians), bool)
    for time_s in times:
        seen |= gaussians.at(time_s)[1] >= VISIBLE
    if not seen.any():
        raise DataFormatError(f"{folder}: no Gaussian can be seen between {start_s} s and {end_s} s; is that the clip?")
    g = gaussians[seen]
    with whole_folder(folder) as whole:
        for number, time_s in enumerate(times):
            position, opacity = g.at(time_s)
            columns = splat_columns(g.arrays() | {"position": position, "opacity": opacity})
            write(
                whole / f"frame{number:05d}.ply",
                columns,
                [f"state at {time_s:.6f} s", "units: metres; world frame, Z up"],
            )
    return [f"{count} files of {len(g):,} Gaussians, {1e3 * step_s:g} ms apart from {start_s:g} s on"]
