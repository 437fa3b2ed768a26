"""The generator's task graph on dask.distributed: bake -> pictures -> codec, ground truth -> description -> views.

A task is a call into a Blender process (`gof_benchmark.generator.blender_process`) and leaves files; a shared file
system carries the data, dask only the order, the retries and the costs. Pictures of a frame are asked for as soon as
the solver has passed what their shutter sees, so that rendering does not wait for the bake. Everything resumes from the
files.
"""

from __future__ import annotations

import logging
import ssl
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from gof.core.costs import StageLog
from gof.core.errors import GofError
from gof.host import extras
from gof.host.progress import progress_bar
from gof_benchmark.generator.blender_process import ProcessCost, Renderer, StageRefused, run_stage
from gof_blender.pure import effects
from gof_blender.pure.brightness import Brightness
from gof_blender.pure.cost_model import stage_settings
from gof_blender.pure.layout import Layout
from gof_blender.pure.spec import SceneSpec

RETRIES = 3
CERTIFICATE = ("cert.pem", "key.pem")
POLL_S = 0.3
LOCAL_WORKERS = {  # they are threads of this process: dask must neither pause nor kill them for its memory
    "distributed.admin.tick.limit": "1h",
    "distributed.worker.memory.terminate": False,
    "distributed.worker.memory.pause": False,
    "distributed.worker.memory.spill": False,
}


@contextmanager
def cluster(scheduler: str | None, workers: int, tls: Path | None = None) -> Iterator:
    """A dask client: of a running scheduler, or of workers in this process, whose Blenders are the real processes.

    Args:
        tls: folder with the cert.pem and key.pem that the scheduler asks for (docs/cluster.md).
    Raises:
        GofError: the scheduler does not answer, or see `require_certificate`.
        MissingDependencyError: distributed is not installed.
    """
    require_certificate(scheduler, tls)
    extras.load("distributed", "generate", "making a dataset")
    import dask
    from distributed import Client, Scheduler, SpecCluster, Worker

    if scheduler:
        with _connect(scheduler, tls) as client:
            yield client
        return
    inside = {"protocol": "inproc://"}
    scheduler_here = {"cls": type("QuietScheduler", (Scheduler,), _QUIET), "options": inside}
    worker_here = {"cls": type("QuietWorker", (Worker,), _QUIET), "options": inside | {"nthreads": 1}}
    with (
        dask.config.set(LOCAL_WORKERS),
        SpecCluster(dict.fromkeys(range(workers), worker_here), scheduler_here, silence_logs=logging.ERROR) as local,
        Client(local) as client,
    ):
        yield client


def require_certificate(scheduler: str | None, tls: Path | None) -> None:
    """Make sure that an address and a certificate go together, before anything is connected or written.

    Raises:
        GofError: an address without encryption is given a certificate, one with encryption is given none, or the
            folder holds no certificate with its key.
    """
    if scheduler is None:
        if tls is not None:
            raise GofError("--tls is for the scheduler of --scheduler; give its address too, or leave --tls out")
        return
    encrypted = scheduler.startswith("tls://")
    if tls is None:
        if encrypted:
            raise GofError(f"no dask scheduler answers at {scheduler} without a certificate; give --tls FOLDER")
        print(f"{scheduler}: without --tls, whoever reaches that port can run programs as you", file=sys.stderr)
        return
    if not encrypted:
        raise GofError(
            f"--tls needs a scheduler at tls://HOST:PORT, and --scheduler {scheduler} is not encrypted; start the "
            "scheduler with '--protocol tls' and its certificate (docs/cluster.md)"
        )
    missing = [name for name in CERTIFICATE if not (tls / name).is_file()]
    if missing:
        raise GofError(f"{tls}: has no {' and no '.join(missing)}; docs/cluster.md says how to make them")
    cert, key = (str(tls / name) for name in CERTIFICATE)
    try:
        ssl.create_default_context(cafile=cert).load_cert_chain(cert, key, password="")
    except (ssl.SSLError, OSError) as e:
        raise GofError(
            f"{tls}: cert.pem and key.pem are no certificate with its key, without a password ({e}); docs/cluster.md "
            "says how to make them"
        ) from e


def _connect(scheduler: str, tls: Path | None) -> Any:
    """A client of a running scheduler. Raises GofError: it does not answer, or not to this certificate."""
    from distributed import Client, Security

    security = None
    if tls is not None:
        cert, key = (str(tls / name) for name in CERTIFICATE)
        security = Security(require_encryption=True, tls_ca_file=cert, tls_client_cert=cert, tls_client_key=key)
    try:
        return Client(scheduler, timeout=20, security=security)
    except (OSError, TimeoutError, ValueError) as error:
        raise GofError(
            f"no dask scheduler answers at {scheduler} ({error}); start one with 'dask scheduler'"
        ) from error


def _no_http(node: Any, *_: Any, **__: Any) -> None:
    """In place of dask's pages about a node: without a login, they show folders, logs and addresses to the network."""
    from distributed.http.routing import RoutingApplication
    from tornado.httpserver import HTTPServer

    node.http_application = RoutingApplication([])
    node.http_server = HTTPServer(node.http_application)  # is never told to listen


_QUIET = {"start_http_server": _no_http}


class Generation:
    """One dataset on its way through the graph."""

    def __init__(self, spec: SceneSpec, layout: Layout, client, log: StageLog):
        self._spec = spec
        self._layout = layout
        self._client = client
        self._log = log
        self._root = layout.root.resolve()
        self._running: dict = {}  # future -> stage
        self._rendered = 0  # pictures, in this run
        self._plates = 0
        self._steps = 0  # of the solver
        self._said: set[str] = set()
        self._wall_before = {cost.name: cost.settings.get("wall_s", 0.0) for cost in log.stages()}
        self._begun: dict[str, float] = {}  # stage -> clock when its first task began

    def run(self) -> None:
        """Make what is missing, and record what each stage cost.

        Raises:
            GofError: a stage failed; what was finished is kept.
        """
        try:
            # A bake that was cut off starts over, so that pictures may follow only a bake of this very run.
            self._simulate_and_render(fresh_bake=not self._layout.bake.exists())
            stages = ["video"] if any(map(effects.encodes, self._spec.effects)) else []
            stages += ["flow"] if "flow" in self._spec.ground_truth else []
            for stage in [*stages, "finish"]:
                self._submit(stage, _stage, stage)
                self._wait_for(lambda: not self._running)
        finally:
            self._client.cancel(list(self._running))
            self._client.run(Renderer.close, self._root)

    def _simulate_and_render(self, fresh_bake: bool) -> None:
        spec = self._spec
        baked = self._layout.bake_marker.is_file()
        if not baked:
            self._submit("bake", _stage, "bake")
        waiting = [(frame, camera) for frame in range(spec.clip.frames) for camera in range(len(spec.cameras.names))]
        truth_pending = True
        with progress_bar("generate") as update:
            while waiting or truth_pending or self._running:
                baked = self._layout.bake_marker.is_file()
                while waiting and (baked or (fresh_bake and self._is_ready(waiting[0][0]))):
                    if not self._has_plates() and "render" in self._running.values():
                        break  # the renderer of the first picture makes the plates; a second one would make them too
                    frame, camera = waiting.pop(0)
                    self._submit("render", _render, frame, camera, priority=-frame)
                if truth_pending and baked and "bake" not in self._running.values():
                    truth_pending = False
                    self._submit("ground-truth", _stage, "ground-truth", priority=1)
                self._collect()
                update(*self._progress())
                time.sleep(POLL_S)

    def _has_plates(self) -> bool:
        return all(self._layout.static_exr(name).is_file() for name in self._spec.cameras.names)

    def _is_ready(self, frame: int) -> bool:
        """Whether the solver has passed every step that a picture of this frame sees."""
        timeline = self._spec.timeline
        last = 0
        for camera in range(timeline.cameras):
            first, weights = timeline.weights(camera, frame)
            last = max(last, first + len(weights) - 1)
        return self._layout.blend.is_file() and self._layout.is_baked(timeline.blender_frame(frame) + last)

    def _submit(self, stage: str, function, *args, priority: int = 0) -> None:
        future = self._client.submit(
            function, *args, root=self._root, pure=False, retries=RETRIES, priority=priority, key=None
        )
        self._running[future] = stage

    def _collect(self) -> None:
        for future in [f for f in self._running if f.done()]:
            stage = self._running.pop(future)
            if future.status != "finished":
                raise GofError(f"{stage} failed {RETRIES + 1} times; the last time: {future.exception()}")
            cost: ProcessCost | StageRefused = future.result()
            if isinstance(cost, StageRefused):
                raise cost
            self._rendered += stage == "render"
            settings = stage_settings(stage, self._spec) | {"wall_s": self._wall_s(stage, cost.seconds)}
            if stage == "render" and (seen := Brightness.read(self._layout.brightness)):
                settings["brightness"] = vars(seen)
                self._say_once(str(seen))
            self._log.record(stage, cost.seconds, cost.peak_mb, settings, resumed=True)

    def _say_once(self, text: str) -> None:
        """Print a line above the progress, unless it has been printed."""
        if text not in self._said:
            self._said.add(text)
            print(f"\n{text}", file=sys.stderr)

    def _wall_s(self, stage: str, seconds: float) -> float:
        """Wall seconds of a stage until now, in all runs; its tasks overlap, so their seconds add up to more."""
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
        pictures = (self._spec.clip.frames + 1) * len(names)
        if self._plates < len(names):
            self._plates = self._layout.plates(names)
        last = self._spec.timeline.last_frame
        if self._layout.bake_marker.is_file():
            self._steps = last
        while self._steps < last and self._layout.cached_velocity(self._steps + 1).is_file():
            self._steps += 1
        return self._steps + self._plates + self._rendered, last + pictures


def _stage(stage: str, root: Path) -> ProcessCost | StageRefused:
    """A refusal is an answer: dask would do work that raises again, and print how it went."""
    try:
        return run_stage(stage, root)
    except StageRefused as refusal:
        return refusal


def _render(frame: int, camera: int, root: Path) -> ProcessCost | StageRefused:
    try:
        return Renderer.render(root, frame, camera)
    except StageRefused as refusal:
        return refusal
