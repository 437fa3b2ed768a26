"""Is the cost model right for specs it was not fitted to, and what does the generator cost beyond bare Blender?

    python -m gof_benchmark.evidence.cost_check [--work out/cost_check]

Takes about 5 min.

Makes two datasets and compares them with their predictions; then the bake and the renders of the first once more in a
bare script: one process that calls Blender and keeps what Blender writes. CPU seconds, because a busy machine
stretches the clock but hardly them.
"""

from __future__ import annotations

import os
import subprocess
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import tyro

from gof.core.costs import StageLog
from gof.core.files import read_json, write_json
from gof.host.processes import python_command
from gof_benchmark.evidence import child
from gof_benchmark.generator import machine
from gof_benchmark.scenes import load_scene
from gof_blender.pure import spec as scene_spec
from gof_blender.pure.layout import Layout
from gof_blender.pure.spec import SceneSpec


@dataclass(frozen=True)
class CostCheck:
    """Compare predicted with real costs of two datasets, and the generator with a bare Blender script."""

    work: Path = Path("out/cost_check")
    """Folder for the datasets; what is finished there is not made again."""


@dataclass(frozen=True)
class Usage:
    """Wall and CPU seconds of a command and everything it started."""

    wall_s: float
    cpu_s: float


@dataclass(frozen=True)
class Real:
    """The cost of a dataset; `cpu_s` is over all cores, `load` the machine's at the end."""

    wall_s: float
    cpu_s: float
    load: float
    cpu_s: float
    memory_mb: float
    disk_mb: float


def main(argv: list[str] | None = None) -> None:
    """Print the table, and what the generator adds."""
    config = tyro.cli(CostCheck, prog="python -m gof_benchmark.evidence.cost_check", args=argv)
    work = config.work.resolve()
    work.mkdir(parents=True, exist_ok=True)
    coefficients = machine.this_machine()
    print(f"calibration's own error: {100 * coefficients.error:.0f} %")
    print("| dataset | quantity | predicted | real | error |\n|---|---|---|---|---|")
    first, *_ = [check(spec, coefficients, work) for spec in specs()]
    alone = bare_usage(specs()[0], work)
    more = 100 * (first.cpu_s / alone.cpu_s - 1)
    name = specs()[0].name
    print(f"{name}: generator {first.cpu_s:.0f} CPU s, bare Blender script {alone.cpu_s:.0f}: {more:+.1f} %")


def specs() -> list[SceneSpec]:
    """Return a part of the studio's draft, and a small cloister.

    Other surroundings, fires, sizes and effects than the calibration's.
    """
    studio = load_scene("studio", "draft")
    cloister = load_scene("cloister")
    return [
        replace(studio, name="studio-draft", clip=replace(studio.clip, frames=10)),
        replace(
            cloister,
            name="cloister-small",
            clip=replace(cloister.clip, frames=12),
            domain=replace(cloister.domain, resolution=48),
            render=replace(cloister.render, percentage=16, samples=8, plate_samples=16),
        ),
    ]


def check(spec: SceneSpec, coefficients: machine.Machine, work: Path) -> Real:
    """Make a dataset and print its rows."""
    real, predicted = make(spec, work), machine.predict(spec, coefficients)
    for quantity, was, is_ in (
        ("cpu_s", predicted.total_s, real.cpu_s),
        ("memory_mb", predicted.memory_mb, real.memory_mb),
        ("disk_mb", predicted.disk_mb, real.disk_mb),
    ):
        print(f"| {spec.name} | {quantity} | {was:.0f} | {is_:.0f} | {100 * (was - is_) / is_:+.0f} % |")
    print(f"| {spec.name} | wall_s at load {real.load:.1f} | | {real.wall_s:.0f} | |", flush=True)
    return real


def make(spec: SceneSpec, work: Path) -> Real:
    """Make a dataset, once; what it really took."""
    result = work / f"{spec.name}.json"
    if result.exists():
        return Real(**read_json(result))
    root = work / spec.name
    scene_spec.save(spec, spec_file(spec, work))
    used = usage(python_command("-m", "gof", "generate", str(spec_file(spec, work)), "--out", str(root)))
    peak_mb = {stage.name: stage.peak_mb for stage in StageLog(Layout(root).costs).stages()}
    real = Real(
        **asdict(used),
        load=os.getloadavg()[0],
        cpu_s=used.cpu_s / os.cpu_count(),
        memory_mb=peak_mb["bake"] + peak_mb["render"],
        disk_mb=sum(path.stat().st_size for path in root.rglob("*") if path.is_file()) / 2**20,
    )
    write_json(result, asdict(real))
    return real


def spec_file(spec: SceneSpec, work: Path) -> Path:
    return work / f"{spec.name}.spec.json"


def bare_usage(spec: SceneSpec, work: Path) -> Usage:
    """Return the cost of `bare` for a spec, measured once."""
    result = work / "bare.json"
    if not result.exists():
        write_json(result, asdict(usage(child.command(bare, str(spec_file(spec, work)), str(work / "bare")))))
    return Usage(**read_json(result))


def usage(command: list[str]) -> Usage:
    """Run a command."""
    start = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, command)
    return Usage(time.perf_counter() - start, used.ru_utime + used.ru_stime)


def bare(spec_path: str, folder: str) -> None:
    """Run the bake and the renders of a spec with Blender's own calls; in a process of its own."""
    import bpy

    from gof_blender.scene import build, fire, render, rig
    from gof_blender.scene.fire_objects import find_flame

    spec, layout = scene_spec.load(spec_path), Layout(Path(folder))
    layout.hidden.mkdir(parents=True)
    os.chdir(layout.hidden)
    build.scene(spec)
    bpy.ops.wm.save_as_mainfile(filepath=str(layout.blend))
    domain = find_flame()
    fire.bake(domain)
    scene = bpy.context.scene
    scene.render.image_settings.file_format = "OPEN_EXR_MULTILAYER"
    scene.render.image_settings.color_depth = "32"

    def picture(camera: bpy.types.Object, name: str) -> None:
        scene.camera = camera
        scene.render.filepath = f"{layout.root}/{name}.exr"
        bpy.ops.render.render(write_still=True)

    domain.hide_render = True
    scene.cycles.samples = spec.render.plate_samples
    scene.render.use_persistent_data = False
    for camera in rig.find(spec):
        picture(camera, camera.name)
    domain.hide_render = False
    scene.cycles.samples = spec.render.samples
    scene.render.use_persistent_data = True
    render._leave_only_the_fire()
    for frame in range(spec.clip.frames):
        scene.frame_set(spec.timeline.blender_frame(frame))
        for camera in rig.find(spec):
            picture(camera, f"{camera.name}-{frame:06d}")


if __name__ == "__main__":
    main()
