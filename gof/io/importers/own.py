"""Our own files: results (`.npz` gof-linear/1, `.ply` gof-transient) and trajectories (`.npz` gof-trajectory/1)."""

from __future__ import annotations

from gof.gaussians import TransientGaussians
from gof.io.importers.ply_sequence import clock_notes, difference_notes
from gof.io.importers.source import Imported, ImportOptions, Source
from gof.trajectory import SCHEMA, Trajectory

OPTIONS = ()  # seconds and metres: nothing is left to say


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
        notes = [*difference_notes(trajectory), *clock_notes(trajectory, options)]
        return Imported(trajectory, "trajectory", source.path, notes)
    return Imported(TransientGaussians.load(source.path), "gof", source.path)
