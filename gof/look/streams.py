"""Stream plots of velocity: Gaussians max-projected along the depth and cut at one X, and the truth at these places."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter

from gof.core.gaussians import TransientGaussians
from gof.evaluate.intervals import weighted_quantile
from gof.look.charts import FAINT, Chart, stream_chart

CELLS = 72  # along the longest side of the box
FLOATERS = 0.002  # share of the weight that may lie outside the box at each end of an axis
KINDS = {
    "projection": "front view",
    "truth_projection": "front view, truth",
    "slice": "X-slice",
    "truth_slice": "X-slice, truth",
}  # in the order in which a page shows them


class Volume(NamedTuple):
    density: np.ndarray  # (X, Y, Z) summed s_x s_y s_z alpha per cell, any unit
    velocity: np.ndarray  # (X, Y, Z, 3) m/s, weighted mean
    low: np.ndarray  # (3,) m
    cell: float  # m

    def centres(self) -> np.ndarray:
        index = np.stack(np.meshgrid(*(np.arange(n) + 0.5 for n in self.density.shape), indexing="ij"), -1)
        return self.low + index * self.cell


def volume(gaussians: TransientGaussians, time_s: float) -> Volume:
    """The dynamic Gaussians that live at a time, summed into cubic cells and blurred by one cell; at least one must."""
    position, opacity = gaussians.at(time_s)
    weight = gaussians.scale.astype(np.float64).prod(1) * opacity * gaussians.dynamic
    keep = weight > 1e-9 * max(weight.sum(), 1e-300)
    weight = weight[keep]
    position = position[keep].astype(np.float64)
    velocity = gaussians.moving_gas[keep].astype(np.float64)
    # of each axis the middle 99.6 % of the weight: a few floaters must not shrink the flame
    low, high = (np.array([weighted_quantile(x, weight, q) for x in position.T]) for q in (FLOATERS, 1 - FLOATERS))
    cell = float(max((high - low).max(), 1e-3) / (CELLS - 8))
    low = low - 4 * cell
    shape = np.maximum(np.ceil((high - low) / cell).astype(int) + 4, 9)
    index = np.floor((position - low) / cell).astype(int)
    inside = ((index >= 0) & (index < shape)).all(1)
    flat = np.ravel_multi_index(tuple(index[inside].T), shape)
    sums = [np.bincount(flat, weight[inside] * c, int(shape.prod())).reshape(shape) for c in (1.0, *velocity[inside].T)]
    density, *momentum = (gaussian_filter(s, 1.0, mode="constant") for s in sums)
    filled = density > 1e-6 * density.max()
    mean = [np.where(filled, m / np.where(filled, density, 1), 0) for m in momentum]
    return Volume(density, np.stack(mean, -1), low, cell)


def max_projection(density: np.ndarray, velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Seen along Y: density (X, Z) of the densest cell of each column, and its (v_x, v_z) (X, Z, 2)."""
    j = density.argmax(1)[:, None, :]
    picked = np.take_along_axis(velocity, j[..., None], 1)[:, 0]
    return np.take_along_axis(density, j, 1)[:, 0], picked[..., [0, 2]]


def x_slice(density: np.ndarray, velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """The plane of constant X through the centre of mass: density (Y, Z), (v_y, v_z) (Y, Z, 2), and its cell number."""
    i = round(float((density.sum((1, 2)) * np.arange(len(density))).sum() / density.sum()))
    return density[i], velocity[i][..., 1:], i


def cropped(density: np.ndarray, velocity: np.ndarray, margin: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """A plane's density (A, B) and velocity (A, B, 2) without the cells around it where nothing would be drawn."""
    seen = density > FAINT * density.max()
    box = tuple(slice(max(int(k.min()) - margin, 0), int(k.max()) + margin + 1) for k in np.nonzero(seen))
    return density[box], velocity[box]


def stream_charts(name: str, gaussians: TransientGaussians, time_s: float, truth=None) -> dict[str, Chart]:
    """Return charts by kind: "projection", "slice"; with a true field (anything with `sample`) also "truth_" of these.

    Args:
        name: of the result, for the charts' titles.
    """
    v = volume(gaussians, time_s)
    seen = {"": v.velocity}
    if truth is not None:
        seen["truth_"] = truth.sample(v.centres().reshape(-1, 3)).reshape(v.velocity.shape)
    cuts = {"projection": max_projection, "slice": lambda density, velocity: x_slice(density, velocity)[:2]}
    charts = {}
    for plane, cut in cuts.items():
        for whose, velocity in seen.items():
            kind = whose + plane
            charts[kind] = stream_chart(f"{KINDS[kind]} of {name}", *cropped(*cut(v.density, velocity)), v.cell)
    return charts
