"""An optimiser's state on disk, so that an interrupted optimisation goes on where it was."""

from __future__ import annotations

import io
import sys
from dataclasses import dataclass
from pathlib import Path

import drjit as dr
import numpy as np
from drjit.opt import Adam

from gof.core.errors import DataFormatError
from gof.core.files import atomic_path
from gof.core.npz import read_npz
from gof.reconstruct.parameters import PLATE

REMEDY = "remove it, and the optimisation begins anew"


@dataclass(frozen=True)
class Spent:
    """Seconds that a checkpoint has cost, in all runs: of the whole stage, and of its fitting alone, without scores."""

    stage_s: float = 0.0
    fitting_s: float = 0.0


def save_checkpoint(path: Path, optimizer: Adam, step: int, spent: Spent) -> None:
    """Write values, Adam moments, the number of steps done and their cost; a disk too full is reported, not raised."""
    arrays = {"step": np.array(step), "spent": np.array([spent.stage_s, spent.fitting_s])}
    for name in optimizer.keys():
        _, _, _, (t, m, v, _) = optimizer.state[name]
        arrays[f"{name}.value"] = np.array(dr.detach(optimizer[name]))
        arrays[f"{name}.m"] = np.array(m)
        arrays[f"{name}.v"] = np.array(v)
        arrays[f"{name}.t"] = np.array(t)
    packed = io.BytesIO()
    np.savez(packed, **arrays)
    try:
        with atomic_path(path) as temporary:
            temporary.write_bytes(packed.getbuffer())
    except OSError as e:
        print(
            f"{path}: no checkpoint at step {step} ({e.strerror or e}); the optimisation goes on, but an interruption "
            "would cost all steps since the last one",
            file=sys.stderr,
        )


def load_checkpoint(path: Path, optimizer: Adam, resized: bool = False) -> int:
    """Put a checkpoint's values and Adam moments into the optimiser; returns the number of steps done (0 = none).

    Args:
        resized: the number of Gaussians may be another than the optimiser's (density control); plates' sizes may not.
    Raises:
        DataFormatError: it is damaged, or of another optimisation.
    """
    if not path.exists():
        return 0
    data = _read(path)
    try:
        count = data["t_mu.value"].shape[-1] if resized else None
        for name in list(optimizer.keys()):
            _, _, rate, _ = optimizer.state[name]
            old = dr.detach(optimizer[name])
            many = count if resized and not name.startswith(PLATE) else old.shape[-1]
            optimizer[name] = _like(old, data[f"{name}.value"], many)
            value, promoted, _, (t, m, v, extra) = optimizer.state[name]
            moments = _like(t, data[f"{name}.t"]), _like(m, data[f"{name}.m"]), _like(v, data[f"{name}.v"]), extra
            optimizer.state[name] = value, promoted, rate, moments
        return int(data["step"])
    except (KeyError, ValueError, TypeError) as e:
        raise DataFormatError(f"{path}: not a checkpoint of this optimisation ({e}); {REMEDY}") from e


def read_spent(path: Path) -> Spent | None:
    """Return the cost of a checkpoint; None without a checkpoint. Raises DataFormatError: it is damaged."""
    if not path.exists():
        return None
    try:
        spent = Spent(*map(float, _read(path)["spent"]))
    except (KeyError, TypeError, ValueError) as e:
        raise DataFormatError(f"{path}: not a checkpoint of this version ({e}); {REMEDY}") from e
    if not (0 <= spent.stage_s < np.inf and 0 <= spent.fitting_s < np.inf):
        raise DataFormatError(f"{path}: says that its steps took {spent.stage_s} and {spent.fitting_s} s; {REMEDY}")
    return spent


def _read(path: Path) -> dict[str, np.ndarray]:
    try:
        return read_npz(path)
    except DataFormatError as e:
        raise DataFormatError(f"{e}; {REMEDY}") from e


def _like(old, values: np.ndarray, count: int | None = None):
    """Values of a file in an array of the type and shape of another, but for `count` of them."""
    shape = np.shape(old) if count is None else (*np.shape(old)[:-1], count)
    if values.shape != shape or not np.isfinite(values).all():
        raise ValueError(f"shape {values.shape} or values are not those of {shape} finite numbers")
    return type(old)(values)
