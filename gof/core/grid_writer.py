"""Writer of grids over time that goes on where it was cut off: stores as `gof.core.fields` reads them.

The array grows in `<path>.partial`. A frame is finished when its marker exists, so a killed export goes on with the
next frame; `finish` writes the final attributes and renames the folder, so `<path>` itself is always complete.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Iterator
from itertools import product
from pathlib import Path

import numpy as np

from .errors import DataFormatError, GofError
from .fields import AXES, CHUNK, GRID, SCHEMA, VERSION
from .files import read_json, write_bytes, write_json
from .zarr_array import EVERY_FRAME, ZarrArray, describe

Block = tuple[slice, slice, slice]

VELOCITY = {"schema": SCHEMA, "version": VERSION, "units": "m/s", "frame": "world", "layout": "cell_centred"}
"""Attributes that say what a velocity store holds."""


def scalar(quantity: str, units: str = "1") -> dict:
    """Attributes that say what a scalar store holds."""
    return {"schema": GRID, "version": VERSION, "quantity": quantity, "units": units, "layout": "cell_centred"}


class GridWriter:
    """Resumable writer of one array of velocity, or of a scalar.

    Args:
        path: the finished folder, by custom `velocity.zarr`.
        grid: (X, Y, Z) cells.
        index_to_world: (4, 4) continuous cell index to world metres; cell i spans [i, i + 1].
        time_s: (T,) seconds on the dataset clock, strictly increasing.
        voxel_size: edge of a cell, m.
        dtype: "float16" or "float32".
        content: attributes of what is stored, VELOCITY or scalar(...).

    Raises:
        DataFormatError: the path, or an interrupted export beside it, holds something else than this very array.
        ValueError: bad dtype, grid, times, or a non-finite transform.
    """

    def __init__(
        self,
        path: str | Path,
        grid: tuple[int, int, int],
        index_to_world: np.ndarray,
        time_s: np.ndarray,
        voxel_size: float,
        dtype: str = "float16",
        content: dict = VELOCITY,
    ):
        self.path = Path(path)
        self.grid = tuple(int(n) for n in grid)
        self.dtype = np.dtype(dtype).newbyteorder("<")
        self._components = (3,) if content is VELOCITY else ()
        self._require_arguments(index_to_world, time_s, voxel_size)
        attributes = content | {
            "index_to_world": np.asarray(index_to_world, float).tolist(),
            "voxel_size": float(voxel_size),
            "time_s": np.asarray(time_s, float).tolist(),
        }
        shape, chunks = (len(time_s), *self.grid, *self._components), (1, CHUNK, CHUNK, CHUNK, *self._components)
        self._description = describe(shape, chunks, self.dtype.name, attributes, axes=AXES[: len(shape)])
        self._partial = self.path.with_name(self.path.name + ".partial")
        self._markers = self._partial / "finished_frames"
        self.finished = self._same_array(self.path)
        if not self.finished and not self._same_array(self._partial):
            self._markers.mkdir(parents=True, exist_ok=True)
            write_json(self._partial / "zarr.json", self._description)

    def has_frame(self, frame: int) -> bool:
        """Return whether frame index `frame` of the T is already on disk."""
        return self.finished or self._marker(frame).exists()

    def write_frame(self, frame: int, block: Callable[[Block], np.ndarray]) -> None:
        """Write one frame, chunk by chunk; does nothing if the frame is finished.

        Args:
            frame: index in [0, T).
            block: called with three slices (x, y, z), returns (a, b, c, 3) velocities in m/s, world axes, or
                (a, b, c) scalars; for an array v in memory that is `v.__getitem__`.

        Raises:
            ValueError: a velocity is not finite or does not fit the dtype; the frame is left unfinished.
        """
        if self.has_frame(frame):
            return
        array, largest_error, empty = ZarrArray.open(self._partial), 0.0, True
        for index, where in self._chunks():
            exact = np.asarray(block(where))
            stored = self._encode(exact, frame)
            if exact.size:
                largest_error = max(largest_error, float(np.abs(stored.astype(np.float64) - exact).max()))
            number = (frame, *index, *(0 for _ in self._components))
            if stored.any():
                empty = False
                filled = (slice(0, 1), *(slice(0, n) for n in stored.shape[:3]))
                write_bytes(array.file_of(number), array.packed(filled, stored[None]))
            else:
                array.file_of(number).unlink(missing_ok=True)  # of a run that ended within the frame
        if empty:
            array.mark(frame)
        write_json(self._marker(frame), {"max_abs_error": largest_error})

    def finish(self) -> dict:
        """Complete the attributes and move the array to its final name. Returns the attributes.

        Raises:
            ValueError: frames are missing.
        """
        if not self.finished:
            frames = range(self._description["shape"][0])
            missing = [f for f in frames if not self.has_frame(f)]
            if missing:
                raise ValueError(f"{self._partial}: frames {missing[:5]} are not written; write them before finish()")
            errors = [read_json(self._marker(f))["max_abs_error"] for f in frames]
            self._description["attributes"]["storage_max_abs_error"] = max(errors)
            if ZarrArray.open(self._partial).stored_frames().all():  # a version before may have begun it
                self._description["attributes"][EVERY_FRAME] = True
            write_json(self._partial / "zarr.json", self._description)
            # Rename first: a kill between the two lines leaves a complete array with a harmless extra folder.
            os.replace(self._partial, self.path)
            shutil.rmtree(self.path / "finished_frames")
            self.finished = True
        return _read_description(self.path)["attributes"]

    def _require_arguments(self, index_to_world: np.ndarray, time_s: np.ndarray, voxel_size: float) -> None:
        if self.dtype.name not in ("float16", "float32"):
            raise ValueError(f"dtype {self.dtype.name!r}: choose 'float16' or 'float32'")
        if len(self.grid) != 3 or min(self.grid) < 1:
            raise ValueError(f"grid {self.grid}: expected three positive cell counts")
        matrix = np.asarray(index_to_world, float)
        if matrix.shape != (4, 4) or not np.isfinite(matrix).all() or abs(np.linalg.det(matrix[:3, :3])) == 0:
            raise ValueError(f"index_to_world must be a finite, invertible (4, 4) matrix, got\n{matrix}")
        times = np.asarray(time_s, float)
        if times.ndim != 1 or not len(times) or not np.isfinite(times).all() or (np.diff(times) <= 0).any():
            raise ValueError("time_s must be a non-empty, strictly increasing list of seconds")
        if not (np.isfinite(voxel_size) and voxel_size > 0):
            raise ValueError(f"voxel_size {voxel_size}: must be > 0 m")

    def _same_array(self, folder: Path) -> bool:
        """Return True if `folder` holds this array, False if there is nothing; anything else is an error."""
        if not folder.exists():
            return False
        found = _read_description(folder)
        for part in (found, found.get("attributes", {})):
            for added in ("storage_max_abs_error", EVERY_FRAME):
                part.pop(added, None)
        wanted = json.loads(json.dumps(self._description))
        if found != wanted:
            keys = {**wanted, **wanted["attributes"]}
            other = {**found, **found.get("attributes", {})}
            differ = sorted(k for k in keys if k != "attributes" and keys[k] != other.get(k))
            raise DataFormatError(
                f"{folder}: holds another array (different: {', '.join(differ) or 'extra fields'}); "
                "delete or rename the folder, then export again"
            )
        return True

    def _chunks(self) -> Iterator[tuple[tuple[int, int, int], Block]]:
        x, y, z = ([slice(at, min(at + CHUNK, n)) for at in range(0, n, CHUNK)] for n in self.grid)
        for (i, a), (j, b), (k, c) in product(enumerate(x), enumerate(y), enumerate(z)):
            yield (i, j, k), (a, b, c)

    def _encode(self, exact: np.ndarray, frame: int) -> np.ndarray:
        if not np.isfinite(exact).all():
            raise ValueError(f"{self.path}: velocity of frame {frame} has NaN or Inf; the bake is broken, bake again")
        with np.errstate(over="ignore"):
            stored = exact.astype(self.dtype)
        if not np.isfinite(stored).all():
            raise ValueError(
                f"{self.path}: velocity of frame {frame} reaches {np.abs(exact).max():.4g} m/s, "
                f"too large for {self.dtype.name}; export as float32"
            )
        return stored

    def _marker(self, frame: int) -> Path:
        return self._markers / f"{frame:06d}.json"


def _read_description(folder: Path) -> dict:
    file = folder / "zarr.json"
    if not file.is_file():
        raise DataFormatError(f"{folder}: no zarr.json inside, so not a velocity store; choose another path")
    try:
        description = read_json(file)
    except GofError as error:
        raise DataFormatError(f"{error}; delete {folder} and export again") from None
    if not isinstance(description, dict):
        raise DataFormatError(f"{file}: not a zarr v3 description; delete {folder} and export again")
    return description
