"""A dataset in the making: the generator's stages one after another, each in a Blender process of its own.

Nothing here waits: ``poll`` takes what the child has said since the last call, so that a user interface can go on.
What a stopped job has finished stays, and the next job for the same folder goes on there. Never imports bpy.
"""

from __future__ import annotations

import json
import os
import queue
import subprocess
import threading
import time
from pathlib import Path

from ..scene import effects
from . import cost_model as costs
from . import report
from .layout import Layout
from .spec import SceneSpec

PACKAGE = Path(__file__).resolve().parents[1]


class JobError(RuntimeError):
    """A process failed; the message says what it was doing, and why."""


def stages(spec: SceneSpec) -> list[str]:
    """The stages that a spec needs, in order."""
    video = ["video"] if any(map(effects.encodes, spec.effects)) else []
    flow = ["flow"] if "flow" in spec.ground_truth else []
    return ["bake", "render", *video, "ground-truth", *flow, "finish"]


def expected_s(spec: SceneSpec, prediction: costs.Prediction) -> dict[str, float]:
    """Seconds on the clock that each stage should take when nothing else runs.

    The prediction is in processor seconds over cores; bake and export keep one core busy, not all.
    """
    known = {
        "bake": prediction.bake_s * costs.CORES,
        "render": prediction.render_s,
        "ground-truth": prediction.ground_truth_s * costs.CORES,
    }
    return {stage: known.get(stage, 2.0) for stage in stages(spec)}


class Job:
    """The work on one dataset folder that ``spec.claim`` has given to a spec.

    Attributes:
        stage: the stage that runs, "" before the first and after the last.
        fraction: expected share of the work that is done, 0..1.
        seconds_left: by the pace of this stage, and the prediction for those after it.
    """

    def __init__(self, spec: SceneSpec, layout: Layout, python: list[str]):
        """``python``: a command that runs the Python code given as its next argument, in a Blender without a window."""
        self.spec, self.layout = spec, layout
        self._python = python
        self._expected = expected_s(spec, costs.predict(spec, costs.known_machine() or costs.REFERENCE))
        self._waiting = stages(spec)
        self._process: subprocess.Popen | None = None
        self._lines: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._start = 0.0
        self.stage, self._done, self._done_before, self._total, self._peak_mb = "", 0, None, 0, 0.0

    @property
    def fraction(self) -> float:
        total = sum(self._expected.values())
        now = self._expected[self.stage] * (1 - self._share()) if self.stage else 0.0
        return 1.0 - (now + self._later()) / total

    @property
    def seconds_left(self) -> float:
        return self._left_here() + self._later()

    def __str__(self) -> str:
        here = f"{self.stage} {self._done} of {self._total}" if self._total else f"{self.stage or 'ready'}"
        return f"{here}, {costs.duration(self.seconds_left)} left"

    def poll(self) -> bool:
        """Take note of progress and go on to the next stage. Returns whether there is more to do.

        Raises:
            JobError: a stage failed; its last lines are in the message and in the log.
        """
        self._read()
        if self._process is not None:
            status = self._process.poll()
            if status is None:
                return True
            self._end_of_stage(status)
        while self._waiting:
            self.stage = self._waiting.pop(0)
            if not self._is_finished():
                self._begin()
                return True
        self.stage = ""
        report.write(self.layout)
        self._note(f"finished: {self.layout.description}")
        return False

    def run(self, every_s: float = 0.2) -> None:
        """Do all of it now. Raises JobError; on any exception the child is stopped."""
        try:
            while self.poll():
                time.sleep(every_s)
        finally:
            self.stop()

    def stop(self) -> None:
        """End the child, if one runs; what it has finished stays."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None
            self._note(f"stopped in {self.stage}")

    def _is_finished(self) -> bool:
        done = {"bake": self.layout.bake_marker, "finish": self.layout.description}.get(self.stage)
        return done is not None and done.is_file()

    def _begin(self) -> None:
        arguments = ["--spec", str(self.layout.spec), "--out", str(self.layout.root), "--stage", self.stage]
        code = f"import sys; sys.path.insert(0, {str(PACKAGE.parent)!r}); from {PACKAGE.name}.worker.generate import run; run({arguments!r})"
        self._done, self._done_before, self._total, self._peak_mb = 0, None, 0, 0.0
        self._start = time.monotonic()
        self._note(f"{self.stage} ...")
        with open(self._errors(), "ab") as errors:
            # The child ends with its standard input, hence with this process.
            self._process = subprocess.Popen(
                [*self._python, code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors
            )
        threading.Thread(target=_forward, args=(self._process.stdout, self._lines), daemon=True).start()

    def _read(self) -> None:
        while not self._lines.empty():
            try:
                message = json.loads(self._lines.get())
            except ValueError:
                continue  # Blender's own greeting
            if progress := message.get("progress"):
                self._done, self._total = progress["done"], progress["total"]
                self._done_before = self._done if self._done_before is None else self._done_before
            self._peak_mb = message.get("cost", {}).get("peak_mb") or self._peak_mb

    def _end_of_stage(self, status: int) -> None:
        self._process = None
        seconds = time.monotonic() - self._start
        if status:
            message = f"{self.stage} failed with status {status}:\n{_last_lines(self._errors())}"
            self._note(message)
            raise JobError(message)
        costs.record(self.layout.costs, self.stage, seconds, self._peak_mb, costs.stage_settings(self.stage, self.spec))
        self._note(f"{self.stage}: {seconds:.0f} s, {self._peak_mb:.0f} MB")

    def _share(self) -> float:
        return min(self._done / self._total, 1.0) if self._total else 0.0

    def _left_here(self) -> float:
        """Seconds left in this stage: by its own pace as soon as there is one."""
        if not self.stage:
            return 0.0
        made = self._done - (self._done_before or 0)
        if made <= 0:
            return self._expected[self.stage] * (1 - self._share())
        return (time.monotonic() - self._start) * (self._total - self._done) / made

    def _later(self) -> float:
        return sum(self._expected[stage] for stage in self._waiting)

    def _errors(self) -> Path:
        return self.layout.log(self.stage).with_suffix(".err")

    def _note(self, text: str) -> None:
        self.layout.hidden.mkdir(parents=True, exist_ok=True)
        with open(self.layout.job_log, "a", encoding="utf-8") as file:
            print(time.strftime("%Y-%m-%d %H:%M:%S"), text, file=file)


def _forward(stream, lines: queue.SimpleQueue) -> None:
    for line in stream:
        lines.put(line.decode(errors="replace"))


def _last_lines(path: Path, count: int = 12) -> str:
    return "\n".join(path.read_text(encoding="utf-8", errors="replace").rstrip().split(os.linesep)[-count:])
