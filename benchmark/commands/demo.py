"""`gof demo`: the whole loop on a small real fire, one child process a stage, resumable."""

from __future__ import annotations

import hashlib
import json
import math
import sys
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import ClassVar

from gof.commands.evaluate import around_table
from gof.commands.everywhere import write_figures
from gof.commands.read import Preset, read_options
from gof.core.cameras import in_words
from gof.core.costs import StageCost, StageLog
from gof.core.errors import GofError
from gof.core.files import write_json
from gof.core.records import claim, to_json
from gof.core.time_left import MachineLoad, Paces, duration
from gof.evaluate.scores import Scores
from gof.host.processes import python_command
from gof.host.worker import run_worker
from gof.reconstruct.presets import FLAGS, LEAST, REST_S, effort_of, seeing_s, step_ms
from gof_benchmark.scenes import load_scene
from gof_blender.pure import spec as scene_spec
from gof_blender.pure.cost_model import predict_here
from gof_blender.pure.spec import SceneSpec

AROUND_FRAMES = 2  # that the views from all around have
# Seconds on the machine of `gof.core.time_left` of the demo's last stages, and of what comes before a reconstruction.
SECONDS = {"evaluate": 10.0, "import": 8.0, "report": 10.0, "share": 3.2}
START_S = 4.0
WINDOW = 0.92  # of the demo's picture, that its flame needs


@dataclass
class DemoConfig:
    """Simulate a small fire, reconstruct it from three videos, score the result, bring it into Blender.

    Examples:
      gof demo
      gof demo --out out/toy --preset toy --steps 20

    Everything lands in OUT; open OUT/report.html, send OUT/share.html. Stopped at any time, the same command goes on
    where it was.
    """

    FIGURES: ClassVar = (Scores,)

    out: Path = Path("out/demo")
    """Folder for everything the demo makes."""
    scene: str = "demo"
    """Built-in scene or spec file to simulate."""
    preset: Preset | None = None
    """Cost preset of the scene; default: the scene's own settings."""
    steps: int | None = None
    """Optimisation steps; default: those of `gof reconstruct`."""
    gaussians: int | None = None
    """Number of Gaussians; default: that of `gof reconstruct`."""


def spec_of(config: DemoConfig) -> SceneSpec:
    """Return the scene, also seen from all around, so that the flame is scored from where it was not filmed, too, and
    with its true light, where velocities are scored.

    Raises GofError: there is no such scene.
    """
    spec = load_scene(config.scene, config.preset)
    spec = replace(spec, ground_truth=tuple(dict.fromkeys((*spec.ground_truth, "grids"))))
    if spec.cameras.around_frames:
        return spec
    return replace(spec, cameras=replace(spec.cameras, around_frames=min(AROUND_FRAMES, spec.clip.frames)))


@dataclass(frozen=True)
class DemoSettings:
    """demo.json: what a demo's folder is made with. `scene`: name and digits of its spec."""

    SCHEMA: ClassVar[str] = "gof-demo"
    VERSION: ClassVar[int] = 1

    scene: str
    gaussians: int | None
    iterations: int | None

    @classmethod
    def of(cls, config: DemoConfig) -> DemoSettings:
        """Build it. Raises GofError: there is no such scene, or an option is out of range."""
        for name, given in (("gaussians", config.gaussians), ("iterations", config.steps)):
            if given is not None and given < LEAST[name]:
                raise GofError(f"{FLAGS[name]} {given}: must be {LEAST[name]} or more")
        spec = spec_of(config)
        digits = hashlib.sha256(json.dumps(spec.to_dict(), sort_keys=True).encode()).hexdigest()[:16]
        return cls(f"{spec.name} {digits}", config.gaussians, config.steps)


@dataclass(frozen=True)
class Stage:
    """A step of the demo, made from `inputs`; `costs`: a costs.json with its own sub-stages, when it keeps one."""

    name: str
    command: list
    inputs: list[Path]
    outputs: list[Path]
    costs: Path | None = None

    @property
    def finished(self) -> bool:
        """Return whether all outputs are there, and none is older than what it was made from."""
        if not all(path.exists() for path in self.outputs):
            return False
        oldest = min(path.stat().st_mtime_ns for path in self.outputs)
        return all(path.stat().st_mtime_ns <= oldest for path in self.inputs)


def stages_of(config: DemoConfig) -> list[Stage]:
    """Return the steps in order, each a `gof` command."""
    out, dataset, scene = config.out, config.out / "dataset", config.out / "scene.json"
    made, result, preview = dataset / "dataset.json", out / "reconstruct" / "result.npz", out / "preview.png"
    effort = [x for name in ("gaussians", "steps") if (n := getattr(config, name)) for x in (f"--{name}", n)]
    into_blender = ["--dataset", dataset, "--out", out / "result.blend", "--preview", preview]
    return [
        Stage(
            "generate",
            ["generate", scene, "--out", dataset],
            [],
            [made],
            dataset / "costs.json",
        ),
        Stage(
            "reconstruct",
            ["reconstruct", dataset, *effort, "--out", result.parent],
            [made],
            [result],
            result.parent / "costs.json",
        ),
        Stage(
            "evaluate",
            ["evaluate", result, "--dataset", dataset, "--json", evaluation(config)],
            [made, result],
            [evaluation(config)],
        ),
        Stage("import", ["import", result, *into_blender], [made, result], [out / "result.blend", preview]),
        Stage("report", ["report", out, "--dataset", dataset], [evaluation(config), preview], [out / "report.html"]),
        Stage(
            "share",
            ["share", f"reconstruction={result.parent}", "--dataset", dataset, "--out", out / "share.html"],
            [made, result],
            [out / "share.html"],
        ),
    ]


def evaluation(config: DemoConfig) -> Path:
    """Return where the stage "evaluate" writes its `Scores`."""
    return config.out / "evaluate" / "evaluation.json"


def main(argv: list[str]) -> int:
    """`gof demo [--out DIR]`; see --help."""
    config = read_options(DemoConfig, "demo", argv)
    claim(config.out / "demo.json", DemoSettings.of(config), config.out / "dataset" / "spec.json", _option_of)
    scene, spec = config.out / "scene.json", spec_of(config)
    if not scene.is_file() or scene_spec.load(scene) != spec:
        scene_spec.save(spec, scene)
    start = time.perf_counter()
    run_stages(config)
    scores = Scores.read(evaluation(config))
    content = to_json(scores) | {"stages": [asdict(cost) for cost in stage_costs(config)]}
    write_json(config.out / "scores.json", content)
    write_figures(content)
    summarise(scores)
    print(f"total of this run {time.perf_counter() - start:.0f} s; open {config.out / 'report.html'}")
    print(f"{config.out / 'share.html'} is the flame itself, in one file to send")
    return 0


def _option_of(field: str) -> str:
    return FLAGS.get(field, f"--{field}")


def run_stages(config: DemoConfig) -> None:
    """Run what is not finished, or older than what it is made from."""
    log, machine = StageLog(config.out / "costs.json"), MachineLoad.measured_now()
    to_come = expected_s(config, machine)
    print(f"about {duration(sum(to_come.values()))} in all on this machine as busy as it is now", file=sys.stderr)
    for stage in stages_of(config):
        del to_come[stage.name]
        if stage.finished:
            print(f"{stage.name}: finished before")
            continue
        if stage.name in ("evaluate", "import", "report", "share"):  # made from what has changed; the others resume
            for path in stage.outputs:
                path.unlink(missing_ok=True)
        if stage.name == "report":  # which reads them here
            Scores.read(evaluation(config)).write(config.out / "scores.json")
        command = python_command("-m", "gof", *map(str, stage.command))
        cost = run_worker(command, stage.name, config.out / f"{stage.name}.log", sum(to_come.values()))
        if not stage.costs:  # the others keep their own, part by part
            log.record(stage.name, cost.seconds, cost.peak_mb)
        print(f"{stage.name}: {cost.seconds:.0f} s, {cost.peak_mb:.0f} MB")


def expected_s(config: DemoConfig, machine: MachineLoad) -> dict[str, float]:
    """Return seconds of the clock that each stage that is not finished should take, by its name."""
    spec, frames = spec_of(config), round(7 / 8 * spec_of(config).clip.frames)
    cameras = len(spec.cameras.whole_clip)
    effort = effort_of("preview", config.steps, config.gaussians, clip=(frames, cameras))
    pixels = math.prod(spec.picture_px)
    each_ms = step_ms(effort.gaussians, frames, round(WINDOW * pixels), native=True, held=True)
    parts = seeing_s(frames, frames * cameras * pixels, effort.voxels)
    parts |= {"optimise": effort.iterations * each_ms / 1e3, "rest": REST_S}
    paces = Paces.known()
    seconds = {"generate": predict_here(spec, machine).total_s}
    seconds["reconstruct"] = START_S + sum(paces.expected_s(parts, machine).values())
    seconds |= paces.expected_s(SECONDS, machine)
    return {stage.name: 0.0 if stage.finished else seconds.get(stage.name, 0.0) for stage in stages_of(config)}


def stage_costs(config: DemoConfig) -> list[StageCost]:
    """Return the cost of every stage, part by part where it keeps account."""
    logs = [stage.costs for stage in stages_of(config) if stage.costs] + [config.out / "costs.json"]
    return [cost for log in logs for cost in StageLog(log).stages()]


def summarise(scores: Scores) -> None:
    """Print the scores next to what they must beat."""
    from rich.console import Console
    from rich.table import Table

    table = Table(title="motion: DVE against the simulation's own velocity")
    for column in ("velocities", "L2 (lower is better)", "CosSim (higher is better)"):
        table.add_column(column)
    table.add_row("[bold]reconstruction[/]", f"[bold]{scores.dve.l2:.3f}[/]", f"[bold]{scores.dve.cos_sim:.3f}[/]")
    for name, trivial_baseline in scores.trivial_baselines.items():
        table.add_row(f"trivial: {name}", f"{trivial_baseline.l2:.3f}", f"{trivial_baseline.cos_sim:.3f}")
    console = Console()
    console.print(table)
    if scores.psnr_flame is not None:
        console.print(
            f"held-out pictures at {in_words(scores.images.sizes_px)}, flame only: "
            f"PSNR [bold]{scores.psnr_flame:.2f} dB[/] "
            f"(background alone {scores.psnr_flame_plate:.2f} dB), "
            f"SSIM {scores.ssim_flame:.3f} ({scores.ssim_flame_plate:.3f})"
        )
    if scores.around:
        console.print(around_table(scores))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
