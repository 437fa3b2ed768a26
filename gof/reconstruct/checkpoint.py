"""An optimiser's state on disk, so that an interrupted optimisation goes on where it was."""

from __future__ import annotations

import io
import sys
from pathlib import Path

import drjit as dr
import numpy as np
from drjit.opt import Adam

from gof.files import atomic_path


def save_checkpoint(path: Path, optimizer: Adam, step: int) -> None:
    """Write values, Adam moments and the number of steps done; a disk too full for it is reported, not raised."""
    arrays = {"step": np.array(step)}
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


def load_checkpoint(path: Path, optimizer: Adam) -> int:
    """Put a checkpoint's values and Adam moments into the optimiser; returns the number of steps done (0 = none)."""
    if not path.exists():
        return 0
    with np.load(path, allow_pickle=False) as data:
        for name in list(optimizer.keys()):
            optimizer[name] = type(dr.detach(optimizer[name]))(data[f"{name}.value"])
            value, promoted, rate, (t, m, v, extra) = optimizer.state[name]
            moments = type(t)(data[f"{name}.t"]), type(m)(data[f"{name}.m"]), type(v)(data[f"{name}.v"]), extra
            optimizer.state[name] = value, promoted, rate, moments
        return int(data["step"])
