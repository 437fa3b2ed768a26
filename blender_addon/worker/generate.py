"""Worker that generates one stage of a dataset in its own Blender process; `gof generate` and the panel start it.

    python -m gof_blender.worker.generate --spec spec.json --out DATASET --stage STAGE

Stages, in order; each resumes, what is finished is not made again:

    bake          scene.blend, and the fire of every step: simulated, or from grids
    render        plates and frames; ``serve`` likewise, but only those requested, and during the bake
    video         pictures through a codec, if the spec says so
    ground-truth  velocity, and what else the spec lists
    flow          optical flow, if the spec lists it
    finish        dataset.json

One process per stage, because a second bake in the same process is unreliable and the wheel cannot exit normally after
a bake.

``serve`` reads lines ``{"frame": 3, "camera": 0}`` from standard input and answers each with a line
``{"rendered": {"frame": 3, "camera": 0, "seconds": 0.7, "cpu_s": 1.2, "peak_mb": 410.0}}``; it ends with its input.

Progress goes to standard output as lines ``{"progress": {"stage": "render", "done": 3, "total": 108}}``, and at the end
``{"cost": {"cpu_s": 61.2, "peak_mb": 410.0}}``; what Blender itself prints goes to DATASET/.cache/<stage>.log.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import time
from pathlib import Path

from ..core.checked_json import SpecError
from ..core.costs import peak_memory_mb
from ..core.description import DatasetDescription, held_out
from ..core.files import read_json, write_json
from ..pure import spec as scene_spec
from ..pure.effects import encodes, shows_board
from ..pure.layout import Layout
from ..pure.spec import SceneSpec
from .reporter import Reporter, exit_status, leave, run_alone

GENERATOR_VERSION = "0.3.0"


def bake(spec: SceneSpec, layout: Layout, progress: Reporter) -> None:
    """Build scene.blend and make the flame of every step; an unfinished simulation goes on after its last step."""
    total = spec.fire.bake_steps(spec.timeline)
    if layout.bake_marker.is_file():
        layout.prune_bake(spec.timeline.steps_needed, finished=True)
        progress(total, total)
        return
    import bpy

    from ..scene import build, extra_truth
    from ..scene.flame_source import flame_source

    if layout.lent.is_file():
        _open_blend(layout, during_bake=True)
        build.replace_surroundings(spec)
        _save_blend(layout)
        write_json(layout.bake_marker, read_json(layout.lent))
        layout.lent.unlink()
        return progress(total, total)
    if layout.go_on_after(bpy.app.version_string):
        _open_blend(layout, during_bake=True)
    else:
        shutil.rmtree(layout.bake, ignore_errors=True)
        build.scene(spec)
        if spec.blend_file:
            from ..scene.backgrounds import blend_file

            blend_file.save(bpy.data.collections["Background"], layout.background)
        _save_blend(layout)  # the cache folder is relative to the file
    write_json(layout.bake_begun, {"blender": bpy.app.version_string})
    source = flame_source(spec)
    source.bake(layout, progress)
    seen = {"cut_off": extra_truth.cut_off(spec, source), **extra_truth.speeds(spec, source)}
    bpy.context.scene.frame_set(spec.timeline.first_frame)
    _save_blend(layout)
    write_json(layout.bake_marker, {"frames": total, "blender": bpy.app.version_string, **seen})
    layout.prune_bake(spec.timeline.steps_needed, finished=True)  # not before: without state, no bake goes on


def render(spec: SceneSpec, layout: Layout, progress: Reporter) -> None:
    """Render the plates, then every frame from every camera."""
    _open_blend(layout)
    from ..scene import render as cycles

    plates = len(spec.cameras.names)
    total = plates + len(spec.pictures)
    progress(0, total)
    cycles.plates(spec, layout, lambda done, _: progress(done, total))
    cycles.frames(spec, layout, lambda done, _: progress(plates + done, total))


def serve(spec: SceneSpec, layout: Layout, progress: Reporter) -> None:
    """Render the requests on standard input, until it ends."""
    _open_blend(layout, during_bake=True)
    from ..scene import render as cycles

    cycles.plates(spec, layout)
    renderer = cycles.FrameRenderer(spec, layout)
    progress.line(ready=True)
    cpu_s = 0.0  # so that the start and the plates count with the first picture
    for line in sys.stdin:
        order, start, before_s = json.loads(line), time.perf_counter(), cpu_s
        renderer(order["frame"], order["camera"])
        cpu_s = time.process_time()
        cost = {"seconds": time.perf_counter() - start, "cpu_s": cpu_s - before_s, "peak_mb": peak_memory_mb()}
        progress.line(rendered=order | cost)


def video(spec: SceneSpec, layout: Layout, progress: Reporter) -> None:
    """Pass the display pictures through a codec, if an effect needs one."""
    settings = next(filter(encodes, spec.effects), None)
    if settings is None:
        return
    from ..scene import video as codec

    names = spec.cameras.whole_clip
    for index, name in enumerate(names):
        codec.through_codec(spec, layout, name, settings)
        progress(index + 1, len(names))


def ground_truth(spec: SceneSpec, layout: Layout, progress: Reporter) -> None:
    """Export the velocity of every frame, and the grids and VDB files that the spec lists."""
    _open_blend(layout)
    from ..scene import extra_truth
    from ..scene.flame_source import flame_source

    source = flame_source(spec)
    source.export_velocity(layout.velocity, progress)
    if "grids" in spec.ground_truth:
        extra_truth.grids(spec, layout, source)
    if "vdb" in spec.ground_truth:
        extra_truth.vdb(spec, layout, source)


def flow(spec: SceneSpec, layout: Layout, progress: Reporter) -> None:
    """Optical flow of every picture, if the spec lists it; needs the flame masks."""
    if "flow" in spec.ground_truth:
        _open_blend(layout)
        from ..scene import extra_truth
        from ..scene.flame_source import flame_source

        extra_truth.flow(spec, layout, flame_source(spec), progress)


def finish(spec: SceneSpec, layout: Layout, progress: Reporter) -> None:
    """Write dataset.json, the last file of a dataset.

    Raises FileNotFoundError if a frame or the velocity is missing.
    """
    _open_blend(layout)
    missing = [path for path in _files(spec, layout) if not path.is_file()]
    if missing:
        raise FileNotFoundError(
            f"{len(missing)} files of the dataset are missing, first {missing[0]}; run the stages before finish"
        )
    _describe(spec, layout).write(layout.root)
    progress(1, 1)


def _files(spec: SceneSpec, layout: Layout) -> list[Path]:
    """Files without which a dataset is not finished."""
    files = [layout.velocity / "zarr.json"]
    names = spec.cameras.names
    for name in names:
        files += [layout.static(name), layout.static_exr(name)]
        files += [layout.board_mask(name)] if any(map(shows_board, spec.effects)) else []
    for frame, camera in spec.pictures:
        files += vars(layout.frame(names[camera], frame)).values()
    return files


def _describe(spec: SceneSpec, layout: Layout) -> DatasetDescription:
    """Return the dataset's description, with the cameras of the open scene."""
    import bpy

    from ..scene import rig
    from ..scene.flame_source import flame_source

    with_flow, with_board = "flow" in spec.ground_truth, any(map(shows_board, spec.effects))
    return DatasetDescription(
        name=spec.name,
        time_s=tuple(frame / spec.clip.fps for frame in range(spec.clip.frames)),
        cameras=tuple(
            rig.describe(camera, spec, layout.patterns(camera.name, with_flow, with_board)) for camera in rig.find(spec)
        ),
        splits=held_out(spec.clip.frames),
        velocity=layout.velocity.name,
        spec=spec.published_in(layout.root).to_dict(),
        effects=tuple(spec.effect_names),
        provenance={"blender": bpy.app.version_string, "generator": GENERATOR_VERSION}
        | flame_source(spec).provenance(),
    )


def _save_blend(layout: Layout) -> None:
    import bpy

    from ..scene import paths

    bpy.context.preferences.filepaths.save_version = 0  # no .blend1 beside it
    paths.overwrite(bpy.context.scene.render, "filepath", "//")
    paths.forget_browsed()
    bpy.ops.wm.save_as_mainfile(filepath=str(layout.blend), check_existing=False)


def _open_blend(layout: Layout, during_bake: bool = False) -> None:
    if not (layout.bake_marker.is_file() or (during_bake and layout.blend.is_file())):
        raise FileNotFoundError(f"{layout.root} holds no finished bake; run --stage bake first")
    import bpy

    from ..scene import mantaflow

    mantaflow.enable()
    bpy.ops.wm.open_mainfile(filepath=str(layout.blend), use_scripts=False)


STAGES = {
    "bake": bake,
    "render": render,
    "serve": serve,
    "video": video,
    "ground-truth": ground_truth,
    "flow": flow,
    "finish": finish,
}


def main(argv: list[str] | None = None) -> int:
    """Run one stage; returns the exit status.

    The process must then end through ``reporter.leave``.
    """
    parser = argparse.ArgumentParser(prog="python -m gof_blender.worker.generate", description=__doc__.split("\n")[0])
    parser.add_argument("--spec", type=Path, required=True, help="scene spec (JSON)")
    parser.add_argument("--out", type=Path, required=True, help="dataset folder")
    parser.add_argument("--stage", choices=STAGES, required=True)
    args = parser.parse_args(argv)
    layout = Layout(args.out.resolve())

    def work() -> None:
        spec = scene_spec.load(args.spec)
        progress = Reporter(args.stage, layout.log(args.stage))
        os.chdir(layout.hidden)  # Mantaflow leaves files where it runs
        STAGES[args.stage](spec, layout, progress)
        progress.line(cost={"cpu_s": time.process_time(), "peak_mb": peak_memory_mb()})

    return exit_status(work, SpecError)


def run(argv: list[str]) -> None:
    """Run one stage as the only work of this process."""
    run_alone(main, argv)


if __name__ == "__main__":
    leave(main())
