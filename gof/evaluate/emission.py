"""The true light of a fire over time, and places drawn from it: the same for every method."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gof.core.datum import Datum
from gof.core.errors import DataFormatError
from gof.core.fields import CHUNK, SAME_TIME_S, GridSequence, open_array

KEPT_BYTES = 1 << 26  # of light that was read: every score of a clip goes through its frames
EXPONENT = 1.3  # light over flame reaction in grids of before they said it themselves (`light_exponent`)


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

    @property
    def dark_notes(self) -> list[str]:
        """Return a note on frames that are dark in this store, or were lost from it; none where all have chunks."""
        if not self.dark:
            return []
        return [
            f"flame.zarr has no chunk of {len(self.dark)} frames (the first is {self.dark[0]}): without any flame, or "
            "lost in a copy, which a store of an older version cannot tell"
        ]

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
