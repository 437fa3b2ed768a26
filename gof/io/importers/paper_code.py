"""The paper's own code, both of its releases (docs/importers.md).

ECCV demo: `chkpnt{it}.pth` with `scale_bounds.json` of the same iteration. Released after it: `chkpnt{it}.pth` that
holds the bounds itself, and a PLY with `velocity_0..2`, whose bounds lie beside it.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gof.core.errors import DataFormatError
from gof.core.files import read_json
from gof.core.gaussians import TransientGaussians
from gof.core.ply import activate_scale, quaternions, sigmoid
from gof.io.importers.source import Imported, ImportOptions, Source, array

OPTIONS = ("time_unit_s", "time_zero_s")
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
WITH_BOUNDS = (*LAYOUT, "dynamic_scale_min", "dynamic_scale_max")
VELOCITY = ("velocity_0", "velocity_1", "velocity_2")
MILLISECOND = 1e-3  # its transforms hold microseconds times 1e-3


@dataclass(frozen=True)
class ScaleBounds:
    """Sizes of dynamic Gaussians lie between them, in the method's length; `source` names where they are from."""

    low: float
    high: float
    source: str


@dataclass(frozen=True)
class PaperGaussians:
    """The content of its files, in its units: its length, per ms, ms.

    Attributes:
        position, velocity, scaling: (N, 3).   rotation: (N, 4) wxyz.   opacity: (N,) 0..1.   color: (N, K, 3).
        t_mu, t_sigma: (N,).   dynamic: (N,) bool.
        scaling: raw: a sigmoid between the bounds where dynamic, a logarithm elsewhere.
        bounds: None where the method has none; then all sizes are logarithms.
        path: of the file, for errors.
    """

    position: np.ndarray
    velocity: np.ndarray
    scaling: np.ndarray
    rotation: np.ndarray
    opacity: np.ndarray
    color: np.ndarray
    t_mu: np.ndarray
    t_sigma: np.ndarray
    dynamic: np.ndarray
    bounds: ScaleBounds | None
    path: Path

    @property
    def scale(self) -> np.ndarray:
        """(N, 3) standard deviations, in its length."""
        if self.bounds is None:
            return activate_scale(self.scaling, self.path)
        span = self.bounds.high - self.bounds.low
        logarithms = np.where(self.dynamic[:, None], 0, self.scaling)
        bounded = self.bounds.low + span * sigmoid(self.scaling)
        return np.where(self.dynamic[:, None], bounded, activate_scale(logarithms, self.path))


def matches(source: Source) -> bool:
    if source.path.suffix == ".ply" and source.path.is_file():
        return source.ply.has("t_mu", "t_sigma", "is_dynamic") and not source.ply.has("vx")
    return (
        source.is_checkpoint
        and (is_capture(source.checkpoint, len(LAYOUT)) or is_capture(source.checkpoint, len(WITH_BOUNDS)))
        and getattr(source.checkpoint[0][10], "ndim", 0) == 1
    )


def is_capture(value, length: int) -> bool:
    """Return (tuple of `length` entries, iteration), as 3DGS descendants save their state."""
    return (
        isinstance(value, (tuple, list))
        and len(value) == 2
        and isinstance(value[0], (tuple, list))
        and len(value[0]) == length
    )


def read(source: Source, options: ImportOptions) -> Imported:
    """Velocities and times are in milliseconds there (or `time_unit_s`); velocities of static rows mean nothing."""
    splats = _from_ply(source) if source.path.suffix == ".ply" else _from_checkpoint(source)
    unit = options.time_unit_s or MILLISECOND
    t_sigma = np.abs(splats.t_sigma.astype(np.float64)) * unit  # only its square is used
    dead = splats.dynamic & (t_sigma == 0)
    gaussians = TransientGaussians(
        position=splats.position,
        velocity=splats.velocity.astype(np.float64) / unit,
        t_mu=splats.t_mu.astype(np.float64) * unit + options.time_zero_s,
        t_sigma=np.maximum(t_sigma, 1e-9),
        scale=splats.scale,
        rotation=splats.rotation,
        opacity=np.where(dead, 0, splats.opacity),
        color=splats.color,
        dynamic=splats.dynamic,
    )
    bounds = f"scale bounds from {splats.bounds.source}" if splats.bounds else "no scale bounds: all sizes logarithms"
    return Imported(gaussians, "authors", source.path, [f"one unit of its time taken as {unit:g} s; {bounds}"])


def _from_checkpoint(source: Source) -> PaperGaussians:
    (state, iteration), path = source.checkpoint, source.path
    xyz = array(state[1], "xyz", (None, 3), path)
    n = len(xyz)
    dynamic = array(state[10], "is_dynamic", (n,), path).astype(bool)
    if len(state) == len(WITH_BOUNDS):
        bounds = None if state[16] is None else _bounds(state[16], state[17], path)
    else:
        bounds = _read_bounds(path, [Path(), Path("point_cloud") / f"iteration_{iteration}"], "scale_bounds.json")
    return PaperGaussians(
        position=xyz,
        velocity=array(state[2], "velocity", (n, 3), path),
        scaling=array(state[5], "scaling", (n, 3), path),
        rotation=quaternions(array(state[6], "rotation", (n, 4), path), path),
        opacity=sigmoid(array(state[7], "opacity", (n, 1), path)[:, 0]),
        color=np.concatenate(
            [array(state[3], "f_dc", (n, 1, 3), path), array(state[4], "f_rest", (n, None, 3), path)], 1
        ),
        t_mu=array(state[8], "t_mu", (n, 1), path)[:, 0],
        t_sigma=array(state[9], "t_sigma", (n, 1), path)[:, 0],
        dynamic=dynamic,
        bounds=bounds,
        path=path,
    )


def _from_ply(source: Source) -> PaperGaussians:
    ply, path = source.ply, source.path
    if not ply.has(*VELOCITY):
        raise DataFormatError(
            f"{path}: this PLY of the paper's code (its ECCV demo) holds no velocities; give the chkpnt*.pth of the "
            "same iteration (two folders up)"
        )
    shared = ply.without_scale()
    times = ply.columns("t_mu", "t_sigma", "is_dynamic")
    return PaperGaussians(
        position=shared["position"],
        velocity=ply.columns(*VELOCITY),
        scaling=ply.columns("scale_0", "scale_1", "scale_2"),
        rotation=shared["rotation"],
        opacity=shared["opacity"],
        color=shared["color"],
        t_mu=times[:, 0],
        t_sigma=times[:, 1],
        dynamic=times[:, 2] > 0.5,
        bounds=_read_bounds(path, [Path()], f"{path.stem}_scale_bounds.json"),
        path=path,
    )


def _read_bounds(result: Path, folders: list[Path], name: str) -> ScaleBounds:
    """Return the bounds' file of a result, in one of `folders` beside it."""
    path = next((p for folder in folders if (p := result.parent / folder / name).is_file()), None)
    if path is None:
        raise DataFormatError(
            f"{result}: {name} is missing; without it the sizes of dynamic Gaussians are unknown. Copy it from "
            f"{folders[-1] if len(folders) > 1 else 'the folder of the training'} beside the result"
        )
    values = read_json(path)
    try:
        return _bounds(values["dynamic_scale_min"], values["dynamic_scale_max"], path)
    except (KeyError, TypeError) as e:
        raise DataFormatError(f"{path}: needs numbers 'dynamic_scale_min' and 'dynamic_scale_max'") from e


def _bounds(low, high, path: Path) -> ScaleBounds:
    try:
        low, high = float(low), float(high)
    except (TypeError, ValueError) as e:
        raise DataFormatError(f"{path}: needs numbers 'dynamic_scale_min' and 'dynamic_scale_max'") from e
    if not 0 < low < high < np.inf:
        raise DataFormatError(f"{path}: bounds {low}..{high} are not 0 < min < max")
    return ScaleBounds(low, high, str(path))
