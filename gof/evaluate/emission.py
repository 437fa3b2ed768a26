"""The true light of a fire, and the gradients of a result's velocities where it shines.

Places are drawn from the true emission, the same for every method, and a result answers with the mean velocity of the
Gaussians that are drawn there (`gof.evaluate.visible`).

A gradient, the truth's too, is the central difference over one cell of the true grid to each side; where no Gaussian
is on one of the six sides, a result says nothing of how the flow changes, and its gradient counts as zero.

    vorticity   sqrt( sum |w - W|^2 / sum |W|^2 )            w, W: curl of the result's and of the true velocity
    divergence  sqrt( sum (d - D)^2 / sum |grad V|^2 )       d, D: divergence; over the size of the true gradient, as a
                                                             true divergence is next to nothing outside the flame
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gof.core.datum import Datum
from gof.core.errors import DataFormatError
from gof.core.fields import CHUNK, SAME_TIME_S, GridSequence, VelocitySequence, open_array
from gof.core.gaussians import MovingGaussians
from gof.evaluate.intervals import own_generator
from gof.evaluate.sparse_grid import StoredFields, fields_of
from gof.evaluate.visible import opacity_per_metre

GRADIENTS = 128  # places per frame, six velocities each
KEPT_BYTES = 1 << 26  # of light that was read: every score of a clip goes through its frames
EXPONENT = 1.3  # light over flame reaction in grids of before they said it themselves (`light_exponent`)


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
        self._kept: dict[int, tuple[np.ndarray, np.ndarray]] = {}  # of frames, as `light` gives it

    def light(self, frame: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the cells (K, 3) of a stored frame that burn, and their light (K,), > 0; neither may be changed.

        Raises:
            DataFormatError: the frame holds NaN or negative values.
        """
        if frame not in self._kept:
            found = self._read(frame)
            if sum(array.nbytes for pair in (found, *self._kept.values()) for array in pair) > KEPT_BYTES:
                return found
            self._kept[frame] = found
        return self._kept[frame]

    def _read(self, frame: int) -> tuple[np.ndarray, np.ndarray]:
        cells, shine = [], []
        for x in range(0, self.resolution[0], CHUNK):  # a layer of chunks at a time, and of it what burns
            flame = self.cells(frame, slice(x, x + CHUNK)).astype(np.float32)
            if (flame < 0).any():
                raise DataFormatError(f"{self.path}: frame {frame} holds negative values; make it again")
            burning = np.argwhere(flame)
            cells.append(burning + np.array([x, 0, 0]))
            shine.append(flame[tuple(burning.T)].astype(np.float64) ** self.light_exponent)
        return np.concatenate(cells), np.concatenate(shine)

    def frame_at(self, time_s: float) -> int:
        """Return the stored frame of a time. Raises DataFormatError: there is none."""
        frame = int(np.abs(self.times_s - time_s).argmin())
        if abs(self.times_s[frame] - time_s) > SAME_TIME_S:
            raise DataFormatError(
                f"{self.path}: no frame at {time_s:g} s; the grid and the velocity store must have the same times"
            )
        return frame

    def places(self, time_s: float, count: int, rng: np.random.Generator) -> np.ndarray:
        """Return (count, 3) world m, drawn evenly from the emission of the stored frame at `time_s`; (0, 3) without
        flame.

        Raises:
            DataFormatError: no frame is stored for that time, or it holds NaN or negative values.
        """
        cells, light = self.light(self.frame_at(time_s))
        total = np.cumsum(light)
        if len(total) == 0:
            return np.zeros((0, 3))
        level = (np.arange(count) + rng.random(count)) / count * total[-1]
        cell = cells[np.minimum(np.searchsorted(total, level, side="right"), len(total) - 1)]
        return (cell + rng.random((count, 3))) @ self.index_to_world[:3, :3].T + self.index_to_world[:3, 3]

    def light_at(self, time_s: float, points: np.ndarray) -> tuple[np.ndarray, float]:
        """Return the light (M,) of the cells around world points (M, 3) in the grid, and that of all cells together.

        Raises:
            DataFormatError: as `places`.
        """
        cells, light = self.light(self.frame_at(time_s))
        world_to_index = np.linalg.inv(self.index_to_world)
        asked = np.floor(points @ world_to_index[:3, :3].T + world_to_index[:3, 3]).astype(np.int64)
        asked = np.ravel_multi_index(tuple(np.clip(asked, 0, np.array(self.resolution) - 1).T), self.resolution)
        burning = np.ravel_multi_index(tuple(cells.T), self.resolution)  # rising, as argwhere gives them
        at = np.minimum(np.searchsorted(burning, asked), max(len(burning) - 1, 0))
        if len(burning) == 0:
            return np.zeros(len(points)), 0.0
        return np.where(burning[at] == asked, light[at], 0.0), float(light.sum())


def flame_grid(folder: Path, datum: Datum) -> FlameGrid | None:
    """Open the true flame of a dataset's folder, measured from its datum; None where it has no such grid.

    Raises:
        DataFormatError: as `FlameGrid`.
    """
    path = folder / "grids" / "flame.zarr"
    return FlameGrid(path).measured_from(datum) if path.exists() else None


# ---------------------------------------------------------------- gradients


def score_gradients(
    gaussians: MovingGaussians,
    truth: VelocitySequence | StoredFields,
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
    rng, fields = own_generator("places of gradients", seed), fields_of(truth)
    sums, uncovered, count = np.zeros(5), 0, 0
    for k, time_s in enumerate(map(float, times_s)):
        places = flame.places(time_s, GRADIENTS, rng)
        if len(places):
            field = fields.at(time_s)
            sides = six_sides(places, field.voxel_size)
            state = gaussians.state_at(time_s)
            seen = opacity_per_metre(sides, state, time_s)
            velocity = seen.mean_velocity(state.moving_gas)
            known = (seen.total() > 0).reshape(6, -1).all(0)
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
