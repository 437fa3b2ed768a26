"""`gof generate`: from a scene spec to a dataset folder, resumable, on this machine or on a dask cluster."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from gof.commands.everywhere import require_writable, write_figures
from gof.commands.read import Preset, read_options
from gof.core.costs import Costs, StageLog
from gof.core.errors import GofError
from gof.host.terminal import console
from gof_benchmark.generator import graph
from gof_benchmark.generator.blender_process import require_look
from gof_benchmark.generator.workers import require_certificate
from gof_benchmark.scenes import claimed, load_scene
from gof_blender.core.checked_json import SpecError
from gof_blender.pure import dataset_process
from gof_blender.pure.child import JobError, python
from gof_blender.pure.layout import Layout, warnings_of_bake
from gof_blender.pure.plausibility import require_sense
from gof_blender.pure.spec import SceneSpec


@dataclass
class GenerateConfig:
    """Simulate and render a fire scene: pictures, cameras and the exact velocity of the gas, in one dataset folder.

    Examples:
      gof generate demo --out data/fire
      gof generate demo --estimate
      gof generate ring.json --fire-of data/fire

    Stopped at any time, the same command goes on where it was; no finished frame is made twice.
    """

    scene: tyro.conf.Positional[Annotated[str, tyro.conf.arg(metavar="SCENE")]]
    """Spec file (.json), or the name of a built-in scene."""
    out: Path | None = None
    """Dataset folder to make or to finish. Default: beside the spec file, named as the scene; of a built-in scene
    data/NAME."""
    preset: Preset | None = None
    """Cost preset instead of the scene's own settings."""
    views: tuple[
        Literal[
            "nerfstudio",
            "dnerf",
            "points",
            "colmap",
            "dynerf",
            "n3v",
            "multipleview",
            "hypernerf",
            "nerfds",
            "freetimegs",
            "firebundle",
        ],
        ...,
    ] = ()
    """Also write the dataset in the layouts that other people's code reads."""
    workers: int = 2
    """Blender processes at a time on this machine."""
    scheduler: str | None = None
    """Address of a running dask scheduler whose workers share this file system; default: this machine."""
    tls: Path | None = None
    """Folder with cert.pem and key.pem for the scheduler. Without them, everyone who can reach the scheduler can run
    programs as you (docs/cluster.md)."""
    fire_of: Path | None = None
    """Dataset with this very fire, baked: seen by other cameras or elsewhere, it costs pictures only."""
    estimate: bool = False
    """Only predict time, memory and disk for this machine."""


def main(argv: list[str]) -> int:
    """`gof generate SPEC_OR_SCENE [--out DIR]`; see --help."""
    config = read_options(GenerateConfig, "generate", argv)
    if config.workers < 1:
        raise GofError(f"--workers {config.workers}: must be 1 or more")
    require_certificate(config.scheduler, config.tls)
    spec = load_scene(config.scene, config.preset)
    layout = Layout(config.out or _default_out(config.scene, spec))
    if not layout.description.exists():
        for note in _checked(spec, layout, config.estimate):
            console().print("note:", note, style="yellow")
    if config.estimate:
        _print_estimate(spec, layout)
        return 0
    log = StageLog(layout.costs)
    with claimed(layout, spec):
        if config.fire_of:
            _take_fire(layout, config.fire_of, spec)
        to_do = not layout.description.exists() or bool(config.views)
        if to_do:
            _make(spec, layout, log, config)
    if to_do:
        print(_summary(log.costs()))
        for note in warnings_of_bake(layout):
            console().print("note:", note, style="yellow")
    costs = asdict(log.costs())
    write_figures({"dataset": str(layout.root), "wall_s": costs["wall_s"], "stages": costs["stages"]})
    print(f"dataset: {layout.root}")
    return 0


def _take_fire(layout: Layout, other: Path, spec: SceneSpec) -> None:
    try:
        layout.take_fire_of(Layout(other), spec)
    except SpecError as error:
        raise GofError(f"{error} (--fire-of)") from error


def _default_out(scene: str, spec: SceneSpec) -> Path:
    """Beside the spec's file; of a built-in scene, which has no place of the user's, data/NAME."""
    path = Path(scene)
    return require_writable(path.absolute().parent) / spec.name if path.is_file() else Path("data") / spec.name


def _checked(spec: SceneSpec, layout: Layout, estimate: bool) -> list[str]:
    """Return notes for the user on a spec before anything is made. Raises GofError: it would be no dataset, or,
    but for an estimate, this machine cannot make it."""
    try:
        notes = require_sense(spec)
        require_look(spec.display)
        layout.require_free(spec)
    except SpecError as error:
        raise GofError(f"{spec.name}: {error}") from error
    if not layout.bake_marker.exists():
        from gof_benchmark.generator import machine

        if not estimate:
            machine.refuse(spec, layout.root)
        notes += _in_its_scene(spec)
    return notes


def _in_its_scene(spec: SceneSpec) -> list[str]:
    """Return notes for the user on objects in a .blend of theirs. Raises GofError: it cannot be the
    surroundings."""
    try:
        return dataset_process.scene_notes(spec, python())
    except (SpecError, JobError) as error:
        raise GofError(f"{spec.name}: {error}") from error


def _print_estimate(spec: SceneSpec, layout: Layout) -> None:
    from gof_benchmark.generator import machine

    prediction = machine.predict(spec, machine.this_machine())
    print(prediction, flush=True)
    write_figures(asdict(prediction))
    machine.refuse(spec, layout.root)


def _make(spec: SceneSpec, layout: Layout, log: StageLog, config: GenerateConfig) -> None:
    """Whatever is missing of the dataset, then its views."""
    if not layout.description.exists():
        graph.make(spec, layout, log, config.scheduler, config.workers, config.tls)
    if config.views:
        from gof_benchmark import views

        with log.measure("views", views=list(config.views)):
            for name in config.views:
                views.write(name, layout.root)


STAGES = ("bake", "ground-truth", "render", "finish", "views")  # in the order in which they begin


def _summary(costs: Costs) -> str:
    """Return the time by the clock on the wall, and the sum of the processes, which work at the same time."""
    in_order = sorted(costs.stages, key=lambda cost: STAGES.index(cost.name) if cost.name in STAGES else len(STAGES))
    stages = ", ".join(f"{cost.name} {cost.settings.get('wall_s', cost.seconds):.0f} s" for cost in in_order)
    processes = sum(cost.seconds for cost in costs.stages)
    return f"{costs.wall_s:.0f} s by the clock ({stages}; they overlap), {processes:.0f} s summed over processes"
