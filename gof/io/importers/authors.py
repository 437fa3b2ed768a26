"""The paper's own code: `chkpnt{it}.pth` with `scale_bounds.json` of the same iteration."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gof.errors import DataFormatError
from gof.files import read_json
from gof.gaussians import TransientGaussians
from gof.io.importers.source import Imported, ImportOptions, Source, array
from gof.ply import exp, quaternions, sigmoid

LAYOUT = (
    "active_sh_degree",
    "xyz",
    "velocity",
    "f_dc",
    "f_rest",
    "scaling",
    "rotation",
    "opacity",
    "t_mu",
    "t_sigma",
    "is_dynamic",
    "max_radii2D",
    "xyz_gradient_accum",
    "denom",
    "optimizer_state",
    "spatial_lr_scale",
)
MILLISECOND = 1e-3  # its transforms hold microseconds times 1e-3


def matches(source: Source) -> bool:
    if source.path.suffix == ".ply" and source.path.is_file():
        return source.ply.has("t_mu", "t_sigma", "is_dynamic") and not source.ply.has("vx")
    return (
        source.is_checkpoint
        and is_capture(source.checkpoint, len(LAYOUT))
        and getattr(source.checkpoint[0][10], "ndim", 0) == 1
    )


def is_capture(value, length: int) -> bool:
    """(tuple of `length` entries, iteration), as 3DGS descendants save their state."""
    return (
        isinstance(value, (tuple, list))
        and len(value) == 2
        and isinstance(value[0], (tuple, list))
        and len(value[0]) == length
    )


def read(source: Source, options: ImportOptions) -> Imported:
    """Velocities and times are in milliseconds there (or `time_unit_s`); velocities of static rows mean nothing."""
    if source.path.suffix == ".ply":
        raise DataFormatError(
            f"{source.path}: this PLY of the paper's code holds no velocities; give the chkpnt*.pth of the same "
            "iteration (two folders up)"
        )
    (state, iteration), path = source.checkpoint, source.path
    xyz = array(state[1], "xyz", (None, 3), path)
    n = len(xyz)
    velocity = array(state[2], "velocity", (n, 3), path)
    color = np.concatenate([array(state[3], "f_dc", (n, 1, 3), path), array(state[4], "f_rest", (n, None, 3), path)], 1)
    raw = array(state[5], "scaling", (n, 3), path)
    dynamic = array(state[10], "is_dynamic", (n,), path).astype(bool)
    bounds = _scale_bounds(path, int(iteration))
    low, high = _read_bounds(bounds)
    scale = np.where(dynamic[:, None], low + (high - low) * sigmoid(raw), exp(raw))
    unit = options.time_unit_s or MILLISECOND
    t_sigma = (
        np.abs(array(state[9], "t_sigma", (n, 1), path)[:, 0].astype(np.float64)) * unit
    )  # only its square is used
    dead = dynamic & (t_sigma == 0)
    gaussians = TransientGaussians(
        position=xyz,
        velocity=velocity.astype(np.float64) / unit,
        t_mu=array(state[8], "t_mu", (n, 1), path)[:, 0].astype(np.float64) * unit + options.time_zero_s,
        t_sigma=np.maximum(t_sigma, 1e-9),
        scale=scale,
        rotation=quaternions(array(state[6], "rotation", (n, 4), path), path),
        opacity=np.where(dead, 0, sigmoid(array(state[7], "opacity", (n, 1), path)[:, 0])),
        color=color,
        dynamic=dynamic,
    )
    return Imported(
        gaussians,
        "authors",
        path,
        [f"iteration {iteration}; one unit of its time taken as {unit:g} s; scale bounds from {bounds}"],
    )


def _scale_bounds(path: Path, iteration: int) -> Path:
    candidates = [
        path.parent / "scale_bounds.json",
        path.parent / "point_cloud" / f"iteration_{iteration}" / "scale_bounds.json",
    ]
    for candidate in candidates:
        if candidate.is_file():
            return candidate
    raise DataFormatError(
        f"{path}: scale_bounds.json is missing; without it the sizes of dynamic Gaussians are unknown. Copy it from "
        f"point_cloud/iteration_{iteration}/ beside the checkpoint"
    )


def _read_bounds(path: Path) -> tuple[float, float]:
    values = read_json(path)
    try:
        low, high = float(values["dynamic_scale_min"]), float(values["dynamic_scale_max"])
    except (KeyError, TypeError, ValueError) as e:
        raise DataFormatError(f"{path}: needs numbers 'dynamic_scale_min' and 'dynamic_scale_max'") from e
    if not 0 < low < high < np.inf:
        raise DataFormatError(f"{path}: bounds {low}..{high} are not 0 < min < max")
    return low, high
