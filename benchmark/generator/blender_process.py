"""Blender processes of the generator: one-shot stages, and renderers that stay open between frames."""

from __future__ import annotations

import atexit
import importlib.util
import json
import os
import re
import subprocess
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from gof.core.errors import GofError
from gof.host.processes import python_command, start
from gof_blender.core.checked_json import SpecError
from gof_blender.pure.layout import Layout
from gof_blender.pure.spec import Display

REFUSED = 2  # exit status of a worker whose spec is wrong


class BlenderLost(GofError):
    """A Blender process died or failed; the same work may succeed in another one."""


class StageRefused(GofError):
    """A Blender process says that the spec is wrong; the same work fails in every other one, too."""


@dataclass(frozen=True)
class ProcessCost:
    """The cost of a piece of work: seconds on the clock and of the CPU, and peak resident memory in MB."""

    seconds: float
    cpu_s: float
    peak_mb: float


def command(stage: str, root: Path) -> list[str]:
    arguments = ["--spec", str(Layout(root).local_spec), "--out", str(root), "--stage", stage]
    return python_command("-m", "gof_blender.worker.generate", *arguments)


def run_stage(stage: str, root: Path) -> ProcessCost:
    """Run a stage of the dataset in `root` to its end.

    Raises:
        BlenderLost: it failed; the message holds its last lines.
        StageRefused: it cannot be done.
    """
    began = time.perf_counter()
    process, log = _start(stage, root)
    with _killed_on_error(process):
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode == REFUSED:
        raise StageRefused(_last_lines(log, 1))
    if process.returncode:
        raise BlenderLost(f"stage '{stage}' of {root} ended with status {process.returncode}:\n{_last_lines(log)}")
    seconds = time.perf_counter() - began
    return ProcessCost(seconds, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024)


class Renderer:
    """A Blender process with the scene of `root` open, which renders pictures on demand."""

    _idle: dict[Path, deque[Renderer]] = {}
    _lock = threading.Lock()

    def __init__(self, root: Path):
        self._root = root
        self._process, self._log = _start("serve", root, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        began = time.perf_counter()
        self._answer()  # ready
        self._overhead = time.perf_counter() - began

    @classmethod
    def render(cls, root: Path, frame: int, camera: int) -> ProcessCost:
        """Render with an idle renderer of this process, or a new one.

        Raises:
            BlenderLost: the Blender process died; the picture is not there.
        StageRefused: it cannot be rendered.
        """
        with cls._lock:
            idle = cls._idle.setdefault(root, deque())
            renderer = idle.pop() if idle else None
        renderer = renderer or cls(root)
        cost = renderer._ask(frame, camera)
        with cls._lock:
            idle.append(renderer)
        return cost

    @classmethod
    def close(cls, root: Path | None = None) -> None:
        """End the idle renderers of one dataset, or all."""
        with cls._lock:
            for key in [root] if root else list(cls._idle):
                for renderer in cls._idle.pop(key, ()):
                    renderer._process.stdin.close()
                    renderer._process.wait()

    def _ask(self, frame: int, camera: int) -> ProcessCost:
        try:
            print(json.dumps({"frame": frame, "camera": camera}), file=self._process.stdin, flush=True)
            cost = self._answer()["rendered"]
        except BrokenPipeError as error:
            raise self._lost() from error
        seconds = cost["seconds"] + self._overhead
        self._overhead = 0.0  # the start-up counts with the first picture
        return ProcessCost(seconds, cost["cpu_s"], cost["peak_mb"])

    def _answer(self) -> dict:
        line = self._process.stdout.readline()
        if not line:
            raise self._lost()
        return json.loads(line)

    def _lost(self) -> GofError:
        try:
            status = self._process.wait(timeout=1)  # it has closed its output, and is about to end
        except subprocess.TimeoutExpired:
            self._process.kill()
            status = self._process.wait()
        if status == REFUSED:
            return StageRefused(_last_lines(self._log, 1))
        return BlenderLost(f"the renderer of {self._root} ended with status {status}:\n{_last_lines(self._log)}")


atexit.register(Renderer.close)

_started: dict[Path, list[subprocess.Popen]] = {}  # by the dataset that they work at


def end(root: Path) -> None:
    """End the Blender processes of a dataset that were started here: idle ones by their own rule, others at once."""
    Renderer.close(root)
    for process in _started.pop(root, ()):
        process.kill()


def _start(stage: str, root: Path, **pipes) -> tuple[subprocess.Popen, Path]:
    log = Layout(root).log(stage).with_suffix(".err")
    log.parent.mkdir(parents=True, exist_ok=True)
    with open(log, "ab") as file:
        process = start(command(stage, root), stderr=file, **({"stdout": file} | pipes))
    _started.setdefault(root, []).append(process)
    return process, log


@contextmanager
def _killed_on_error(process: subprocess.Popen) -> Iterator[None]:
    """Kill a process if the block is left by an exception."""
    try:
        yield
    except BaseException:
        process.kill()
        raise


def _last_lines(log: Path, count: int = 15) -> str:
    return "\n".join(log.read_text(encoding="utf-8", errors="replace").splitlines()[-count:])


# ----------------------------------------------------------------
# The looks that the installed Blender's colour management knows, read without starting Blender.

LOOK = re.compile(r"^\s*-\s*!<Look>\s*\n?\s*\{?\s*name:\s*\"?([^\"\n,}]+)", re.MULTILINE)


def known_looks(view_transform: str) -> list[str] | None:
    """Return names that Blender takes with a view transform; None where there is no Blender of Python's to ask."""
    configuration = os.environ.get("OCIO") or _of_blender()
    if configuration is None or not Path(configuration).is_file():
        return None
    names = LOOK.findall(Path(configuration).read_text(encoding="utf-8", errors="replace"))
    own = [name for name in names if name.startswith(f"{view_transform} - ")]
    return ["None", *(own or [name for name in names if " - " not in name])]


def require_look(display: Display) -> None:
    """Raise SpecError if Blender would not know the look."""
    known = known_looks(display.view_transform)
    if known is not None and display.look not in known:
        raise SpecError(f"display.look must be one of {', '.join(known)}, got {display.look!r}")


def _of_blender() -> Path | None:
    found = importlib.util.find_spec("bpy")
    if found is None or found.origin is None:
        return None
    folder = Path(found.origin).parent
    return next(iter(folder.glob("*/datafiles/colormanagement/config.ocio")), None)
