"""Is the cost model right for specs it was not fitted to, and what does the generator cost beyond bare Blender?

    python -m gof_benchmark.evidence.cost_check --work out/cost_check

Makes two datasets and compares them with their predictions; then the bake and the renders of the first once more in a
bare script: one process that calls Blender and keeps what Blender writes. Processor seconds, because a busy machine
stretches the clock but hardly them.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

from gof.io.files import read_json, write_json
from gof_benchmark.commands.generate import load_scene
from gof_benchmark.generator import machine as costs
from gof_blender.pure import spec as scene_spec
from gof_blender.pure.layout import Layout
from gof_blender.pure.spec import SceneSpec


def specs() -> list[SceneSpec]:
    """A part of the studio's draft, and a small cloister: other surroundings, fires, sizes and effects than the calibration's."""
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


def usage(command: list[str]) -> dict[str, float]:
    """Run a command; wall and processor seconds of it and everything it started."""
    start = time.perf_counter()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, command)
    return {"wall_s": time.perf_counter() - start, "cpu_s": used.ru_utime + used.ru_stime}


def make(spec: SceneSpec, work: Path) -> dict:
    """Make a dataset, once; what it really took."""
    result = work / f"{spec.name}.json"
    if result.exists():
        return read_json(result)
    root = work / spec.name
    scene_spec.save(spec, work / f"{spec.name}.spec.json")
    used = usage([sys.executable, "-m", "gof", "generate", str(work / f"{spec.name}.spec.json"), "--out", str(root)])
    stages = {stage["name"]: stage for stage in read_json(Layout(root).costs)["stages"]}
    figures = used | {
        "load": os.getloadavg()[0],
        "processor_s": used["cpu_s"] / os.cpu_count(),
        "memory_mb": stages["bake"]["peak_mb"] + stages["render"]["peak_mb"],
        "disk_mb": sum(path.stat().st_size for path in root.rglob("*") if path.is_file()) / 2**20,
    }
    write_json(result, figures)
    return figures


def bare(path: Path, root: Path) -> None:
    """The bake and the renders of a spec with Blender's own calls; ends this process."""
    import bpy

    from gof_blender.scene import build, fire, mantaflow, render, rig

    spec, layout = scene_spec.load(path), Layout(root.resolve())
    layout.hidden.mkdir(parents=True)
    os.chdir(layout.hidden)
    build.scene(spec)
    bpy.ops.wm.save_as_mainfile(filepath=str(layout.blend))
    fire.bake(fire.find_domain())
    scene, settings, domain = bpy.context.scene, bpy.context.scene.render.image_settings, fire.find_domain()
    settings.file_format, settings.color_depth = "OPEN_EXR_MULTILAYER", "32"
    domain.hide_render, scene.cycles.samples, scene.render.use_persistent_data = True, spec.render.plate_samples, False
    for camera in rig.find(spec):
        scene.camera, scene.render.filepath = camera, f"{root}/{camera.name}.exr"
        bpy.ops.render.render(write_still=True)
    domain.hide_render, scene.cycles.samples, scene.render.use_persistent_data = False, spec.render.samples, True
    render._leave_only_the_fire()
    for frame in range(spec.clip.frames):
        scene.frame_set(spec.timeline.blender_frame(frame))
        for camera in rig.find(spec):
            scene.camera, scene.render.filepath = camera, f"{root}/{camera.name}-{frame:06d}.exr"
            bpy.ops.render.render(write_still=True)
    mantaflow.leave()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--work", type=Path, default=Path("out/cost_check"))
    parser.add_argument("--bare", type=Path, help=argparse.SUPPRESS)
    args = parser.parse_args()
    work = args.work.resolve()
    if args.bare:
        bare(args.bare, work)
    work.mkdir(parents=True, exist_ok=True)
    machine = costs.machine()
    rows = {spec.name: make(spec, work) for spec in specs()}
    predictions = {spec.name: costs.predict(spec, machine) for spec in specs()}
    print(f"calibration's own error: {100 * machine.error:.0f} %")
    print("| dataset | quantity | predicted | real | error |\n|---|---|---|---|---|")
    for name, row in rows.items():
        for quantity, was in (
            ("processor_s", predictions[name].total_s),
            ("memory_mb", predictions[name].memory_mb),
            ("disk_mb", predictions[name].disk_mb),
        ):
            is_ = row[quantity]
            print(f"| {name} | {quantity} | {was:.0f} | {is_:.0f} | {100 * (was - is_) / is_:+.0f} % |")
        print(f"| {name} | wall_s at load {row['load']:.1f} | | {row['wall_s']:.0f} | |")
    first = next(iter(rows))
    result = work / "bare.json"
    if not result.exists():
        write_json(
            result,
            usage(
                [
                    sys.executable,
                    "-m",
                    "gof_benchmark.evidence.cost_check",
                    "--bare",
                    str(work / f"{first}.spec.json"),
                    "--work",
                    str(work / "bare"),
                ]
            ),
        )
    alone, whole = read_json(result), rows[first]
    print(
        f"{first}: generator {whole['cpu_s']:.0f} CPU s, bare Blender script {alone['cpu_s']:.0f}: {100 * (whole['cpu_s'] / alone['cpu_s'] - 1):+.1f} %"
    )


if __name__ == "__main__":
    main()
