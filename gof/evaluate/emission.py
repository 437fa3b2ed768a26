"""Velocities and their gradients scored where the flame shines, not where the Gaussians sit. Ours beside the paper's.

DVE weights a velocity by its Gaussian's size and opacity, so a result is scored at places, and with weights, of its own
choice. Here the places are drawn from the true emission, the same for every method, and a result answers with the mean
velocity of the Gaussians that cover a place,

    v(x) = sum alpha_i(t) g_i(x) v_i / sum alpha_i(t) g_i(x),   g_i(x) = exp(-d_i(x)^2 / 2),

with d_i the Mahalanobis distance.

Its gradient, and the truth's, is the central difference over one cell of the true grid to each side; where no Gaussian
is on one of the six sides, a result says nothing of how the flow changes, and its gradient counts as zero.

    vorticity   sqrt( sum |w - W|^2 / sum |W|^2 )            w, W: curl of the result's and of the true velocity
    divergence  sqrt( sum (d - D)^2 / sum |grad V|^2 )       d, D: divergence; over the size of the true gradient, as a
                                                             true divergence is next to nothing outside the flame
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from gof.core.datum import Datum
from gof.core.errors import DataFormatError
from gof.core.fields import CHUNK, SAME_TIME_S, GridSequence, VelocitySequence, open_array
from gof.core.gaussians import MovingGaussians
from gof.core.rotations import rotation_matrices
from gof.evaluate.draws import own_generator
from gof.evaluate.dve_frame import DVEResult, Sums, agreement_sums
from gof.evaluate.sparse_grid import StoredField

POINTS = 1024  # places per frame; the pooled L2 of 36 frames scatters by less than 1 % (tested against closed forms)
GRADIENTS = 256  # places per frame, six velocities each
EXPONENT = 1.3  # light over flame reaction in grids of before they said it themselves (`light_exponent`)
REACH = 3.0  # standard deviations a Gaussian answers for
COVERED = 1e-3  # sum of alpha g below which no Gaussian is there, and the answer is zero velocity
FAINT = 1e-6  # opacity below which a Gaussian answers for nothing
BATCH = 2000  # Gaussians at a time: bounds memory at about 0.3 GB when all are large


@dataclass(frozen=True)
class EmissionScore:
    """Pooled over all frames; a place counts as much as another."""

    score: DVEResult
    constant: DVEResult  # trivial: the mean true velocity of these places, everywhere
    uncovered: float  # share of the places without a Gaussian, 0..1


@dataclass(frozen=True)
class GradientErrors:
    """Pooled over all frames; None where the true gradient is zero, or nothing shines.

    Attributes:
        still_divergence_l2: the divergence error of a flow that stands still (its vorticity error is 1).
        uncovered: share of the places without a Gaussian on one of their sides, 0..1.
    """

    vorticity_l2: float | None
    divergence_l2: float | None
    still_divergence_l2: float | None
    uncovered: float


class FlameGrid(GridSequence):
    """The flame over time, `grids/flame.zarr` of a dataset (schema gof-grid version 1).

    Its light is the value to the power of the attribute `light_exponent`; without one the value is a reaction.

    Raises:
        DataFormatError: absent, not a flame grid, or attributes are missing.
    """

    def __init__(self, path: Path):
        super().__init__(open_array(path), "flame", ())
        try:
            self.light_exponent = float(self.attributes.get("light_exponent", EXPONENT))
        except (TypeError, ValueError) as e:
            raise DataFormatError(f"{path}: light_exponent of zarr.json is no number ({e})") from e
        if not 0 < self.light_exponent < 10:
            raise DataFormatError(f"{path}: light_exponent {self.light_exponent:g} of zarr.json must lie in (0, 10)")

    def places(self, time_s: float, count: int, rng: np.random.Generator) -> np.ndarray:
        """Return (count, 3) world m, drawn evenly from the emission of the stored frame at `time_s`; (0, 3) without
        flame.

        Raises:
            DataFormatError: no frame is stored for that time, or it holds NaN or negative values.
        """
        frame = int(np.abs(self.times_s - time_s).argmin())
        if abs(self.times_s[frame] - time_s) > SAME_TIME_S:
            raise DataFormatError(
                f"{self.path}: no frame at {time_s:g} s; the grid and the velocity store must have the same times"
            )
        cells, shine = [], []
        for x in range(0, self.resolution[0], CHUNK):  # a layer of chunks at a time, and of it what burns
            flame = self.cells(frame, slice(x, x + CHUNK)).astype(np.float32)
            if (flame < 0).any():
                raise DataFormatError(f"{self.path}: frame {frame} holds negative values; make it again")
            burning = np.argwhere(flame)
            cells.append(burning + np.array([x, 0, 0]))
            shine.append(flame[tuple(burning.T)].astype(np.float64) ** self.light_exponent)
        total = np.cumsum(np.concatenate(shine))
        if len(total) == 0:
            return np.zeros((0, 3))
        level = (np.arange(count) + rng.random(count)) / count * total[-1]
        cell = np.concatenate(cells)[np.minimum(np.searchsorted(total, level, side="right"), len(total) - 1)]
        return (cell + rng.random((count, 3))) @ self.index_to_world[:3, :3].T + self.index_to_world[:3, 3]


def flame_grid(folder: Path, datum: Datum) -> FlameGrid | None:
    """Open the true flame of a dataset's folder, measured from its datum; None where it has no such grid.

    Raises:
        DataFormatError: as `FlameGrid`.
    """
    path = folder / "grids" / "flame.zarr"
    return FlameGrid(path).measured_from(datum) if path.exists() else None


def velocity_at(points: np.ndarray, gaussians: MovingGaussians, time_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Return mean velocity (M, 3) m/s of the dynamic Gaussians at world points (M, 3), and their cover sum alpha g
    (M,).

    Gaussians count up to REACH standard deviations of their largest axis; zero where the cover is below COVERED.
    """
    from scipy.spatial import cKDTree

    state = gaussians.state_at(time_s)
    position, alpha = state.at(time_s)
    gas = state.moving_gas
    alive = np.flatnonzero(state.dynamic & (alpha > FAINT))
    cover, momentum = np.zeros(len(points)), np.zeros((len(points), 3))
    tree = cKDTree(points)
    for start in range(0, len(alive), BATCH):
        rows = alive[start : start + BATCH]
        near = tree.query_ball_point(position[rows], REACH * state.scale[rows].max(1))
        owner = np.repeat(np.arange(len(rows)), [len(n) for n in near])
        if len(owner) == 0:
            continue
        place = np.concatenate(near).astype(np.int64)
        whiten = rotation_matrices(state.rotation[rows]) / state.scale[rows, None, :]  # columns: own axes over std-dev
        distance2 = np.einsum("pi,pik->pk", points[place] - position[rows][owner], whiten[owner])
        weight = alpha[rows][owner] * np.exp(-0.5 * np.einsum("pk,pk->p", distance2, distance2))
        cover += np.bincount(place, weight, len(points))
        for k in range(3):
            momentum[:, k] += np.bincount(place, weight * gas[rows, k].astype(np.float64)[owner], len(points))
    return np.where((cover >= COVERED)[:, None], momentum / np.maximum(cover, COVERED)[:, None], 0.0), cover


def score_flame(
    gaussians: MovingGaussians,
    truth: VelocitySequence,
    flame: FlameGrid,
    times_s: np.ndarray,
    progress: Callable[..., None],
) -> tuple[EmissionScore, GradientErrors]:
    """Score velocities and gradients where the flame shines; progress(done, total, stage=name).

    Raises:
        DataFormatError: see `FlameGrid.places`.
    """
    return (
        score_on_emission(gaussians, truth, flame, times_s, progress=partial(progress, stage="on emission")),
        score_gradients(gaussians, truth, flame, times_s, progress=partial(progress, stage="gradients")),
    )


def score_on_emission(
    gaussians: MovingGaussians,
    truth: VelocitySequence,
    flame: FlameGrid,
    times_s: np.ndarray,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> EmissionScore:
    """L2 and CosSim of DVE's formulas at POINTS places per frame, drawn from the true emission.

    The seed makes them the same for all results.

    Raises:
        DataFormatError: see `FlameGrid.places`.
    """
    rng = own_generator("places in the emission", seed)
    velocities, truths, uncovered = [], [], 0
    for k, time_s in enumerate(times_s):
        points = flame.places(float(time_s), POINTS, rng)
        if len(points):
            velocity, cover = velocity_at(points, gaussians, float(time_s))
            velocities.append(velocity)
            truths.append(StoredField(truth, float(time_s)).sample(points).astype(np.float64))
            uncovered += int((cover < COVERED).sum())
        if progress:
            progress(k + 1, len(times_s))
    count = sum(len(t) for t in truths)
    mean = np.concatenate([np.zeros((0, 3)), *truths]).sum(0) / max(count, 1)
    constants = [np.broadcast_to(mean, t.shape) for t in truths]
    return EmissionScore(
        score=_pooled(velocities, truths),
        constant=_pooled(constants, truths),
        uncovered=uncovered / max(count, 1),
    )


def _pooled(velocities: list[np.ndarray], truths: list[np.ndarray]) -> DVEResult:
    """DVE of velocities (M, 3) against truths (M, 3) per frame; every place weighs 1."""
    sums = [agreement_sums(np.ones(len(t)), v, t) for v, t in zip(velocities, truths, strict=True)]
    return DVEResult.from_sums(sum(sums, Sums()))


# ---------------------------------------------------------------- gradients


def score_gradients(
    gaussians: MovingGaussians,
    truth: VelocitySequence,
    flame: FlameGrid,
    times_s: np.ndarray,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> GradientErrors:
    """Return errors at GRADIENTS places per frame, drawn from the true emission; the seed makes them the same for all
    results.

    Raises:
        DataFormatError: see `FlameGrid.places`.
    """
    rng = own_generator("places of gradients", seed)
    sums, uncovered, count = np.zeros(5), 0, 0
    for k, time_s in enumerate(map(float, times_s)):
        places = flame.places(time_s, GRADIENTS, rng)
        if len(places):
            field = StoredField(truth, time_s)
            sides = six_sides(places, field.voxel_size)
            velocity, cover = velocity_at(sides, gaussians, time_s)
            known = (cover >= COVERED).reshape(6, -1).all(0)
            found = gradient(velocity, field.voxel_size) * known[:, None, None]
            true = gradient(field.sample(sides).astype(np.float64), field.voxel_size)
            sums += _squares(found, true)
            uncovered += int((~known).sum())
            count += len(places)
        if progress:
            progress(k + 1, len(times_s))
    rotation, true_rotation, expansion, true_expansion, size = sums
    return GradientErrors(
        vorticity_l2=float(np.sqrt(rotation / true_rotation)) if true_rotation > 0 else None,
        divergence_l2=float(np.sqrt(expansion / size)) if size > 0 else None,
        still_divergence_l2=float(np.sqrt(true_expansion / size)) if size > 0 else None,
        uncovered=uncovered / max(count, 1),
    )


def six_sides(places: np.ndarray, step: float) -> np.ndarray:
    """Return (6 M, 3): the places (M, 3) moved by a step along +x, +y, +z, -x, -y, -z."""
    moves = step * np.concatenate([np.eye(3), -np.eye(3)])
    return (moves[:, None] + places).reshape(-1, 3)


def gradient(values: np.ndarray, step: float) -> np.ndarray:
    """Return (M, 3, 3) of a vector's values (6 M, 3) at `six_sides`: [:, j, k] is the change of component k along axis
    j."""
    ahead, behind = values.reshape(2, 3, -1, 3)
    return np.moveaxis((ahead - behind) / (2 * step), 0, 1)


def curl(gradients: np.ndarray) -> np.ndarray:
    """Return (M, 3) 1/s of velocity gradients (M, 3, 3) with [:, j, k] = d v_k / d x_j."""
    spin = gradients - gradients.transpose(0, 2, 1)
    return np.stack([spin[:, 1, 2], spin[:, 2, 0], spin[:, 0, 1]], -1)


def _squares(found: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Return (5,) sums of squares: error and size of the vorticity, error and size of the divergence, size of the
    gradient."""
    rotation, expansion = curl(true), np.trace(true, axis1=1, axis2=2)
    parts = (
        curl(found) - rotation,
        rotation,
        np.trace(found, axis1=1, axis2=2) - expansion,
        expansion,
        true,
    )
    return np.array([np.square(part).sum() for part in parts])
