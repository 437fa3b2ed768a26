"""A rig that is given: another clip's dataset, or a sketch in words, and whether footage can be placed by it."""

from __future__ import annotations

from pathlib import Path

from gof.core.errors import GofError
from gof.dataset import Dataset
from gof.ingest.focal import phones_in_words
from gof.ingest.footage import Footage
from gof.ingest.pose_clues import KnownRig, Solver
from gof.ingest.rig_sketch import EXAMPLES, RigSketch


def rig_sketch(rig: Path) -> RigSketch | None:
    """Return the sketch that --rig is, unless it is a dataset's path. Raises GofError: it is neither."""
    if rig.exists():
        return None
    sketch = RigSketch.parse(str(rig))
    if sketch is None:
        raise GofError(f"--rig {rig}: no such dataset, and no sketch of a rig as {EXAMPLES}")
    return sketch


def require_sketched(sketch: RigSketch, footage: Footage, solver: Solver) -> None:
    """Raise GofError: lenses are not known, or poses are to come from elsewhere."""
    if footage.search is not None:
        raise GofError(
            f"--rig '{sketch.words}': the lenses are not known; give --fov or --cameras. {phones_in_words()}"
        )
    if footage.world_to_camera is not None or solver != "auto":
        raise GofError(f"--rig '{sketch.words}': poses are to come from --cameras or --poses; leave out one of them")


def known_rig(folder: Path, footage: Footage) -> KnownRig:
    """Return the rig of a dataset. Raises GofError: the footage's lenses are not known; see `KnownRig.read`."""
    if footage.search is not None:
        fov = Dataset.open(folder).description.provenance.get("fov_deg")
        raise GofError(
            f"--rig {folder}: its poses hold for its lenses; give them with --fov or --cameras"
            + (f" (it has a field of view of {fov[0]:g} degrees)" if fov else "")
        )
    return KnownRig.read(folder, footage.upright_lenses)
