"""Worker that generates one stage of a dataset in its own Blender process.

    python -m gof_blender.worker.generate --spec spec.json --out DATASET --stage STAGE

Stages: ``bake`` builds scene.blend and simulates the fire; ``render`` makes plates and frames, ``serve`` likewise but
only what it is asked for, and during the bake; ``video`` passes pictures through a codec; ``ground-truth`` exports
velocity and what else the spec lists, ``flow`` its optical flow; ``finish`` writes dataset.json. Each resumes: what is finished is not made again.
One process per stage, because a second bake in the same process is unreliable and the wheel cannot exit normally after
a bake.

``serve`` reads lines ``{"frame": 3, "camera": 0}`` from standard input and answers each with a line
``{"rendered": {"frame": 3, "camera": 0, "seconds": 0.7, "cpu_s": 1.2, "peak_mb": 410.0}}``; it ends with its input.

Progress goes to standard output as lines ``{"progress": {"stage": "render", "done": 3, "total": 108}}``;
what Blender itself prints goes to DATASET/.cache/<stage>.log.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import threading
import time
import traceback
from pathlib import Path

from ..pure import spec as scene_spec
from ..pure.layout import Layout
from ..pure.spec import SceneSpec
from ..scene import effects

GENERATOR_VERSION = "0.1.0"
STAGES = ("bake", "render", "serve", "video", "ground-truth", "flow", "finish")
TEST_EVERY, TEST_FIRST = 8, 4  # frames k with k % 8 == 4 are held out


class Reporter:
    """Prints progress lines to the original standard output and sends everything else that is printed to a log file.

    Blender's own messages are buffered in C and would otherwise cut progress lines in two.
    """

    def __init__(self, stage: str, log: Path):
        self.stage = stage
        log.parent.mkdir(parents=True, exist_ok=True)
        self._out = os.fdopen(os.dup(1), "w")
        sys.stdout.flush()
        with open(log, "ab") as file:
            os.dup2(file.fileno(), 1)

    def __call__(self, done: int, total: int) -> None:
        self.line(progress={"stage": self.stage, "done": done, "total": total})

    def line(self, **message) -> None:
        print(json.dumps(message), file=self._out, flush=True)


def bake(spec: SceneSpec, layout: Layout, progress) -> None:
    """Build scene.blend and simulate the fire; an unfinished simulation starts over."""
    total = spec.last_frame
    if layout.bake_marker.is_file():
        progress(total, total)
        return
    import bpy

    from ..scene import build, fire

    shutil.rmtree(layout.bake, ignore_errors=True)
    scene_objects = build.scene(spec)
    _save_blend(layout)  # the cache folder is relative to the file
    settings = scene_objects.domain_settings
    with _Watch(
        lambda: sum(fire.velocity_file(settings, frame).is_file() for frame in range(1, total + 1)), total, progress
    ):
        fire.bake(scene_objects.domain)
    bpy.context.scene.frame_set(spec.first_frame)
    _save_blend(layout)
    _write_json(layout.bake_marker, {"frames": total, "blender": bpy.app.version_string})


def render(spec: SceneSpec, layout: Layout, progress) -> None:
    _open_blend(layout)
    from ..scene import render as cycles

    progress(0, spec.clip.frames * len(spec.cameras.names))
    cycles.plates(spec, layout)
    cycles.frames(spec, layout, progress)


def serve(spec: SceneSpec, layout: Layout, progress) -> None:
    """Render what standard input asks for, until it ends."""
    _open_blend(layout, during_bake=True)
    from ..scene import render as cycles

    cycles.plates(spec, layout)
    renderer = cycles.FrameRenderer(spec, layout)
    progress.line(ready=True)
    for line in sys.stdin:
        order, start, cpu = json.loads(line), time.perf_counter(), time.process_time()
        renderer(order["frame"], order["camera"])
        cost = {"seconds": time.perf_counter() - start, "cpu_s": time.process_time() - cpu, "peak_mb": _peak_mb()}
        progress.line(rendered=order | cost)


def video(spec: SceneSpec, layout: Layout, progress) -> None:
    """Pass the display pictures through a codec, if an effect asks for one."""
    settings = next(filter(effects.encodes, spec.effects), None)
    if settings is None:
        return
    from ..scene import video as codec

    for index, name in enumerate(spec.cameras.names):
        codec.through_codec(spec, layout, name, settings)
        progress(index + 1, len(spec.cameras.names))


def ground_truth(spec: SceneSpec, layout: Layout, progress) -> None:
    _open_blend(layout)
    from ..scene import extra_truth, fire, velocity

    frames = [spec.blender_frame(frame) for frame in range(spec.clip.frames)]
    velocity.export_velocity(
        fire.find_domain(), frames, spec.steps_per_second, spec.clip.time_scale, layout.velocity, progress
    )
    if "grids" in spec.ground_truth:
        extra_truth.grids(spec, layout)
    if "vdb" in spec.ground_truth:
        extra_truth.vdb(spec, layout)


def flow(spec: SceneSpec, layout: Layout, progress) -> None:
    """Optical flow of every picture, if the spec lists it; needs the flame masks."""
    if "flow" in spec.ground_truth:
        _open_blend(layout)
        from ..scene import extra_truth

        extra_truth.flow(spec, layout, progress)


def finish(spec: SceneSpec, layout: Layout, progress) -> None:
    """Write dataset.json, the last file of a dataset.

    Raises FileNotFoundError if a frame or the velocity is missing.
    """
    _open_blend(layout)
    import bpy

    from ..scene import rig

    files = [
        path
        for name in spec.cameras.names
        for frame in range(spec.clip.frames)
        for path in vars(layout.frame(name, frame)).values()
    ]
    files += [path for name in spec.cameras.names for path in (layout.static(name), layout.static_exr(name))] + [
        layout.velocity / "zarr.json"
    ]
    if effects.shows_board(spec):
        files += [layout.board_mask(name) for name in spec.cameras.names]
    missing = [path for path in files if not path.is_file()]
    if missing:
        raise FileNotFoundError(
            f"{len(missing)} files of the dataset are missing, first {missing[0]}; run the stages before finish"
        )
    velocity = json.loads((layout.velocity / "zarr.json").read_text(encoding="utf-8"))
    test = [frame for frame in range(spec.clip.frames) if frame % TEST_EVERY == TEST_FIRST]
    _write_json(
        layout.description,
        {
            "schema": "gof-dataset",
            "version": 1,
            "name": spec.name,
            "spec": spec.relative_to(layout.root).to_dict(),
            "effects": spec.effect_names,
            "time_s": [frame / spec.clip.fps for frame in range(spec.clip.frames)],
            "cameras": [
                rig.describe(camera, spec)
                | layout.patterns(camera.name, "flow" in spec.ground_truth, effects.shows_board(spec))
                for camera in rig.find(spec)
            ],
            "splits": {"train": [frame for frame in range(spec.clip.frames) if frame not in test], "test": test},
            "velocity": layout.velocity.name,
            "ground_truth": list(spec.ground_truth),
            "scene": layout.blend.name,
            "display": spec.to_dict()["display"],
            "domain": {
                "index_to_world": velocity["attributes"]["index_to_world"],
                "resolution": velocity["shape"][1:4],
                "voxel_size": velocity["attributes"]["voxel_size"],
            },
            "provenance": {"blender": bpy.app.version_string, "generator": GENERATOR_VERSION},
        },
    )
    progress(1, 1)


def main(argv: list[str] | None = None) -> int:
    """Run one stage; returns the exit status.

    The process must then end through ``mantaflow.leave``.
    """
    parser = argparse.ArgumentParser(prog="python -m gof_blender.worker.generate", description=__doc__.split("\n")[0])
    parser.add_argument("--spec", type=Path, required=True, help="scene spec (JSON)")
    parser.add_argument("--out", type=Path, required=True, help="dataset folder")
    parser.add_argument("--stage", choices=STAGES, required=True)
    args = parser.parse_args(argv)
    layout = Layout(args.out.resolve())
    try:
        spec = scene_spec.load(args.spec)
        progress = Reporter(args.stage, layout.log(args.stage))
        os.chdir(layout.hidden)  # Mantaflow leaves files where it runs
        stages = {"bake": bake, "render": render, "serve": serve, "video": video, "ground-truth": ground_truth}
        (stages | {"flow": flow, "finish": finish})[args.stage](spec, layout, progress)
        progress.line(cost={"cpu_s": time.process_time(), "peak_mb": _peak_mb()})
    except scene_spec.SpecError as error:
        print(error, file=sys.stderr)
        return 2
    except Exception:
        traceback.print_exc()
        return 1
    return 0


def run(argv: list[str]) -> None:
    """Run one stage as the only work of this process, and leave it; leave at once when standard input closes, which is
    when the process that started this one ends."""
    threading.Thread(target=lambda: (sys.stdin.read(), os._exit(1)), daemon=True).start()
    _leave(main(argv))


def _leave(status: int) -> None:
    if "bpy" in sys.modules:
        from ..scene.mantaflow import leave

        leave(status)
    sys.exit(status)


class _Watch:
    """Reports count() of total while the bake blocks this process's main thread."""

    def __init__(self, count, total: int, progress):
        self._count, self._total, self._progress = count, total, progress
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def _run(self) -> None:
        while not self._done.wait(0.5):
            self._progress(self._count(), self._total)

    def __enter__(self) -> None:
        self._thread.start()

    def __exit__(self, *_) -> None:
        self._done.set()
        self._thread.join()
        self._progress(self._count(), self._total)


def _save_blend(layout: Layout) -> None:
    import bpy

    bpy.context.preferences.filepaths.save_version = 0  # no .blend1 beside it
    bpy.ops.wm.save_as_mainfile(filepath=str(layout.blend), check_existing=False)


def _open_blend(layout: Layout, during_bake: bool = False) -> None:
    if not (layout.bake_marker.is_file() or (during_bake and layout.blend.is_file())):
        raise FileNotFoundError(f"{layout.root} holds no finished bake; run --stage bake first")
    import bpy

    from ..scene import mantaflow

    mantaflow.enable()
    bpy.ops.wm.open_mainfile(filepath=str(layout.blend))


def _peak_mb() -> float | None:
    """Peak resident memory of this process, None where it is not known."""
    status = Path("/proc/self/status")
    if status.is_file():  # getrusage would count what the process that started this one had in memory
        return int(status.read_text().partition("VmHWM:")[2].split()[0]) / 1024
    try:
        import resource
    except ModuleNotFoundError:  # Windows
        return None
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20  # macOS counts bytes


def _write_json(path: Path, data: dict) -> None:
    draft = path.with_name(f".tmp-{path.name}")
    draft.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")
    os.replace(draft, path)


if __name__ == "__main__":
    _leave(main())
