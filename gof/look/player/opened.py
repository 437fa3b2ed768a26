"""Results as a user may name them: a file of any known method, a reconstruction's folder, or the folder of a demo."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np

from gof.core.errors import DataFormatError, GofError
from gof.core.gaussians import VISIBLE, MovingGaussians, TransientGaussians
from gof.dataset import Dataset
from gof.io.importers import ImportOptions, read_result

G = TypeVar("G", bound=MovingGaussians)


@dataclass(frozen=True)
class Opened(Generic[G]):
    """One result to show: what people call it, the importer that read it, and the file it was read from."""

    name: str
    method: str
    path: Path
    gaussians: G
    flame_only: bool = False


def measured_alike(results: list[Opened[G]], dataset: Dataset | None) -> list[Opened[G]]:
    """Return all, measured from the dataset's datum; without one, from the first result's."""
    first = results[0].gaussians
    own = first.datum if isinstance(first, TransientGaussians) else None  # positions over time have none
    datum = own if dataset is None else dataset.datum
    if datum is None:
        return results
    return [replace(result, gaussians=result.gaussians.measured_from(datum)) for result in results]


def newest(path: Path) -> Path:
    """Return the file to show: a folder's finished result, else its snapshot; of a demo's folder, the reconstruction in
    it.

    Raises:
        GofError: a folder of ours with neither yet.
    """
    if not (path / "settings.json").is_file() and (path / "reconstruct" / "settings.json").is_file():
        path = path / "reconstruct"
    if not (path / "settings.json").is_file():
        return path
    for name in ("result.npz", "snapshot.npz"):
        if (path / name).is_file():
            return path / name
    raise GofError(
        f"{path}: the reconstruction there has no result and no snapshot yet; the first comes after 250 steps"
    )


def require_result(path: Path) -> Path:
    """Return the file of a result that is there, as `newest`.

    Raises:
        GofError: there is nothing by that name, or a folder without a result of ours.
    """
    file = newest(path)
    if file.is_file():
        return file
    what = "holds no result of 'gof reconstruct'" if file.is_dir() else "no such file or folder"
    raise GofError(f"{path}: {what}; name a folder of 'gof reconstruct', or the result in it")


def open_result(
    path: Path, options: ImportOptions | None = None, name: str | None = None
) -> Opened[TransientGaussians]:
    """Read a result whose motion is a closed form.

    Args:
        name: what people shall read; default: that of the folder, or of the file.
    Raises:
        DataFormatError: unknown or damaged, sampled in time, or empty.
    """
    result = open_moving(path, options, name)
    gaussians = result.gaussians
    if not isinstance(gaussians, TransientGaussians):
        raise DataFormatError(
            f"{path}: positions sampled in time; a page moves Gaussians by x0 + (t - t_mu) v. `gof view` and "
            "`gof video` show such a result"
        )
    return Opened(result.name, result.method, result.path, gaussians, result.flame_only)


def open_moving(path: Path, options: ImportOptions | None = None, name: str | None = None) -> Opened[MovingGaussians]:
    """Read a result of any method, also one that is sampled in time; see `open_result`."""
    imported = read_result(newest(path), options)
    if not len(imported.gaussians):
        raise DataFormatError(f"{path}: holds no Gaussian")
    plain = path.resolve().name if path.is_dir() else path.name.split(".")[0]
    if plain == "result" and not path.is_dir():
        plain = path.resolve().parent.name
    return Opened(name or plain, imported.method, imported.path, imported.gaussians, imported.flame_only)


def dataset_beside(path: Path) -> Path | None:
    """Return the dataset that a demo or a report keeps beside its result; None where there is none."""
    folders = [path, path.parent] if path.is_dir() else [path.parent, path.parent.parent]
    return next((f / "dataset" for f in folders if (f / "dataset" / "dataset.json").is_file()), None)


def time_span(result: MovingGaussians, dataset: Dataset | None) -> tuple[float, float]:
    """Return first and last second worth showing: the dataset's frames, else the middle times of the moving
    Gaussians."""
    if dataset is not None:
        return float(dataset.times_s[0]), float(dataset.times_s[-1])
    if not isinstance(result, TransientGaussians):
        return result.covered_s
    times = result.t_mu[result.dynamic]
    return (float(times.min()), float(times.max())) if len(times) else (0.0, 0.0)


def middle_of(gaussians: TransientGaussians, time_s: float) -> tuple[np.ndarray, float]:
    """Return where the flame is at a time: the middle (3,) m of 96 % of it along each axis, and half its longest side,
    m."""
    position, opacity = gaussians.at(time_s)
    seen = (opacity >= VISIBLE) & (gaussians.dynamic | ~gaussians.dynamic.any())
    if not seen.any():
        seen = np.ones(len(gaussians), bool)
    low, high = np.percentile(position[seen].astype(np.float64), [2, 98], axis=0)
    return (low + high) / 2, max(float((high - low).max()) / 2, 1e-3)
