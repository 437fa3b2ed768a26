"""A folder of 3DGS PLYs, one per time, rows in the same order: what deformation methods export (4DGS of Wu, Grid4D)."""

from __future__ import annotations

import re

import numpy as np

from gof.errors import DataFormatError
from gof.io.importers.source import Imported, ImportOptions, Source
from gof.ply import Ply
from gof.trajectory import Trajectory


def matches(source: Source) -> bool:
    return source.path.is_dir() and len(_numbered(source)) >= 2


def read(source: Source, options: ImportOptions) -> Imported:
    """File number k is at time_zero_s + k * time_unit_s; without time_unit_s, one number per frame of the dataset."""
    unit = options.time_unit_s or options.frame_time_s
    if not unit:
        raise DataFormatError(f"{source.path}: give --time-unit, the seconds between two numbers of this PLY sequence")
    files = _numbered(source)
    states = [Ply.read(path).splats() for _, path in files]
    counts = {len(s["position"]) for s in states}
    if len(counts) > 1:
        raise DataFormatError(
            f"{source.path}: the PLYs hold {min(counts)} to {max(counts)} Gaussians; differences need the same "
            "Gaussians, in the same order, in every file"
        )
    time_s = options.time_zero_s + unit * np.array([number for number, _ in files], np.float64)
    try:
        trajectory = Trajectory(
            time_s,
            *(np.stack([s[name] for s in states]) for name in ("position", "opacity", "scale", "rotation")),
            color=states[len(states) // 2]["color"],
        )
    except DataFormatError as e:
        raise DataFormatError(f"{source.path}: {e}") from e
    return Imported(
        trajectory,
        "ply-sequence",
        source.path,
        [
            *difference_notes(trajectory),
            f"{len(files)} PLYs {unit:g} s apart; colours of the middle one",
            "4DGS (Wu et al.) writes opacities without their deformation into such PLYs",
        ],
    )


def difference_notes(trajectory: Trajectory) -> list[str]:
    if trajectory.velocity is not None:
        return ["velocities as stored"]
    error = trajectory.difference_error()
    return [
        "velocities are differences of positions"
        + (
            ""
            if np.isnan(error)
            else f"; spanning twice the step changes them by {error:.1%}"
            + (", so export half steps" if error > 0.05 else "")
        )
    ]


def _numbered(source: Source) -> list[tuple[int, object]]:
    found = [(int(m[1]), p) for p in source.path.iterdir() if (m := re.fullmatch(r"\D*?(\d+)\.ply", p.name))]
    return sorted(found)
