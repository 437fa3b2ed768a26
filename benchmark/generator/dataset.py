"""Making a dataset: whatever is missing of it in its folder."""

from __future__ import annotations

from pathlib import Path

from gof.core.costs import StageLog
from gof.host import extras
from gof_benchmark.generator import graph, machine
from gof_blender.pure.layout import Layout
from gof_blender.pure.spec import SceneSpec


def make(
    spec: SceneSpec,
    layout: Layout,
    log: StageLog,
    scheduler: str | None = None,
    workers: int = 2,
    tls: Path | None = None,
) -> None:
    """Simulate and render what is missing, with a prediction before and a bar meanwhile; nothing in a finished dataset.

    Args:
        layout: its folder, which this spec has claimed (`gof_benchmark.scenes.claim`), and which no other run works in.
        scheduler: address of a dask scheduler; None for `workers` Blender processes on this machine.
        tls: folder with the certificate that the scheduler asks for (`graph.cluster`).
    Raises:
        GofError: memory or disk do not suffice, the scheduler does not answer, or a stage failed; what was finished is
            kept.
        MissingDependencyError: Blender is not installed here, and no scheduler is given; or distributed is not.
    """
    if layout.description.exists():
        return
    if not scheduler:  # whose workers have Blender, where it is given
        extras.require("bpy", "blender", "making a dataset")
    if not layout.bake_marker.exists():
        machine.refuse_if_too_large(spec, layout.root)
    with graph.cluster(scheduler, workers, tls) as client:
        graph.Generation(spec, layout, client, log).run()
