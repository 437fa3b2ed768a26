"""Other methods' results as they are: one module per method.

Each has `matches(source)`, `read(source, options)`, and OPTIONS, the fields of `ImportOptions` that a user may give it.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gof.core.datum import require_digits
from gof.core.errors import DataFormatError, GofError
from gof.core.gaussians import MovingGaussians, TransientGaussians
from gof.core.trajectory import Trajectory
from gof.io.importers import (
    dgs,
    fourdgs,
    freetime,
    gof_files,
    paper_code,
    ply_sequence,
    refused,
    spacetime,
    tsog,
    usd,
    yang,
)
from gof.io.importers.sidecar import in_words, with_sidecar
from gof.io.importers.source import FLAGS, Imported, ImportOptions, Source

# in the order in which they look at a file; `refused` explains what is recognised and has no velocities
METHODS = {
    "gof": gof_files,
    "authors": paper_code,
    "yang": yang,
    "freetime": freetime,
    "spacetime": spacetime,
    "ply-sequence": ply_sequence,
    "4dgs": fourdgs,
    "tsog": tsog,
    "dgs": dgs,
    "usd": usd,
    "unreadable": refused,
}

ROUNDED = 0.1  # of a life or a size, that the float32 of a result may round off
KNOWN = (
    "results and trajectories of gof (.npz, .ply), checkpoints and PLYs of the paper's code, checkpoints of 4DGS (Yang "
    "et al.), FreeTimeGS (.pt, canonical_4d.npz, .ftgs.ply), PLYs of SpacetimeGaussians, .4dgs, .tsog, .dgs, "
    "OpenUSD, and folders of 3DGS PLYs NAME00000.ply, NAME00001.ply, ..."
)

__all__ = ["METHODS", "ImportOptions", "Imported", "Source", "detect", "read_result", "require_kept"]


def detect(source: Source) -> str:
    """Name in METHODS of the format.

    Raises:
        DataFormatError: none fits.
    """
    for name, module in METHODS.items():
        if module.matches(source):
            return name
    if source.is_checkpoint:
        raise DataFormatError(
            f"{source.path}: holds {_summary(source.checkpoint)}, which is no layout gof knows (docs/importers.md)"
        )
    what = _ours_without_gaussians(source.path) or f"no format gof knows; it reads {KNOWN}"
    raise DataFormatError(f"{source.path}: {what}")


def _ours_without_gaussians(path: Path) -> str:
    """Return in words which folder of ours without Gaussians it is; empty: none."""
    if (path / "dataset.json").is_file():
        return "is a dataset, and no result; name the result of 'gof reconstruct' here, and the dataset after --dataset"
    if (path / "settings.json").is_file():
        return "has no result.npz; the reconstruction there has not finished: run the same 'gof reconstruct' again"
    return ""


def _summary(checkpoint: Any) -> str:
    """Return the content of an unknown checkpoint, in words."""
    if isinstance(checkpoint, dict):
        return f"a dict with {sorted(map(str, checkpoint))[:6]}"
    if not isinstance(checkpoint, (tuple, list)):
        return f"a {type(checkpoint).__name__}"
    if checkpoint and isinstance(checkpoint[0], (tuple, list)):
        return f"a tuple of {len(checkpoint)} with a tuple of {len(checkpoint[0])} first"
    return f"a tuple of {len(checkpoint)}"


def read_result(path: str | Path, options: ImportOptions | None = None) -> Imported:
    """Read a result of any known method, in metres, seconds and m/s on the dataset clock.

    Args:
        path: a file, or a folder: of `gof reconstruct`; of numbered PLYs; or a training's output, whose newest
            checkpoint is taken (the paper's code: without one, its newest PLY).
        options: what the file does not say; None: as RESULT.gof.json beside it says (`gof.io.importers.sidecar`).
    Raises:
        DataFormatError: unknown, damaged, another version, or it has no velocities (says what to do); or an option was
            given that says nothing about this format.
        MissingDependencyError: torch is needed and absent.
    """
    path = Path(path)
    source = Source(_newest_checkpoint(path) if path.is_dir() else path)
    options, sidecar = (options, None) if options else with_sidecar(path, ImportOptions())
    name = detect(source)
    try:
        _require_used(name, options)
        imported = replace(METHODS[name].read(source, options), flame_only=options.flame_only)
        if sidecar is not None:
            imported.notes.append(in_words(sidecar, options))
        if name == imported.method == "gof" and (method := gof_files.converted_from(source)) in METHODS:
            imported = replace(imported, method=method)
        if options.emissive:
            imported = replace(imported, gaussians=_as_light(imported.gaussians))
        require_kept(imported.gaussians)
        return imported
    except GofError as e:
        raise e if str(source.path) in str(e) or "scale_bounds" in str(e) else type(e)(f"{source.path}: {e}") from e


def _as_light(gaussians: MovingGaussians) -> MovingGaussians:
    assert isinstance(gaussians, (TransientGaussians, Trajectory)), "no importer gives others"
    return replace(gaussians, emissive=True)


def _require_used(name: str, options: ImportOptions) -> None:
    unused = [FLAGS[field] for field in options.given() if field not in METHODS[name].OPTIONS]
    if unused:
        raise DataFormatError(
            f"{' and '.join(unused)} would change nothing here: read as '{name}', which says so itself or has no such "
            "thing (docs/importers.md); leave it out"
        )


FAR = "Keep clock and world near zero, or name a datum (docs/formats.md); what was rounded off is lost"


def require_kept(gaussians: MovingGaussians, whose: str = "the result's", remedy: str = FAR) -> None:
    """Raise GofError: times or places so far from zero that float32 has rounded lives or sizes away."""
    if not isinstance(gaussians, TransientGaussians) or not gaussians.dynamic.any():
        return
    moving = gaussians[gaussians.dynamic]
    lives = moving.t_sigma[np.isfinite(moving.t_sigma)]
    if len(lives):
        require_digits(f"{whose} clock", moving.t_mu, float(np.median(lives)), remedy, most=ROUNDED)
    require_digits(f"{whose} world", moving.position, float(np.median(moving.scale)), remedy, most=ROUNDED)


def _newest_checkpoint(folder: Path) -> Path:
    own = folder / "result.npz"
    if own.is_file():
        return own
    found = [
        (int(m[1]), p)
        for pattern in ("chkpnt*.pth", "ckpts/ckpt_*.pt", "ckpt_*.pt")
        for p in folder.glob(pattern)
        if (m := re.search(r"(\d{1,12})\.pth?$", p.name))
    ]
    best = folder / "chkpnt_best.pth"  # of 4DGS (Yang et al.); the newest where there are others
    return max(found)[1] if found else best if best.is_file() else _newest_ply(folder)


def _newest_ply(folder: Path) -> Path:
    """Return the newest PLY of a training whose PLYs are whole results (the paper's code); else the folder itself."""
    plys = sorted(
        folder.glob("point_cloud/iteration_*/point_cloud.ply"),
        key=lambda p: int(re.sub(r"\D", "", p.parent.name) or 0),
    )
    return plys[-1] if plys and Source(plys[-1]).ply.has(*paper_code.VELOCITY) else folder
