"""A folder of 3DGS PLYs, one per time, rows in the same order: what deformation methods export (4DGS of Wu, Grid4D)."""

from __future__ import annotations

import itertools
import re
from pathlib import Path

import numpy as np

from gof.core.errors import DataFormatError
from gof.core.numbered import frame_of, is_hidden, missing_numbers, number_files, usual_step
from gof.core.ply import Ply
from gof.core.trajectory import Trajectory
from gof.io.importers.source import Imported, ImportOptions, Source, require_unit

OPTIONS = ("time_unit_s", "time_zero_s")
TRAININGS = re.compile(r"(point_cloud|iteration|iter|step|chkpnt|ckpt)[_-]?", re.I)  # numbers after these are no times


def matches(source: Source) -> bool:
    return source.path.is_dir() and sum(frame_of(path) is not None for path in _plys(source.path)) >= 2


def read(source: Source, options: ImportOptions) -> Imported:
    """File number k is at time_zero_s + k * time_unit_s; without time_unit_s, one number per frame of the dataset."""
    files = number_files(_plys(source.path))
    unit = options.time_unit_s or options.frame_time_s
    if not unit:
        raise DataFormatError(
            f"{source.path}: give gof convert RESULT --time-unit, the seconds between two numbers of this PLY sequence"
        )
    numbers = [number for number, _ in files]
    count, which = missing_numbers(numbers)
    offsets = unit * np.array(numbers, np.float64)
    require_unit(offsets, options, source.path)
    states = [_state(path) for _, path in files]
    counts = {len(s["position"]) for s in states}
    if len(counts) > 1:
        raise DataFormatError(
            f"{source.path}: the PLYs hold {min(counts)} to {max(counts)} Gaussians; differences need the same "
            "Gaussians, in the same order, in every file"
        )
    _require_times(files, states)
    try:
        trajectory = Trajectory(
            options.time_zero_s + offsets,
            **{name: np.stack([s[name] for s in states]) for name in ("position", "opacity", "scale", "rotation")},
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
            f"{len(files)} PLYs {unit * usual_step(numbers):g} s apart; colours of the middle one",
            *([f"{count} numbers are missing ({which}): gaps in time"] if count else []),
            "4DGS (Wu et al.) writes opacities without their deformation into such PLYs",
        ],
    )


def _state(path: Path) -> dict[str, np.ndarray]:
    ply = Ply.read(path)
    ply.require_read()
    return ply.splats()


def difference_notes(trajectory: Trajectory) -> list[str]:
    if trajectory.velocity is not None:
        return ["velocities as stored"]
    change = trajectory.difference_change()
    note = "velocities are differences of positions"
    if np.isnan(change):
        return [note]
    return [
        f"{note}; spanning twice the step changes them by {change:.1%}: their error is a third of that where motion is "
        "smooth, and up to all of it where it has kinks, as networks' has"
        + ("; better, give `velocity` by differences over 1e-4 s in your own code" if change > 0.05 else "")
    ]


def clock_notes(trajectory: Trajectory, options: ImportOptions) -> list[str]:
    """Return a trajectory's times are seconds by its schema; a note where they last much longer than the clip."""
    first, last = trajectory.covered_s
    clip = 0.0 if options.clip_s is None else options.clip_s[1] - options.clip_s[0]
    if not 0 < 2 * clip < last - first:
        return []
    return [f"its times last {last - first:.3g} s, the clip {clip:.3g} s: are they seconds, not shares of the clip?"]


def _plys(folder: Path) -> list[Path]:
    return [path for path in folder.iterdir() if path.suffix.lower() == ".ply" and not is_hidden(path)]


def _require_times(files: list[tuple[int, Path]], states: list[dict[str, np.ndarray]]) -> None:
    """Raise DataFormatError: the numbers are a training's steps, or of several pictures of one time."""
    path = files[0][1]
    if TRAININGS.fullmatch((frame_of(path) or ("", 0, ""))[0].replace("#", "")):
        raise DataFormatError(
            f"{path.parent}: PLYs named as '{path.name}' are of several steps of a training, not of several times; if "
            "they are of times, name them time_00000.ply, time_00001.ply, ..."
        )
    same = [np.array_equal(a["position"], b["position"]) for a, b in itertools.pairwise(states)]
    if any(same) and not all(same):
        k = same.index(True)
        raise DataFormatError(
            f"{path.parent}: '{files[k][1].name}' and '{files[k + 1][1].name}' hold the same positions; does the "
            "exporter write a file per picture, so that several are of one time? Give one file per time"
        )
