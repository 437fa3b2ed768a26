"""A dataset as a graph of tasks: bake -> pictures -> codec, ground truth -> description -> views.

A task is a call into a Blender process (`gof_benchmark.generator.blender_process`) and leaves files; where it runs is
`gof_benchmark.generator.workers`'. Pictures of a frame begin as soon as the solver has passed what their
shutter sees, so that rendering does not wait for the bake. Everything resumes from the files.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path

from gof.core.costs import StageLog
from gof.core.errors import GofError
from gof.core.time_left import MachineLoad, TimeLeft
from gof.host import extras
from gof.host.terminal import progress_bar
from gof_benchmark.generator import machine
from gof_benchmark.generator.blender_process import ProcessCost, Renderer, StageRefused, run_stage
from gof_benchmark.generator.workers import RETRIES, ClusterWorkers, LocalWorkers, workers_for
from gof_blender.pure import effects
from gof_blender.pure.brightness import Brightness
from gof_blender.pure.cost_model import CORES, learn, predict_here, stage_settings
from gof_blender.pure.layout import Layout
from gof_blender.pure.spec import SceneSpec

POLL_S = 0.3
SURE = 3  # pictures after which their own price is known better than a model's


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
        tls: folder with the certificate that the scheduler requires (`workers_for`).
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
        machine.require_machine_for(spec, layout.root)
    with workers_for(scheduler, workers, tls) as pool:
        Generation(spec, layout, pool, log, MachineLoad.measured_now()).run()


class Generation:
    """One dataset on its way through the graph."""

    def __init__(
        self,
        spec: SceneSpec,
        layout: Layout,
        workers: LocalWorkers | ClusterWorkers,
        log: StageLog,
        now: MachineLoad,
    ):
        """Args: now: this machine when the work begins."""
        self._spec = spec
        self._layout = layout
        self._workers = workers
        self._log = log
        self._root = layout.root.resolve()
        self._running: dict[Future, str] = {}  # -> stage
        self._rendered = 0  # pictures, in this run
        self._plates = 0
        self._steps = 0  # of the solver
        self._printed: set[str] = set()
        self._wall_before = {cost.name: cost.settings.get("wall_s", 0.0) for cost in log.stages()}
        self._begun: dict[str, float] = {}  # stage -> clock when its first task began
        self._now = now
        self._expected = predict_here(spec, now).by_stage
        # Nothing was made before, here or in a dataset whose fire this is.
        self._whole = not (layout.bake.exists() or layout.lent.exists() or layout.pictures())
        self._cpu_s: dict[str, float] = {}  # of all processes of a stage

    def run(self) -> None:
        """Make what is missing, and record what each stage cost.

        Raises:
            GofError: a stage failed; what was finished is kept.
        """
        try:
            self._simulate_and_render()
            stages = ["video"] if any(map(effects.encodes, self._spec.effects)) else []
            stages += ["flow"] if "flow" in self._spec.ground_truth else []
            for stage in [*stages, "finish"]:
                self._submit(stage, _stage, stage)
                self._wait_for(lambda: not self._running)
            if self._whole:
                learn(self._spec, self._cpu_s)
        finally:
            for future in self._running:
                future.cancel()
            self._workers.leave(self._root)

    def _simulate_and_render(self) -> None:
        spec, before = self._spec, self._bake_began()
        baked = self._layout.bake_marker.is_file()
        if not baked:
            self._submit("bake", _stage, "bake")
        waiting = list(spec.pictures)
        truth_pending = True
        left = TimeLeft({"generate": sum(self._expected.values())})
        with progress_bar("generate", left=left) as update:
            while waiting or truth_pending or self._running:
                baked = self._layout.bake_marker.is_file()
                # Leftovers of an earlier bake may be removed by this run's: pictures wait until that has begun.
                begun = baked or self._bake_began() != before
                while waiting and (baked or (begun and self._is_ready(waiting[0][0]))):
                    if not self._has_plates() and "render" in self._running.values():
                        break  # the renderer of the first picture makes the plates; a second one would make them too
                    frame, camera = waiting.pop(0)
                    self._submit("render", _render, frame, camera, priority=-frame)
                if truth_pending and baked and "bake" not in self._running.values():
                    truth_pending = False
                    self._submit("ground-truth", _stage, "ground-truth", priority=1)
                self._collect()
                update(*self._progress(), share=self._share())
                time.sleep(POLL_S)

    def _bake_began(self) -> int:
        """Return when a bake last began or went on, ns of the file system's clock; 0: never."""
        note = self._layout.bake_begun
        return note.stat().st_mtime_ns if note.is_file() else 0

    def _has_plates(self) -> bool:
        return all(self._layout.static_exr(name).is_file() for name in self._spec.cameras.names)

    def _is_ready(self, frame: int) -> bool:
        """Return whether the solver has passed every step that a picture of this frame sees."""
        timeline = self._spec.timeline
        last = 0
        for camera in range(timeline.cameras):
            first, weights = timeline.weights(camera, frame)
            last = max(last, first + len(weights) - 1)
        return self._layout.blend.is_file() and self._layout.is_baked(timeline.blender_frame(frame) + last)

    def _submit(self, stage: str, function, *args, priority: int = 0) -> None:
        self._running[self._workers.submit(function, *args, root=self._root, priority=priority)] = stage

    def _collect(self) -> None:
        for future in [f for f in self._running if f.done()]:
            stage = self._running.pop(future)
            try:
                cost: ProcessCost | StageRefused = future.result()
            except Exception as e:  # of any kind: a worker's, a lost connection's
                raise GofError(f"{stage} failed {RETRIES + 1} times; the last time: {str(e) or repr(e)}") from e
            if isinstance(cost, StageRefused):
                raise cost
            self._rendered += stage == "render"
            self._cpu_s[stage] = self._cpu_s.get(stage, 0.0) + cost.cpu_s
            settings = stage_settings(stage, self._spec) | {"wall_s": self._wall_s(stage, cost.seconds)}
            if stage == "render" and (seen := Brightness.read(self._layout.brightness)):
                settings["brightness"] = vars(seen)
                self._say_once(str(seen))
            self._log.record(stage, cost.seconds, cost.peak_mb, settings, resumed=True)

    def _say_once(self, text: str) -> None:
        """Print a line above the progress, unless it has been printed."""
        if text not in self._printed:
            self._printed.add(text)
            print(f"\n{text}", file=sys.stderr)

    def _wall_s(self, stage: str, seconds: float) -> float:
        """Return wall seconds of a stage until now, in all runs; its tasks overlap, so their seconds add up to more."""
        now = time.perf_counter()
        self._begun[stage] = min(self._begun.get(stage, now), now - seconds)
        return round(self._wall_before.get(stage, 0.0) + now - self._begun[stage], 3)

    def _wait_for(self, condition: Callable[[], bool]) -> None:
        while not condition():
            self._collect()
            time.sleep(POLL_S)

    def _progress(self) -> tuple[int, int]:
        """Solver steps, plates and pictures done, of all: rough units of one total."""
        names = self._spec.cameras.names
        pictures = len(self._spec.pictures) + len(names)
        if self._plates < len(names):
            self._plates = self._layout.plates(names)
        last = self._spec.timeline.last_frame
        if self._layout.bake_marker.is_file():
            self._steps = last
        if self._steps < last:
            self._steps = min(self._layout.newest_step(), last)
        return self._steps + self._plates + self._rendered, last + pictures

    def _share(self) -> float:
        """Return how much is done of all seconds, 0..1: pictures, once some are rendered, at what these have cost."""
        pictures, baked = len(self._spec.pictures), self._steps / max(self._spec.timeline.last_frame, 1)
        rendered = self._expected["render"]
        if self._rendered >= SURE:
            rendered = self._cpu_s["render"] / CORES / self._rendered * pictures * self._now.crowded
        seconds = self._expected | {"render": rendered}
        shares = {"bake": baked, "render": min(self._layout.pictures() / pictures, 1.0)}
        shares["ground-truth"] = float("ground-truth" in self._cpu_s)
        return sum(seconds[stage] * share for stage, share in shares.items()) / sum(seconds.values())


def _stage(stage: str, root: Path) -> ProcessCost | StageRefused:
    """Return a refusal is an answer: work that raises is done again."""
    try:
        return run_stage(stage, root)
    except StageRefused as refusal:
        return refusal


def _render(frame: int, camera: int, root: Path) -> ProcessCost | StageRefused:
    try:
        return Renderer.render(root, frame, camera)
    except StageRefused as refusal:
        return refusal
