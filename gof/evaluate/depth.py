"""RMSE_depth: rendered depth of the flame against a predicted or true depth, after the best linear alignment."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from gof.core.errors import DataFormatError, GofError, require_finite
from gof.core.files import path_in
from gof.core.npz import read_npy


class DepthScore(NamedTuple):
    rmse: float  # in the unit of the truth
    scale: float  # truth ~ scale depth + shift
    shift: float
    pixels: int


def rmse_depth(depth: np.ndarray, truth: np.ndarray, mask: np.ndarray | None = None) -> DepthScore | None:
    """Root-mean-square of truth - (scale depth + shift), with scale and shift chosen to make it least.

    A monocular prediction is known up to such a linear map, so only the shape of the depth is judged. A constant depth
    has no shape: scale 0, and the score is the standard deviation of the truth.

    Args:
        depth, truth: (H, W), any unit.   mask: (H, W) weights >= 0; None = every pixel.
    Returns:
        DepthScore, or None when the mask holds fewer than 3 pixels.
    Raises:
        GofError: shapes disagree.   NonFiniteError: NaN or Inf where the mask is not zero.
    """
    depth, truth = np.asarray(depth, np.float64), np.asarray(truth, np.float64)
    weight = np.ones(depth.shape) if mask is None else np.asarray(mask, np.float64)
    if depth.ndim != 2 or depth.shape != truth.shape or weight.shape != depth.shape:
        raise GofError(
            f"depth, truth and mask have shapes {depth.shape}, {truth.shape}, {weight.shape}; expected the same (H, W)"
        )
    seen = weight > 0
    d, t, w = depth[seen], truth[seen], weight[seen]
    require_finite("depth", d)
    require_finite("true depth", t)
    if len(d) < 3:
        return None
    w = w / w.sum()
    mean_d, mean_t = w @ d, w @ t
    variance = w @ (d - mean_d) ** 2
    tiny = 1e-12 * max(float(np.abs(d).max()) ** 2, 1e-300)
    scale = float(w @ ((d - mean_d) * (t - mean_t)) / variance) if variance > tiny else 0.0
    shift = float(mean_t - scale * mean_d)
    return DepthScore(float(np.sqrt(w @ (t - scale * d - shift) ** 2)), scale, shift, len(d))


def rmse_to_map(
    depth: np.ndarray, folder: Path, camera: str, frame: int, mask: np.ndarray | None = None
) -> DepthScore | None:
    """`rmse_depth` against the map of a camera's frame in a folder. Raises: as both, naming the file."""
    truth = read_depth(folder, camera, frame)
    try:
        return rmse_depth(depth, truth, mask)
    except GofError as e:
        raise type(e)(f"{folder}: camera '{camera}', frame {frame}: {e}") from e


def read_depth(folder: Path, camera: str, frame: int) -> np.ndarray:
    """`folder/camera/000000.npy`, (H, W): a predicted or true depth map.

    Raises:
        DataFormatError: absent, pickled, or not two-dimensional.
    """
    path = path_in(folder, f"{camera}/{frame:06d}.npy")
    try:
        value = read_npy(path)
    except DataFormatError as e:
        raise DataFormatError(f"{e}; expected CAMERA/FRAME.npy with a plain (H, W) array") from e
    if value.ndim != 2:
        raise DataFormatError(f"{path}: has shape {value.shape}, expected (H, W)")
    return value
