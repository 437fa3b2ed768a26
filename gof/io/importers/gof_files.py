"""Our own files: results (`.npz` gof-linear/1, `.ply` gof-transient) and trajectories (`.npz` gof-trajectory/1)."""

from __future__ import annotations

from pathlib import Path

from gof.core.gaussians import TransientGaussians
from gof.core.results import PLY_SOURCE as SAYS
from gof.core.trajectory import SCHEMA, Trajectory
from gof.io.importers.ply_sequence import clock_notes, difference_notes
from gof.io.importers.source import Imported, ImportOptions, Source

OPTIONS = ()  # seconds and metres: nothing is left to say
UNSIGNED = "the file does not say what it was made from, so it counts as a result of gof reconstruct"


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
    return Imported(TransientGaussians.load(source.path), "gof", source.path, [] if made_from(source) else [UNSIGNED])


def converted(method: str, path: Path) -> str:
    """Return the source that a file of ours names, where that is the result at `path`, read as `method`."""
    return f"{method}: {path.name}"


def converted_from(source: Source) -> str:
    """Return method of the result that a file of ours was converted from; "" or other words where it was made in
    another way.

    A result is not ours for being in our format: another method's is the whole scene, and is drawn so.
    """
    return made_from(source).partition(": ")[0]


def made_from(source: Source) -> str:
    """Return a file of ours' note on that: "gof reconstruct demo", or the words of `converted`; "" for nothing."""
    if source.path.suffix == ".npz":
        return str(source.npz.get("source", ""))
    return next((c for c in source.ply.comments if c.startswith(SAYS)), "").removeprefix(SAYS)
