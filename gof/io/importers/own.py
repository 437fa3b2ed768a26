"""Our own files: results (`.npz` gof-linear/1, `.ply` gof-transient) and trajectories (`.npz` gof-trajectory/1)."""

from __future__ import annotations

from gof.gaussians import TransientGaussians
from gof.io.importers.ply_sequence import difference_notes
from gof.io.importers.source import Imported, ImportOptions, Source
from gof.trajectory import SCHEMA, Trajectory


def matches(source: Source) -> bool:
    if source.path.suffix == ".npz":
        return str(source.npz.get("schema", "")).startswith("gof-")
    return (
        source.path.is_file()
        and source.path.suffix == ".ply"
        and source.ply.has("t_mu", "t_sigma", "vx", "vy", "vz", "is_dynamic")
    )


def read(source: Source, options: ImportOptions) -> Imported:
    if source.path.suffix == ".npz" and str(source.npz["schema"]) == SCHEMA:
        trajectory = Trajectory.from_arrays(source.npz, source.path)
        return Imported(trajectory, "trajectory", source.path, difference_notes(trajectory))
    return Imported(TransientGaussians.load(source.path), "gof", source.path)
