"""Samples of a dataset's true velocity (`velocity.zarr`) at points, with numpy only."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..description import DatasetDescription
from . import FileFormatError
from .files import path_in
from .grid_reader import StoredGrid
from .trilinear import trilinear


def of_dataset(dataset: Path, datum: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)) -> TrueVelocity:
    """The true velocity of a dataset folder, its places and times counted from a datum: x, y, z (m) and t (s).

    Raises: FileFormatError where there is none, or no dataset.
    """
    name = DatasetDescription.read(dataset).velocity
    if not name:
        raise FileFormatError(f"{dataset}: the dataset has no true velocity (a real capture?); choose a generated one")
    return TrueVelocity(path_in(dataset, name), datum)


@dataclass(frozen=True)
class Window:
    """Cells of one stored frame, in memory.

    Attributes:
        cells: (x, y, z, 3) float32 m/s.
        start: (3,) index of the first of them in the whole grid.
        grid: cells of the whole grid.
        world_to_index: (4, 4) world metres to continuous cell index, of the whole grid.
    """

    cells: np.ndarray
    start: np.ndarray
    grid: tuple[int, int, int]
    world_to_index: np.ndarray

    def coordinate(self, points: np.ndarray) -> np.ndarray:
        """World points (N, 3) to continuous cell index: the centre of cell i has i + 0.5."""
        return points @ self.world_to_index[:3, :3].T + self.world_to_index[:3, 3]

    def contains(self, coordinate: np.ndarray) -> np.ndarray:
        """Whether continuous cell indices (N, 3) lie in the whole grid, (N,)."""
        return ((coordinate >= 0) & (coordinate <= self.grid)).all(1)


class TrueVelocity:
    """Velocity in m/s on a grid over time; chunks are read when points ask for them.

    Attributes:
        time_s: (T,) seconds on the dataset clock, from the datum.

    Raises:
        FileFormatError: not a velocity store, or one compressed in another way.
    """

    def __init__(self, path: Path, datum: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)):
        """Places and times count from the datum, x, y, z (m) and t (s), as those of a result far from zero do."""
        self._stored = StoredGrid(path, "velocity", "m/s")
        self.time_s = self._stored.time_s - datum[3]
        self._to_index = self._stored.world_to_index.copy()
        self._to_index[:3, 3] += self._to_index[:3, :3] @ datum[:3]

    def sample(self, points: np.ndarray, time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Velocity (N, 3) float32 at world points (N, 3) and times (N,), and whether the points lie in the domain (N,).

        Linear in time between stored frames (the first or last one's outside of them), tri-linear between cell
        centres; in the outer half cell the nearest centre's; 0 outside the domain.
        """
        to_index = self._to_index
        index = np.asarray(points, float) @ to_index[:3, :3].T + to_index[:3, 3]
        inside = ((index >= 0) & (index <= self._stored.grid)).all(1)
        frame = np.interp(time_s, self.time_s, np.arange(len(self.time_s)))
        before = np.minimum(frame.astype(int), max(len(self.time_s) - 2, 0))
        later = frame - before  # 0 where a single frame is all there is
        out = np.zeros((len(index), 3), np.float32)
        for number in np.unique(np.concatenate([before[inside], before[inside & (later > 0)] + 1])):
            for rows, share in ((before == number, 1 - later), (before + 1 == number, later)):
                rows = np.flatnonzero(rows & inside & (share > 0))
                if len(rows):
                    out[rows] += share[rows, None] * self._sample(number, index[rows] - 0.5)
        return out, inside

    def window(self, number: int, low: np.ndarray, high: np.ndarray) -> Window:
        """The cells of a stored frame that points between two world corners (3,) are interpolated from.

        Raises:
            FileFormatError: a chunk is damaged.
        """
        to_index, grid = self._to_index, self._stored.grid
        corners = np.where(np.array(list(np.ndindex(2, 2, 2))), high, low) @ to_index[:3, :3].T + to_index[:3, 3]
        start = np.clip(np.floor(corners.min(0) - 0.5), 0, np.array(grid) - 1).astype(int)
        stop = np.clip(np.floor(corners.max(0) - 0.5) + 2, start + 1, grid).astype(int)
        return Window(self._stored.cells(number, start, stop), start, grid, to_index)

    def _sample(self, number: int, coordinate: np.ndarray) -> np.ndarray:
        """Values (N, 3) of a frame at coordinates counted from the first cell's centre; reads only the cells around."""
        size = np.array(self._stored.grid)
        coordinate = np.clip(coordinate, 0, size - 1)
        low = np.minimum(coordinate.astype(int), np.maximum(size - 2, 0))
        start, stop = low.min(0), np.minimum(low.max(0) + 2, size)
        return trilinear(self._stored.cells(number, start, stop), coordinate - start)
