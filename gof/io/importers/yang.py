"""4DGS of Yang et al. (fudan-zvg): Gaussians in space-time. Conditioning on time gives everything in closed form.

With the 4D covariance S (index 3 is time): velocity S[:3, 3] / S[3, 3]; temporal variance S[3, 3]; spatial covariance
S[:3, :3] - S[:3, 3] S[:3, 3]^T / S[3, 3], the same at all times.
"""

from __future__ import annotations

import ast
from datetime import date
from pathlib import Path

import numpy as np

from gof.core.errors import DataFormatError
from gof.core.gaussians import TransientGaussians
from gof.core.harmonics import plain_color
from gof.core.ply import activate_scale, quaternions, sigmoid
from gof.core.rotations import quaternions_wxyz
from gof.io.importers.paper_code import is_capture
from gof.io.importers.source import Imported, ImportOptions, Source, array, require_unit

OPTIONS = ("time_unit_s", "time_zero_s", "code_date")
LENGTH = 19
FLIPPED_SINCE = date(2024, 9, 15)  # its commit 900c592; before, the same numbers turned 4-space another way
LONGEST_SETTINGS = 100_000  # characters of a training's `cfg_args` that are read
MARGINAL_CUT = 0.05  # its renderer skips a Gaussian while its temporal window is below this


def matches(source: Source) -> bool:
    return source.is_checkpoint and is_capture(source.checkpoint, LENGTH)


def read(source: Source, options: ImportOptions) -> Imported:
    (state, iteration), path = source.checkpoint, source.path
    if state[16] is not True:
        raise DataFormatError(
            f"{path}: trained with rot_4d={state[16]}, whose Gaussians do not move (space and time are independent); "
            "there is no velocity to score"
        )
    xyz = array(state[1], "xyz", (None, 3), path)
    n = len(xyz)
    scale = np.concatenate([array(state[4], "scaling", (n, 3), path), array(state[14], "scaling_t", (n, 1), path)], 1)
    left = quaternions(array(state[5], "rotation", (n, 4), path), path)
    right = quaternions(array(state[15], "rotation_r", (n, 4), path), path)
    settings = _training_settings(path.parent / "cfg_args")
    flipped, flip_note = _is_flipped(settings, options)
    covariance = covariance_4d(activate_scale(scale, path), left, right, flipped)
    velocity, spatial, variance_t = condition_on_time(covariance)
    std, rotation = principal_axes(spatial)
    window, window_note = _prefilter(settings)
    t_mu = array(state[13], "t", (n, 1), path)[:, 0].astype(np.float64)
    require_unit(t_mu, options, path)
    unit = options.time_unit_s or 1.0
    color, colour_note = _peak_color(
        np.concatenate([array(state[2], "f_dc", (n, 1, 3), path), array(state[3], "f_rest", (n, None, 3), path)], 1)
    )
    gaussians = TransientGaussians(
        position=xyz,
        velocity=velocity / unit,
        t_mu=t_mu * unit + options.time_zero_s,
        t_sigma=np.sqrt(variance_t + window) * unit,
        scale=std,
        rotation=rotation,
        opacity=sigmoid(array(state[6], "opacity", (n, 1), path)[:, 0]),
        color=color,
        dynamic=np.ones(n, bool),
    )
    return Imported(
        gaussians,
        "yang",
        path,
        [
            f"iteration {iteration}; one unit of its time taken as {unit:g} s",
            f"its renderer drops Gaussians while their window is below {MARGINAL_CUT}; here they keep a small weight",
            flip_note,
            window_note,
            *colour_note,
        ],
    )


def _training_settings(path: Path) -> dict[str, object]:
    """Return the numbers of a training's `cfg_args`, "Namespace(name=value, ...)"; read, never executed. Empty without
    one."""
    if not path.is_file() or path.stat().st_size > LONGEST_SETTINGS:
        return {}
    try:
        call = ast.parse(path.read_text(encoding="utf-8"), mode="eval").body
        given = call.keywords if isinstance(call, ast.Call) else []
        return {k.arg: ast.literal_eval(k.value) for k in given if k.arg and _is_number(k.value)}
    except (SyntaxError, ValueError, TypeError, AttributeError, RecursionError, MemoryError):
        return {}


def _is_number(node: ast.expr) -> bool:
    return isinstance(node.operand if isinstance(node, ast.UnaryOp) else node, ast.Constant)


def _is_flipped(settings: dict[str, object], options: ImportOptions) -> tuple[bool, str]:
    """Return whether the 4D rotation is meant as since 2024-09-15, and in words why."""
    if options.code_date is not None:
        flipped = date.fromisoformat(options.code_date) >= FLIPPED_SINCE
        return flipped, f"its 4D rotation read as of code {'since' if flipped else 'before'} {FLIPPED_SINCE}"
    if "prefilter_var" in settings:  # an option of 2026
        return True, f"its 4D rotation read as of code since {FLIPPED_SINCE}, by its cfg_args"
    return True, (
        f"its 4D rotation taken as of code since {FLIPPED_SINCE}; if the code that trained is older, every velocity "
        'here is wrong: its date belongs into RESULT.gof.json, as "code_date" (docs/importers.md)'
    )


def _prefilter(settings: dict[str, object]) -> tuple[float, str]:
    """Return the widening of the temporal window when it is drawn, in its time squared, and its source."""
    value = settings.get("prefilter_var", settings and -1.0)
    if isinstance(value, (int, float)) and np.isfinite(value):
        return max(float(value), 0.0), f"prefilter_var {value:g}, by cfg_args beside it"
    return 0.0, "no cfg_args beside it: taken as trained without prefilter_var, which would widen every life time"


def covariance_4d(scale: np.ndarray, left: np.ndarray, right: np.ndarray, flipped: bool = True) -> np.ndarray:
    """Return (N, 4, 4) covariance of standard deviations (N, 4) turned by the pair of quaternions (N, 4), (N, 4).

    The rotation of 4-space x -> l x r, in the component order x, y, z, t; `flipped`: in the order t, z, y, x.
    """
    a, b, c, d = (left / np.linalg.norm(left, axis=1, keepdims=True)).astype(np.float64).T
    p, q, r, s = (right / np.linalg.norm(right, axis=1, keepdims=True)).astype(np.float64).T
    L = np.stack([a, -b, -c, -d, b, a, -d, c, c, d, a, -b, d, -c, b, a], -1).reshape(-1, 4, 4)
    R = np.stack([p, q, r, s, -q, p, -s, r, -r, s, p, -q, -s, -r, q, p], -1).reshape(-1, 4, 4)
    turn = (L @ R)[:, ::-1, ::-1] if flipped else L @ R
    axes = turn * scale[:, None, :]
    return axes @ axes.transpose(0, 2, 1)


def condition_on_time(covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """velocity (N, 3), spatial covariance (N, 3, 3), temporal variance (N,) of (N, 4, 4)."""
    cross, variance = covariance[:, :3, 3], covariance[:, 3, 3]
    velocity = cross / variance[:, None]
    return velocity, covariance[:, :3, :3] - velocity[:, :, None] * cross[:, None, :], variance


def principal_axes(covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return standard deviations (N, 3) and quaternions (N, 4) wxyz of covariances (N, 3, 3)."""
    values, axes = np.linalg.eigh(covariance)
    axes[np.linalg.det(axes) < 0, :, 0] *= -1
    floor = 1e-12 * np.maximum(values.max(1, keepdims=True), 1e-30)  # rounding may leave a flat one below zero
    return np.sqrt(np.maximum(values, floor)), quaternions_wxyz(axes)


def _peak_color(sh: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """Return colours swing as cos(2 pi k dt / duration), k = 0, 1, 2, in blocks of 16; their sum shows at the peak, dt
    = 0."""
    if sh.shape[1] in (1, 4, 9, 16):
        return sh, []
    if sh.shape[1] in (32, 48):
        return sh.reshape(len(sh), -1, 16, 3).sum(1), [
            "colours that change over time are those at each Gaussian's peak"
        ]
    return plain_color(sh), [f"{sh.shape[1]} colour coefficients are unknown to this importer: plain colours only"]
