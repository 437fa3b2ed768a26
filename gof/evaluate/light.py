"""Place of a result's light in space, against the true light: what pictures from one side leave open.

The light of a Gaussian is m_i of `gof.core.shining`, as the mean of its colours. Result and truth, each of light 1 a
frame, are compared in cells of about 1/32 of the flame.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gof.core.gaussians import MovingGaussians, TransientGaussians
from gof.core.rotations import rotation_matrices
from gof.core.shining import shining_at
from gof.evaluate.emission import FlameGrid
from gof.evaluate.quadrature import product_rule
from gof.evaluate.visible import opacity_per_metre
from gof.host.threads import map_on_cores

CELLS = 32  # along the flame's longest side
FRAMES = 8  # of a clip, evenly spread
DARK = 0.01  # of the brightest cell: what is darker has no flame in it
LEVEL = 0.1  # of a unit vector's length: a steeper view has no "along" that is level
NARROW = 0.6  # cells: std-dev up to which three nodes an axis are dense enough, and a cell's centre is not


@dataclass(frozen=True)
class LightResult:
    """Pooled over frames.

    Attributes:
        relative_l2: of light per cell; 0 is the truth, 1 is a result without light.
        correlation: cosine between the two, 0..1.
        outside: share of the result's light that is more than a cell away from all true flame, 0..1.
        smear: extent along the middle given camera's view over extent across it, over the same of the truth; 1 is the
            truth, above it the flame is drawn out along the rays. None where the result has no light.
    """

    relative_l2: float
    correlation: float
    outside: float
    smear: float | None


def score_light(
    gaussians: MovingGaussians,
    flame: FlameGrid,
    times_s: np.ndarray,
    forward: np.ndarray,
    progress: Callable[[int, int], None] | None = None,
) -> LightResult | None:
    """Score the light of a result's dynamic Gaussians in some frames; None where the truth is dark.

    Args:
        times_s: (T,) with a frame of `flame` each.
        forward: (3,) the middle given camera's optical axis, world; where it is upright, there is no smear.
    Raises:
        DataFormatError: see `FlameGrid.places`.
    """
    chosen = np.unique(np.linspace(0, len(times_s) - 1, min(FRAMES, len(times_s))).round().astype(int))

    def compare(time_s: float) -> _LightSums | None:
        return _compare(gaussians.state_at(time_s), flame, time_s, forward)

    found = map_on_cores(compare, np.asarray(times_s, np.float64)[chosen].tolist(), progress)
    frames = [frame for frame in found if frame is not None]
    if not frames:
        return None
    error, product, square, true_square, outside = (
        np.sum([getattr(f, name) for f in frames]) for name in ("error", "product", "square", "true_square", "outside")
    )
    variance, true_variance = (np.sum([getattr(f, name) for f in frames], 0) for name in ("variance", "true_variance"))
    smear = None
    if (variance > 0).all() and (true_variance > 0).all():
        smear = float(np.sqrt(variance[0] / variance[1] / (true_variance[0] / true_variance[1])))
    return LightResult(
        relative_l2=float(np.sqrt(error / true_square)),
        correlation=float(product / np.sqrt(square * true_square)) if square > 0 else 0.0,
        outside=float(outside / len(frames)),
        smear=smear,
    )


@dataclass(frozen=True)
class _Shining:
    """The dynamic Gaussians that are drawn at a time.

    Attributes:
        rows: (N,) of the state.   middle: (N, 3) world m.   axes: (N, 3, 3), columns: own axes, one std-dev long.
        brightness: (N,) colour times thickness.   light: (N,) >= 0, of each as a whole.
    """

    rows: np.ndarray
    middle: np.ndarray
    axes: np.ndarray
    brightness: np.ndarray
    light: np.ndarray

    @classmethod
    def of(cls, state: TransientGaussians, time_s: float) -> _Shining:
        found = shining_at(state, time_s)
        axes = rotation_matrices(state.rotation[found.rows]) * state.scale[found.rows].astype(np.float64)[:, None, :]
        return cls(found.rows, found.middle, axes, found.brightness.mean(1), found.light.mean(1))


def _light_of_cells(
    shining: _Shining, state: TransientGaussians, time_s: float, to_world: np.ndarray, shape: tuple[int, ...]
) -> np.ndarray:
    """Return the light in every cell of a grid; what shines outside is left out.

    Narrow Gaussians are split over the nodes of the Gauss-Hermite rule, of wide ones a cell has its centre's density.
    """
    wide = np.linalg.norm(shining.axes, axis=1).max(1) > NARROW * np.linalg.norm(to_world[:3, :3], axis=0).max()
    nodes, weights = product_rule(3)
    places = shining.middle[~wide, None] + np.einsum("nij,kj->nki", shining.axes[~wide], nodes)
    to_index = np.linalg.inv(to_world)
    index = np.floor(places.reshape(-1, 3) @ to_index[:3, :3].T + to_index[:3, 3]).astype(np.int64)
    inside = ((index >= 0) & (index < shape)).all(1)
    found = _binned(index[inside], (shining.light[~wide, None] * weights).ravel()[inside], shape)
    if wide.any():
        centres = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), -1).reshape(-1, 3) + 0.5
        centres = centres @ to_world[:3, :3].T + to_world[:3, 3]
        alpha = state.at(time_s)[1][shining.rows[wide]].astype(np.float64)
        volume = abs(np.linalg.det(to_world[:3, :3]))
        visible = opacity_per_metre(centres, state[shining.rows[wide]], time_s)
        found = found + visible.weighted(shining.brightness[wide] / alpha).reshape(shape) * volume
    return found


@dataclass(frozen=True)
class _LightSums:
    """Sums over the cells of a frame, and variances (2,) m2 of the light along and across the view."""

    error: float
    product: float
    square: float
    true_square: float
    outside: float
    variance: np.ndarray
    true_variance: np.ndarray


def _compare(state: TransientGaussians, flame: FlameGrid, time_s: float, forward: np.ndarray) -> _LightSums | None:
    """None where the truth is dark."""
    cells, true_light = flame.light(flame.frame_at(time_s))
    if not len(cells):
        return None
    side = max(round(np.ptp(cells, axis=0).max() / CELLS), 1)  # of a coarse cell, in the grid's
    shape = tuple(-(-np.array(flame.resolution) // side))
    true = _binned(cells // side, true_light, shape)
    true /= true.sum()
    to_world = flame.index_to_world @ np.diag([side, side, side, 1.0])
    shining = _Shining.of(state, time_s)
    ours = _light_of_cells(shining, state, time_s, to_world, shape)
    total = shining.light.sum()
    ours /= total if total > 0 else 1.0
    lit = np.pad(true > DARK * true.max(), 1)
    near = np.lib.stride_tricks.sliding_window_view(lit, (3, 3, 3)).any((3, 4, 5))
    true_places = (cells + 0.5) @ flame.index_to_world[:3, :3].T + flame.index_to_world[:3, 3]
    return _LightSums(
        error=((ours - true) ** 2).sum(),
        product=(ours * true).sum(),
        square=(ours**2).sum(),
        true_square=(true**2).sum(),
        outside=1 - ours[near].sum() if total > 0 else 0.0,
        variance=_variances(shining.middle, shining.light, forward, shining.axes),
        true_variance=_variances(true_places, true_light, forward),
    )


def _binned(cell: np.ndarray, light: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Return the light (M,) of cells (M, 3) summed into a grid of this shape."""
    return np.bincount(np.ravel_multi_index(tuple(cell.T), shape), light, int(np.prod(shape))).reshape(shape)


def _variances(
    places: np.ndarray, light: np.ndarray, forward: np.ndarray, axes: np.ndarray | None = None
) -> np.ndarray:
    """Return (2,) m2 of light (M,) at places (M, 3) along a level view and across it; zeros without light or view.

    Args:
        axes: (M, 3, 3) of Gaussians around these places, columns one std-dev long; None: points.
    """
    length = float(np.linalg.norm(forward[:2]))
    if light.sum() <= 0 or length < LEVEL:
        return np.zeros(2)
    along = np.array([forward[0], forward[1], 0.0]) / length
    found = []
    for direction in (along, np.array([along[1], -along[0], 0.0])):
        place = places @ direction
        own = 0.0 if axes is None else ((direction @ axes) ** 2).sum(-1)
        found.append(np.average((place - np.average(place, weights=light)) ** 2 + own, weights=light))
    return np.array(found)
