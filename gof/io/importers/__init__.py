"""Other methods' results, read as they are. One module per method, with `matches(source)` and `read(source, options)`."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from gof.errors import DataFormatError, GofError
from gof.gaussians import TransientGaussians
from gof.io.importers import authors, freetime, own, ply_sequence, unreadable, yang
from gof.io.importers.source import Imported, ImportOptions, Source
from gof.trajectory import Trajectory

# in the order in which they are asked; `unreadable` explains what is recognised and has no velocities
METHODS = {
    "gof": own,
    "authors": authors,
    "yang": yang,
    "freetime": freetime,
    "ply-sequence": ply_sequence,
    "unreadable": unreadable,
}

__all__ = ["METHODS", "ImportOptions", "Imported", "Source", "Trajectory", "detect", "read_result"]


def detect(source: Source) -> str:
    """Name in METHODS of the format.

    Raises:
        DataFormatError: none fits.
    """
    for name, module in METHODS.items():
        if module.matches(source):
            return name
    if source.is_checkpoint:
        value = source.checkpoint
        found = (
            f"a tuple of {len(value)}"
            + (f" with a tuple of {len(value[0])} first" if len(value) and isinstance(value[0], (tuple, list)) else "")
            if isinstance(value, (tuple, list))
            else f"a {type(value).__name__}"
            + (f" with {sorted(map(str, value))[:6]}" if isinstance(value, dict) else "")
        )
        raise DataFormatError(f"{source.path}: holds {found}, which is no layout gof knows (docs/importers.md)")
    raise DataFormatError(
        f"{source.path}: no format gof knows; it reads {', '.join(k for k in METHODS if k != 'unreadable')} (docs/importers.md)"
    )


def read_result(path: str | Path, options: ImportOptions | None = None) -> Imported:
    """Read a result of any known method, in metres, seconds and m/s on the dataset clock.

    Args:
        path: a file, or a folder: of numbered PLYs, or a training's output, whose newest checkpoint is taken.
        options: what the file does not say.
    Raises:
        DataFormatError: unknown, damaged, another version, or it has no velocities (says what to do).
        MissingDependencyError: torch is needed and absent.
    """
    path = Path(path)
    source = Source(_newest_checkpoint(path) if path.is_dir() else path)
    name = detect(source)
    try:
        return METHODS[name].read(source, options or ImportOptions())
    except GofError as e:
        raise e if str(source.path) in str(e) or "scale_bounds" in str(e) else type(e)(f"{source.path}: {e}") from e


def life(gaussians: TransientGaussians | Trajectory) -> tuple[float, float]:
    """First and last second in which anything dynamic lives (3 t_sigma around t_mu); infinite when always on."""
    if isinstance(gaussians, Trajectory):
        return float(gaussians.time_s[0]), float(gaussians.time_s[-1])
    g = gaussians[gaussians.dynamic]
    reach = 3 * g.t_sigma.astype(np.float64)
    return float((g.t_mu - reach).min()), float((g.t_mu + reach).max())


def _newest_checkpoint(folder: Path) -> Path:
    found = [
        (int(m[1]), p)
        for pattern in ("chkpnt*.pth", "ckpts/ckpt_*.pt", "ckpt_*.pt")
        for p in folder.glob(pattern)
        if (m := re.search(r"(\d+)\.pth?$", p.name))
    ]
    return max(found)[1] if found else folder
