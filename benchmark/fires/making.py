"""Making a scene whose fire may have to be solved by OpenFOAM first: its grids, then its dataset."""

from __future__ import annotations

from pathlib import Path

from gof.core.costs import StageLog
from gof_benchmark.generator import graph
from gof_benchmark.scenes import claimed
from gof_benchmark.solvers.openfoam.foam_fire import FoamFire
from gof_benchmark.solvers.openfoam.run import bake
from gof_blender.pure.cost_model import predict_here
from gof_blender.pure.layout import Layout
from gof_blender.pure.spec import SceneSpec

SOLVE_S = 1800.0  # OpenFOAM, a fire: 15 to 30 minutes of one core


def make(spec: SceneSpec, foam: FoamFire | None, folder: Path, work: Path) -> None:
    """Make the grids of a scene where it burns any, then its dataset. Does nothing where all is there.

    Args:
        folder: of the dataset.   work: the place where all fires are solved: `work`/openfoam/FIRE/grids.
    Raises:
        MissingDependencyError: its grids are not there, and OpenFOAM is not installed.
        GofError: a folder holds another scene, or a stage failed; what was finished is kept.
    """
    layout = Layout(folder)
    if foam and not _solved(spec, work):
        bake(foam, work / "openfoam" / foam.name)
    spec = spec.resolved(work.resolve())
    with claimed(layout, spec):
        if not layout.description.exists():
            graph.make(spec, layout, StageLog(layout.costs))


def predicted_s(spec: SceneSpec, foam: FoamFire | None, folder: Path, work: Path) -> float:
    """Return seconds that are left of a scene, roughly; of one that is not solved yet, what its solver takes."""
    if Layout(folder).description.exists():
        return 0.0
    if foam and not _solved(spec, work):
        return SOLVE_S
    return predict_here(spec.resolved(work.resolve())).total_s


def _solved(spec: SceneSpec, work: Path) -> bool:
    return (work / spec.fire.grids / "fire.json").exists()
