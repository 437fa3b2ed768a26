"""`gof generate`: from a scene spec to a dataset folder, resumable, on this machine or on a dask cluster."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from gof.costs import StageLog
from gof.errors import GofError
from gof.io.files import only_run_in, read_json, write_json
from gof_blender.pure import spec as scene_spec
from gof_blender.pure.layout import Layout
from gof_blender.pure.spec import SceneSpec, SpecError

SCENES = Path(__file__).parents[1] / "scenes"


@dataclass
class GenerateConfig:
    """Simulate and render a fire scene: pictures, cameras and the exact velocity of the gas, in one dataset folder.

    Stopped at any time, the same command goes on where it was; no finished frame is made twice.
    """

    scene: Annotated[str, tyro.conf.Positional]
    """Spec file (.json), or the name of a built-in scene."""
    out: Path
    """Dataset folder to make or to finish."""
    preset: str | None = None
    """Cost preset instead of the scene's own settings: toy, preview, draft, standard or paper."""
    views: tuple[Literal["nerfstudio", "dnerf", "colmap", "dynerf"], ...] = ()
    """Also write the dataset in the layouts that other people's code reads."""
    workers: int = 2
    """Blender processes at a time on this machine."""
    scheduler: str | None = None
    """Address of a running dask scheduler whose workers share this file system; default: this machine."""
    estimate: bool = False
    """Only predict time, memory and disk for this machine."""
    json: Path | None = None
    """Also write what each stage cost to this file."""


def main(argv: list[str]) -> int:
    """`gof generate SPEC_OR_SCENE --out DIR`; see --help."""
    config = tyro.cli(GenerateConfig, prog="gof generate", args=argv)
    spec, layout = load_scene(config.scene, config.preset), Layout(config.out)
    if config.estimate:
        from gof_benchmark.generator import machine as costs

        prediction = costs.predict(spec, costs.machine())
        print(prediction)
        if config.json:
            write_json(config.json, asdict(prediction))
        return 0
    claim(layout, spec)
    log = StageLog(layout.costs)
    if not layout.description.exists() or config.views:
        with only_run_in(layout.hidden), _wall_clock(layout.costs):
            _make(spec, layout, log, config)
        print(_summary(layout.costs, log))
    if config.json:
        costs = read_json(layout.costs)
        write_json(config.json, {"dataset": str(layout.root), "wall_s": costs.get("wall_s"), "stages": costs["stages"]})
    print(f"dataset: {layout.root}")
    return 0


def _make(spec: SceneSpec, layout: Layout, log: StageLog, config: GenerateConfig) -> None:
    """Whatever is missing of the dataset, then its views."""
    if not layout.description.exists():
        from gof_benchmark.generator import graph
        from gof_benchmark.generator import machine as costs

        if not layout.bake_marker.exists():
            costs.refuse_if_too_large(spec, layout.root)
        with graph.cluster(config.scheduler, config.workers) as client:
            graph.Generation(spec, layout, client, log).run()
    if config.views:
        from gof_benchmark import views

        with log.measure("views", views=list(config.views)):
            for name in config.views:
                views.write(name, layout.root)


@contextmanager
def _wall_clock(costs: Path) -> Iterator[None]:
    """Add the wall seconds of the block to `wall_s` of costs.json, also when it fails."""
    start, before = time.perf_counter(), read_json(costs).get("wall_s", 0.0) if costs.exists() else 0.0
    try:
        yield
    finally:
        if costs.exists():
            write_json(costs, read_json(costs) | {"wall_s": round(before + time.perf_counter() - start, 3)})


def _summary(costs: Path, log: StageLog) -> str:
    """What the clock on the wall says, and what the processes say, which work at the same time."""
    stages = ", ".join(f"{cost.name} {cost.settings.get('wall_s', cost.seconds):.0f} s" for cost in log.stages())
    processes = sum(cost.seconds for cost in log.stages())
    return f"{read_json(costs)['wall_s']:.0f} s by the clock ({stages}; they overlap), {processes:.0f} s summed over processes"


def load_scene(scene: str, preset: str | None = None) -> SceneSpec:
    """The spec of a file or of a built-in scene, with a cost preset applied.

    Raises:
        GofError: no such file or scene, or a field of the spec is wrong (names it).
    """
    built_in = sorted(path.parent.name for path in SCENES.glob("*/spec.json"))
    path = SCENES / scene / "spec.json" if scene in built_in else Path(scene)
    if not path.is_file():
        raise GofError(f"'{scene}' is neither a spec file nor a built-in scene ({', '.join(built_in)})")
    try:
        spec = scene_spec.load(path)
        return spec.with_preset(preset) if preset else spec
    except SpecError as error:
        raise GofError(str(error)) from error


def claim(layout: Layout, spec: SceneSpec) -> None:
    """Make the folder this spec's, or check that it is.

    Raises:
        GofError: the folder was made from another spec, or holds other things.
    """
    try:
        scene_spec.claim(layout, spec)
    except SpecError as error:
        raise GofError(f"{error} (--out)") from error
